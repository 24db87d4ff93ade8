"""Planes: distances, intersections with rays, coordinates on the ground, and fits to points."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray, Real, UInt32

from catfree.errors import (
    DegenerateGeometryError,
    InsufficientDataError,
    InvalidInputError,
    quoted,
)
from catfree.geometry._arrays import Scalar, as_flags, epsilon, float_arrays, require_vectors
from catfree.types import Plane, Scene
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import as_count, is_traced, require_instance, require_shape

# A ray whose slope to the plane is below this many epsilons is parallel to it.
PARALLEL_EPSILONS = 8.0
# Points within this many epsilons of a line, relative to the largest coordinate, lie on it.
LINE_EPSILONS = 4.0
# Inliers of RANSAC lie within this share of the typical distance between two points: the same
# share of the scene that the paper grants a ray (delta = 0.01 E).
INLIER_SHARE = 0.01
# Selecting inliers and fitting them is repeated this often; it settles after two or three.
REFINEMENTS = 5
# Hypotheses scored at a time, so that memory stays at this many distances per point.
SCORED_TOGETHER = 16


def plane_distance(plane: Plane, position: Real[HostOrDevice, "3"]) -> Float[Array, ""]:
    """Compute the distance of a position from the ground, above or below: the paper's g.

    Args:
        plane: the ground.
        position: (3,) in scene units.

    Returns:
        () unsigned distance in scene units; its gradient on the plane is 0.

    Raises:
        InvalidInputError: if plane is not a `Plane`, or position is not one vector.

    Source: paper, Sec. "Selecting pedestrian positions", ground-plane consistency filter.
    """
    require_instance(plane, Plane, "plane")
    position, normal, offset = float_arrays(
        position=position, normal=plane.normal, offset=plane.offset
    )
    require_vectors(3, position=position)
    return jnp.abs(jnp.sum(normal * position) + offset)


def intersect_ray(
    plane: Plane,
    origin: Real[HostOrDevice, "3"],
    direction: Real[HostOrDevice, "3"],
) -> tuple[Float[Array, "3"], Bool[Array, ""]]:
    """Find the point where a ray meets a plane.

    Args:
        plane: the plane.
        origin: (3,) start of the ray in scene units.
        direction: (3,) unit vector in the world frame.

    Returns:
        position: (3,) the intersection in scene units; the foot of the origin's perpendicular
            where there is none.
        valid: () whether the ray meets the plane, ahead of its origin.

    Raises:
        InvalidInputError: if plane is not a `Plane`, or origin or direction is not one vector.

    Source: Hartley and Zisserman, "Multiple View Geometry" (2004), Sec. 3.2.2, meet of a line and a
        plane.
    """
    require_instance(plane, Plane, "plane")
    origin, direction, normal, offset = float_arrays(
        origin=origin, direction=direction, normal=plane.normal, offset=plane.offset
    )
    require_vectors(3, origin=origin, direction=direction)
    height = jnp.sum(normal * origin) + offset
    slope = jnp.sum(normal * direction)
    crossing = jnp.abs(slope) > PARALLEL_EPSILONS * epsilon(slope.dtype)
    along = -height / jnp.where(crossing, slope, 1)
    valid = crossing & (along >= 0)
    return jnp.where(valid, origin + along * direction, origin - height * normal), valid


def fit_plane(
    points: Real[HostOrDevice, "n 3"],
    weights: Real[HostOrDevice, " n"] | None = None,
    *,
    toward: Real[HostOrDevice, "3"] | None = None,
) -> Plane:
    """Fit the plane with the smallest weighted sum of squared distances to points.

    Args:
        points: (N, 3) in scene units.
        weights: (N,) weight of each point, 0 for an absent one; None for all equal.
        toward: (3,) a point on the desired positive side, such as a camera center; None
            leaves the sign of the normal open.

    Returns:
        Plane. Points that leave it undetermined (fewer than three, collinear) give one of the
        planes through them, with finite derivatives.

    Raises:
        InvalidInputError: if an argument has another shape.

    Source: Pearson (1901), "On lines and planes of closest fit to systems of points in space".
    """
    points, weights, toward = float_arrays(
        "weights", "toward", points=points, weights=weights, toward=toward
    )
    require_shape(points, (None, 3), "points")
    point_weights = jnp.ones(len(points), points.dtype) if weights is None else weights
    require_shape(point_weights, points.shape[:1], "weights")
    if toward is not None:
        require_vectors(3, toward=toward)
    present = point_weights > 0  # false for NaN too
    points = jnp.where(present[:, None], points, 0)
    total = jnp.sum(jnp.where(present, point_weights, 0))
    shares = jnp.where(present, point_weights, 0) / jnp.where(total > 0, total, 1)
    center = jnp.sum(shares[:, None] * points, axis=0)
    offsets = jnp.where(present[:, None], points - center[None, :], 0)
    scatter = jnp.einsum("n,ni,nj->ij", shares, offsets, offsets)
    normal = _smallest_direction(scatter)
    if toward is not None:
        normal = jnp.where(jnp.sum(normal * (toward - center)) < 0, -normal, normal)
    return Plane(normal, -jnp.sum(normal * center))


def _smallest_direction(scatter: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Unit eigenvector of the smallest eigenvalue, with derivatives that repeated ones bound."""
    fixed = jax.lax.stop_gradient(scatter)
    values, vectors = jnp.linalg.eigh(fixed)
    smallest = vectors[:, 0]
    floor = epsilon(scatter.dtype) * jnp.sum(values)
    gaps = jnp.maximum(values[1:] - values[0], jnp.where(floor > 0, floor, 1))
    # Perturbation theory: a change of the matrix tilts the eigenvector towards each other one by
    # its entry over the gap. The value of this correction is 0, only its derivative counts.
    tilt = vectors[:, 1:].T @ ((scatter - fixed) @ smallest) / gaps
    direction = smallest - vectors[:, 1:] @ tilt
    return direction / jnp.sqrt(jnp.sum(direction * direction))


class PlaneFit(eqx.Module):
    """A plane and the points that lie on it.

    Attributes:
        plane: the fitted plane.
        inliers: (N,) bool, the points within the threshold of it.
    """

    plane: Plane
    inliers: Bool[Array, " n"]


def fit_plane_ransac(
    points: Real[HostOrDevice, "n 3"],
    key: PRNGKeyArray | UInt32[Array, "2"],
    *,
    threshold: Scalar | None = None,
    iterations: int = 512,
    where: Bool[HostOrDevice, " n"] | None = None,
    toward: Real[HostOrDevice, "3"] | None = None,
) -> PlaneFit:
    """Find the plane that most points support, and those points.

    Planes through random triples are scored by the truncated sum of squared distances; the best
    is fitted again to its inliers until they settle.

    Args:
        points: (N, 3) in scene units.
        key: JAX random key.
        threshold: () largest distance of an inlier in scene units, 0 or more; None for one
            hundredth of the median distance between two random points.
        iterations: number of random triples, 1 or more.
        where: (N,) bool, the points to use; None for all. Points that are not finite are never
            used.
        toward: (3,) a point on the desired positive side, such as the mean camera center;
            None for the mean of the points, which is above a ground that objects stand on.

    Returns:
        PlaneFit. The same key and points moved by a similarity give the moved plane. Under tracing,
        points that leave the plane undetermined give one of the planes through them.

    Raises:
        InsufficientDataError: if the array of points is empty, or fewer than three concrete points
            are used.
        DegenerateGeometryError: if all concrete points that are used lie on a line.
        InvalidInputError: if an argument has another shape or value.

    Source: Fischler and Bolles (1981); Torr and Zisserman (2000) for the truncated score.
    """
    points, threshold, toward = float_arrays(
        "threshold", "toward", points=points, threshold=threshold, toward=toward
    )
    require_shape(points, (None, 3), "points")
    count = as_count(iterations, "iterations", least=1)
    if toward is not None:
        require_vectors(3, toward=toward)
    if threshold is not None:
        require_shape(threshold, (), "threshold")
    if threshold is not None and not is_traced(threshold) and not threshold >= 0:
        raise InvalidInputError(f"threshold is {threshold}; it must be a length, 0 or more.")
    if points.shape[0] == 0:
        raise InsufficientDataError("A plane needs 3 points, but there are none.")
    kind = getattr(key, "dtype", np.dtype(object))
    if kind != jnp.uint32 and not jnp.issubdtype(kind, jax.dtypes.prng_key):
        raise InvalidInputError(
            f"key is {quoted(key)}; it must be a key of JAX, such as jax.random.key(0)."
        )
    used = jnp.ones(points.shape[0], bool) if where is None else as_flags(where, "where")
    require_shape(used, points.shape[:1], "where")
    used = used & jnp.all(jnp.isfinite(points), axis=1)
    if not is_traced(points, used):
        _require_determined(np.asarray(points, np.float64)[np.asarray(used)], epsilon(points.dtype))
    return _fit_plane_ransac(points, key, threshold, count, used, toward)


def _require_determined(points: Float[np.ndarray, "n 3"], resolution: float) -> None:
    """Raise unless these are three points or more that do not lie on a line."""
    count = len(points)
    if count < 3:
        raise InsufficientDataError(
            f"A plane needs 3 points, but {count} of them {'is' if count == 1 else 'are'} finite "
            "and used."
        )
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False) / np.sqrt(count)
    if spread[1] <= LINE_EPSILONS * resolution * np.abs(points).max():
        raise DegenerateGeometryError(
            f"The {count} points leave the plane undetermined: they coincide or lie on one line. "
            "Pass points that surround an area."
        )


@functools.partial(jax.jit, static_argnames="iterations")
def _fit_plane_ransac(
    points: Array,
    key: Array,
    threshold: Array | None,
    iterations: int,
    used: Array,
    toward: Array | None,
) -> PlaneFit:
    """Compiled `fit_plane_ransac`: uncompiled, every call would trace its loops again."""
    points = jnp.where(used[:, None], points, 0)
    count = jnp.sum(used)
    center = jnp.sum(points, axis=0) / jnp.maximum(count, 1).astype(points.dtype)
    points = jnp.where(used[:, None], points - center[None, :], 0)
    toward = jnp.zeros_like(center) if toward is None else toward - center
    triples = _random_triples(key, used, iterations)
    if threshold is None:
        pairs = points[triples[:, 0]] - points[triples[:, 1]]
        threshold = INLIER_SHARE * jnp.median(jnp.sqrt(jnp.sum(pairs * pairs, axis=-1)))
    squared_threshold = threshold * threshold

    def squared_distances(normal: Array, anchor: Array) -> Array:
        return jnp.sum((points - anchor[None, :]) * normal[None, :], axis=-1) ** 2

    def score(triple: Array) -> tuple[Array, Array]:
        first, second, third = points[triple[0]], points[triple[1]], points[triple[2]]
        normal = jnp.cross(second - first, third - first)
        length = jnp.sqrt(jnp.sum(normal * normal))
        normal = normal / jnp.where(length > 0, length, 1)
        errors = jnp.minimum(squared_distances(normal, first), squared_threshold)
        cost = jnp.sum(jnp.where(used, errors, 0))
        return jnp.where(length > 0, cost, jnp.inf), normal

    costs, normals = jax.lax.map(score, triples, batch_size=SCORED_TOGETHER)
    best = jnp.argmin(costs)
    inliers = used & (
        squared_distances(normals[best], points[triples[best, 0]]) <= squared_threshold
    )

    def refine(inliers: Array, _: None) -> tuple[Array, Plane]:
        plane = fit_plane(points, inliers.astype(points.dtype), toward=toward)
        close = jnp.abs(points @ plane.normal + plane.offset) <= threshold
        return used & close, plane

    inliers, planes = jax.lax.scan(refine, inliers, None, length=REFINEMENTS)
    normal, offset = planes.normal[-1], planes.offset[-1]
    return PlaneFit(Plane(normal, offset - jnp.sum(normal * center)), inliers)


def _random_triples(
    key: PRNGKeyArray | UInt32[Array, "2"], used: Bool[Array, " n"], iterations: int
) -> Array:
    """Indices (iterations, 3) of triples of distinct used points (of fewer if fewer exist)."""
    count = jnp.sum(used)
    order = jnp.argsort(~used, stable=True)  # used points first, in their order
    size = (iterations,)
    keys = jax.random.split(key, 3)
    first = jax.random.randint(keys[0], size, 0, jnp.maximum(count, 1))
    second = jax.random.randint(keys[1], size, 0, jnp.maximum(count - 1, 1))
    third = jax.random.randint(keys[2], size, 0, jnp.maximum(count - 2, 1))
    # Drawn from the remaining ones, then shifted past those taken.
    second = second + (second >= first).astype(second.dtype)
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    third = third + (third >= low).astype(third.dtype)
    third = third + (third >= high).astype(third.dtype)
    triples = jnp.stack([first, second, third], axis=-1)
    return order[jnp.minimum(triples, jnp.maximum(count - 1, 0))]


def to_plan(scene: Scene, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return ground coordinates (..., 2) of world points along the axes of `scene.ground.basis`."""
    return np.asarray(points, np.float64) @ np.asarray(scene.ground.basis, np.float64)


def from_plan(scene: Scene, xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Return the world points (..., 3) on the ground with these ground coordinates (..., 2)."""
    normal = np.asarray(scene.ground.normal, np.float64)
    foot = -np.asarray(scene.ground.offset, np.float64) * normal
    return np.asarray(xy, np.float64) @ np.asarray(scene.ground.basis, np.float64).T + foot
