"""Similarity transforms: the gauge freedom of a reconstruction, and the fit that removes it."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from catfree.errors import DegenerateGeometryError, InvalidInputError
from catfree.geometry._arrays import as_flags, epsilon, float_arrays, tiny
from catfree.geometry._plane import from_plan
from catfree.types import GeoReference, Plane, Rig, Scene
from catfree.types._annotations import HostOrDevice
from catfree.types._rig import require_rotations
from catfree.types._scene import require_scene
from catfree.types._validation import (
    as_count,
    as_float,
    is_traced,
    require_finite,
    require_instance,
    require_shape,
)

# A singular value below this share of the largest one is zero (rounding of float64 inputs).
RANK_TOLERANCE = 1e-9
# The same in units of the machine epsilon, for float32.
RANK_EPSILONS = 8.0
# Points that differ by fewer epsilons, relative to the largest coordinate, coincide.
RESOLUTION_EPSILONS = 4.0


class Similarity(eqx.Module):
    """`x -> scale * rotation @ x + translation`, in any number of dimensions D.

    In single precision unless JAX's `jax_enable_x64` is set: on a map, where coordinates are large,
    set it or subtract an origin first.

    Attributes:
        scale: () positive.
        rotation: (D, D) proper rotation.
        translation: (D,) in units of the target frame.
    """

    scale: Float[HostOrDevice, ""]
    rotation: Float[HostOrDevice, "dim dim"]
    translation: Float[HostOrDevice, " dim"]

    def __init__(self, scale: Any, rotation: Any, translation: Any) -> None:
        """Store as JAX arrays of one dtype.

        Raises:
            InvalidInputError: if shapes do not fit or, unless traced, the scale is not positive,
                the rotation is not a proper one, or a number is not finite.
        """
        self.scale, self.rotation, self.translation = float_arrays(
            scale=scale, rotation=rotation, translation=translation
        )
        shapes = self.scale.shape, self.rotation.shape, self.translation.shape
        dims = (self.translation.size,)
        if shapes != ((), 2 * dims, dims):
            raise InvalidInputError(
                "A similarity needs a number as scale, a rotation (D, D) and a translation (D,); "
                f"the shapes are {', '.join(map(str, shapes))}."
            )
        if not is_traced(self.scale) and not 0 < float(self.scale) < np.inf:
            raise InvalidInputError(
                f"The scale of a similarity is {self.scale}; it must be positive and finite. A "
                "mirrored frame is not similar: flip one of its axes first."
            )
        if not is_traced(self.rotation):
            require_rotations(self.rotation, "rotation")
        if not is_traced(self.translation):
            require_finite(self.translation, "translation")

    def __call__(self, points: Real[HostOrDevice, "*batch dim"]) -> Float[Array, "*batch dim"]:
        """Move points (..., D) from the source frame to the target frame.

        Raises:
            InvalidInputError: if points have another number of coordinates.
        """
        points, scale, rotation, translation = float_arrays(
            points=points, scale=self.scale, rotation=self.rotation, translation=self.translation
        )
        if points.shape[-1:] != translation.shape:
            raise InvalidInputError(
                f"points have shape {points.shape}; this similarity moves points (..., "
                f"{len(translation)})."
            )
        return scale * jnp.einsum("ij,...j->...i", rotation, points) + jnp.broadcast_to(
            translation, points.shape
        )

    def inverse(self) -> "Similarity":
        """Return the inverse transform."""
        scale = 1 / self.scale
        return Similarity(scale, self.rotation.T, -scale * (self.rotation.T @ self.translation))

    def compose(self, first: "Similarity") -> "Similarity":
        """Return the transform that applies `first`, then this one; also written `self @ first`.

        Raises:
            InvalidInputError: if it is not a similarity of equal dimension.
        """
        require_instance(first, Similarity, "first")
        translation = self(first.translation)
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, translation)

    def __matmul__(self, first: "Similarity") -> "Similarity":
        """Compose, so that `(a @ b)(x) == a(b(x))`."""
        return self.compose(first)

    @classmethod
    def identity(cls, dimension: int = 3) -> "Similarity":
        """Return the identity transform.

        Raises:
            InvalidInputError: if the dimension is not a whole number, 1 or more.
        """
        size = as_count(dimension, "dimension", least=1)
        return cls(1.0, np.eye(size), np.zeros(size))


def fit_similarity(
    source: Real[HostOrDevice, "n dim"],
    target: Real[HostOrDevice, "n dim"],
    weights: Real[HostOrDevice, " n"] | None = None,
    *,
    fixed_scale: bool = False,
) -> Similarity:
    """Fit the least-squares similarity that maps points to their counterparts.

    Concrete points are centered in float64 first. In single precision, rotation and scale are then
    exact far from the origin too, but the translation is rounded.

    Args:
        source: (N, D) points in the source frame.
        target: (N, D) the same points in the target frame.
        weights: (N,) weight of each pair, 0 for an absent pair; None for equal weights.
        fixed_scale: keep scale 1 (a rigid transform).

    Returns:
        Similarity with `target ~= scale * rotation @ source + translation`; the rotation is
        proper even where a mirror image would fit better. Differentiable. Under tracing,
        degenerate points give one of the optimal solutions, with finite value and gradient.

    Raises:
        InvalidInputError: if there are no points, the shapes do not fit each other, or
            `fixed_scale` is neither true nor false.
        DegenerateGeometryError: if points are not finite, or leave the rotation or scale
            undetermined (in 3-D, fewer than three distinct points, or all on a line); raised only
            for concrete values.

    Source: Umeyama (1991), "Least-squares estimation of transformation parameters between two
        point patterns".
    """
    given = source, target, weights
    source, target, weights = float_arrays("weights", source=source, target=target, weights=weights)
    if source.ndim != 2 or source.shape != target.shape or source.shape[0] == 0:
        raise InvalidInputError(
            "A similarity needs pairs of points: two arrays of the same shape (n, D), n at "
            f"least 1, got {source.shape} and {target.shape}."
        )
    weights = jnp.ones(source.shape[0], source.dtype) if weights is None else weights
    if weights.shape != source.shape[:1]:
        raise InvalidInputError(
            f"weights has shape {weights.shape}; it must be one number for each of the "
            f"{source.shape[0]} pairs of points."
        )
    fixed = as_flags(fixed_scale, "fixed_scale")
    require_shape(fixed, (), "fixed_scale")
    origins = None
    if not is_traced(*given):
        source, target, origins = _centered(*given, source.dtype)
    fitted, covariance, spread = _fit(source, target, weights, fixed, origins)
    if not is_traced(covariance, spread):
        _require_determined(
            np.asarray(covariance), bool(spread), int(np.sum(np.asarray(weights) > 0))
        )
    return fitted


class _Origins(NamedTuple):
    """Where centered points were, and the uncertainty of the source by rounding."""

    source: Float[Array, " dim"]
    target: Float[Array, " dim"]
    resolution: Float[Array, ""]


def _centered(
    source: Any, target: Any, weights: Any, dtype: Any
) -> tuple[Float[Array, "n dim"], Float[Array, "n dim"], _Origins]:
    """Concrete points relative to their means, which are subtracted in float64, and the means."""
    resolution = RESOLUTION_EPSILONS * epsilon(as_float(source).dtype)
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    weights = np.ones(len(source)) if weights is None else np.asarray(weights, np.float64)
    present = weights > 0  # false for NaN too
    shares = weights[present] / (weights[present].sum() or 1)
    source, target = (np.where(present[:, None], points, 0) for points in (source, target))
    resolution *= np.abs(source).max()
    with np.errstate(invalid="ignore", over="ignore"):  # infinite points are refused later
        means = shares @ source[present], shares @ target[present]
        centered = source - means[0], target - means[1]
        source, target, *rest = (jnp.asarray(p, dtype) for p in (*centered, *means, resolution))
    return source, target, _Origins(*rest)


@jax.jit  # one compilation instead of one per operation
def _fit(
    source: Float[Array, "n dim"],
    target: Float[Array, "n dim"],
    weights: Float[Array, " n"],
    fixed_scale: Bool[Array, ""],
    origins: _Origins | None,
) -> tuple[Similarity, Float[Array, "dim dim"], Bool[Array, ""]]:
    """The fitted similarity, the cross-covariance, and whether the points differ."""
    present = weights > 0  # false for NaN too
    total = jnp.sum(jnp.where(present, weights, 0))
    shares = jnp.where(present, weights, 0) / jnp.where(total > 0, total, 1)
    source = jnp.where(present[:, None], source, 0)
    target = jnp.where(present[:, None], target, 0)
    source_mean, target_mean = shares @ source, shares @ target
    source_offsets = source - source_mean[None, :]
    target_offsets = target - target_mean[None, :]
    covariance = jnp.einsum("n,ni,nj->ij", shares, target_offsets, source_offsets)
    variance = jnp.sum(shares[:, None] * source_offsets * source_offsets)
    # A smaller spread is due to rounding of coinciding points.
    resolution = RESOLUTION_EPSILONS * epsilon(source.dtype) * jnp.max(jnp.abs(source))
    if origins is not None:
        source_mean, target_mean = source_mean + origins.source, target_mean + origins.target
        resolution = origins.resolution
    spread = variance > jnp.maximum(resolution * resolution, tiny(source.dtype))
    rotation = nearest_rotation(covariance)
    scale = jnp.sum(rotation * covariance) / jnp.where(spread, variance, 1)
    scale = jnp.where(spread & (scale > 0) & ~fixed_scale, scale, 1)
    fitted = Similarity(scale, rotation, target_mean - scale * (rotation @ source_mean))
    return fitted, covariance, spread


def _require_determined(covariance: np.ndarray, spread: bool, count: int) -> None:
    """Raise unless the cross-covariance fixes a rotation: rank at least D - 1."""
    dimension = covariance.shape[0]
    tolerance = max(RANK_TOLERANCE, RANK_EPSILONS * epsilon(covariance.dtype))
    if not np.isfinite(covariance).all():
        raise DegenerateGeometryError(
            "A similarity cannot be fitted to points that are not finite: give them weight 0."
        )
    values = np.linalg.svd(covariance, compute_uv=False)
    if not spread or values[0] == 0 or values[dimension - 2] <= tolerance * values[0]:
        raise DegenerateGeometryError(
            f"The {count} point pairs leave the similarity undetermined: they coincide"
            + (" or lie on one line" if dimension == 3 else "")
            + f" (singular values {', '.join(f'{value:.3g}' for value in values)}). "
            f"At least {dimension} points in general position are needed."
        )


def nearest_rotation(matrix: Real[HostOrDevice, "dim dim"]) -> Float[Array, "dim dim"]:
    """Find the proper rotation R with the largest `tr(Rᵀ matrix)`.

    Args:
        matrix: (D, D).

    Returns:
        (D, D) rotation of determinant 1. Its derivative is exact wherever R is unique, equal
        singular values included (there the derivative of the SVD itself is infinite), and finite
        elsewhere.

    Raises:
        InvalidInputError: if it is not one square matrix.

    Source: Umeyama (1991), "Least-squares estimation of transformation parameters between two
        point patterns", the lemma.
    """
    (matrix,) = float_arrays(matrix=matrix)
    require_shape(matrix, (None, *matrix.shape[:1]), "matrix")
    fixed = jax.lax.stop_gradient(matrix)
    left, values, right = jnp.linalg.svd(fixed)
    sign = jnp.where(jnp.linalg.det(left) * jnp.linalg.det(right) < 0, -1, 1).astype(matrix.dtype)
    signs = jnp.ones_like(values).at[-1].set(sign)
    rotation = (left * signs[None, :]) @ right
    # At the optimum S = Rᵀ matrix is symmetric with eigenvectors `right` and eigenvalues
    # `signs * values`. To stay symmetric when the matrix changes by D, R must turn by the skew
    # Omega with Omega S + S Omega = Rᵀ D - Dᵀ R, which is diagonal in that eigenbasis. D is zero
    # in value, so only derivatives pass here.
    change = rotation.T @ (matrix - fixed)
    skew = right @ (change - change.T) @ right.T
    eigenvalues = signs * values
    sums = eigenvalues[:, None] + eigenvalues[None, :]
    floor = epsilon(matrix.dtype) * values[0]
    sums = jnp.maximum(sums, jnp.where(floor > 0, floor, 1))
    # Rounding on the diagonal would be divided by the smallest singular value, which may be 0.
    diagonal = jnp.eye(matrix.shape[0], dtype=bool)
    turn = right.T @ jnp.where(diagonal, 0, skew / sums) @ right
    return rotation + rotation @ turn


def transform_rig(similarity: Similarity, rig: Rig) -> Rig:
    """Transform the cameras of a rig: every transformed point keeps its pixel.

    Args:
        similarity: from the rig's world frame to the new one, 3-D.
        rig: any rig; unregistered cameras keep their NaN.

    Returns:
        Rig of NumPy arrays if the given one has them (and nothing is traced), else of JAX arrays.

    Raises:
        InvalidInputError: if the similarity is not one of three dimensions, or the rig is not a
            `Rig`.
    """
    require_instance(rig, Rig, "rig")
    scale, rotation, translation, xp = _parts(similarity, rig.R)
    turned = xp.einsum("cij,kj->cik", rig.R, rotation)
    shift = xp.einsum("cij,j->ci", turned, translation)
    moved = scale * rig.t - shift
    if is_traced(*jax.tree.leaves(rig)):  # `Rig` cannot inspect traced sizes, flags and lenses
        return eqx.tree_at(lambda r: (r.R, r.t), rig, (turned, moved))
    return replace(rig, R=turned, t=moved)


def transform_plane(similarity: Similarity, plane: Plane) -> Plane:
    """Transform a plane, keeping its positive side.

    Args:
        similarity: from the plane's world frame to the new one, 3-D.
        plane: any plane.

    Returns:
        Plane of NumPy or JAX arrays, as in `transform_rig`.

    Raises:
        InvalidInputError: if the similarity is not one of three dimensions, or the plane is not a
            `Plane`.
    """
    require_instance(plane, Plane, "plane")
    scale, rotation, translation, xp = _parts(similarity, plane.normal)
    normal = rotation @ plane.normal
    return Plane(normal, scale * plane.offset - xp.sum(normal * translation))


def transform_scene(similarity: Similarity, scene: Scene, *, metric: bool | None = None) -> Scene:
    """Transform the rig, ground and extent of a scene.

    Args:
        similarity: from the scene's world frame to the new one, 3-D.
        scene: any scene.
        metric: whether the new units are meters; None keeps the scene's flag.

    Returns:
        Scene of NumPy or JAX arrays, as in `transform_rig`, with its georeference moved along; a
        traced transform drops it.

    Raises:
        InvalidInputError: if the similarity is not one of three dimensions, or the scene is not a
            `Scene`.
    """
    require_scene(scene)
    scale, _, _, xp = _parts(similarity, scene.extent)
    ground = transform_plane(similarity, scene.ground)
    return Scene(
        transform_rig(similarity, scene.rig),
        ground,
        xp.asarray(scale * scene.extent),
        scene.metric if metric is None else metric,
        _moved_georeference(similarity, scene, ground),
        None if scene.rig_sd is None else scale * scene.rig_sd,
    )


def _moved_georeference(similarity: Similarity, scene: Scene, ground: Plane) -> GeoReference | None:
    """Return the georeference of ground coordinates after a transform of scene and ground."""
    earth = scene.georeference
    if earth is None or is_traced(similarity.scale, similarity.translation, scene.ground.offset):
        return None
    corner = np.array(earth.origin) + np.array([[0.0, 0.0], [0.0, 1.0]])
    scale, turn = float(similarity.scale), np.asarray(similarity.rotation, np.float64)
    place = scale * from_plan(scene, corner) @ turn.T
    moved = place + np.asarray(similarity.translation, np.float64)
    origin, ahead = moved @ np.asarray(ground.basis, np.float64)
    away = ahead - origin
    return replace(
        earth,
        heading=earth.heading - float(np.rad2deg(np.arctan2(away[0], away[1]))),
        origin=(float(origin[0]), float(origin[1])),
        meters_per_unit=earth.meters_per_unit / scale,
    )


def _parts(similarity: Similarity, like: Any) -> tuple[Any, Any, Any, Any]:
    """Scale, rotation and translation as arrays with kind and dtype of `like`, and their module.

    Raises:
        InvalidInputError: if it is not a similarity of three dimensions.
    """
    require_instance(similarity, Similarity, "similarity")
    require_shape(similarity.translation, (3,), "The translation of the similarity")
    parts = (similarity.scale, similarity.rotation, similarity.translation)
    if isinstance(like, np.ndarray) and not is_traced(*parts):
        scale, rotation, translation = (np.asarray(part, like.dtype) for part in parts)
        return scale, rotation, translation, np
    scale, rotation, translation = (jnp.asarray(part, jnp.result_type(like)) for part in parts)
    return scale, rotation, translation, jnp
