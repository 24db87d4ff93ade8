"""How well a rig can localize people, place by place, before anybody has walked there.

Only the cameras are needed: where two of them see the same ground, the angular noise of foot rays
says how uncertain a position there will be. Occlusion by other people and by walls is not known,
so every answer is an upper bound of what the site will deliver.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.association import CanonicalFrame
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry import angular_residual, ground_sigma, information, pixel_to_ray, project
from catfree.settings import RaySettings, SelectionSettings
from catfree.types import Plane, Rig, Scene
from catfree.types.validation import require_instance

Area = Sequence[float | int] | Float[np.ndarray, "4"]

SIGMA_THETA = RaySettings().sigma_theta
SUPPRESSION_RADIUS = SelectionSettings().suppression_radius
CELLS_PER_EXTENT = 100  # default resolution: a cell of E / 100 is half the suppression radius
PLACES_BLOCK = 4096  # places evaluated together; grids are padded to it, so that few sizes compile
# A lens polynomial can fold what lies far outside the picture back into it; the ray of such a pixel
# misses the place by far more than this angle in radians.
FOLD_TOLERANCE = 1e-2


class Coverage(eqx.Module):
    """Expected uncertainty and number of cameras over a rectangle of the ground.

    Attributes:
        x: (W,) first ground coordinate of the cell centres (along `Plane.basis`), scene units.
        y: (H,) second ground coordinate.
        visible: (C, H, W) which camera sees a person who stands in the cell.
        sigma: (H, W) expected ground uncertainty (Eq. sigma with w = 1) in scene units; inf where
            fewer than two cameras see the cell.
        radius: length in scene units within which `accuracy` counts a position as right.
    """

    x: Float[np.ndarray, " width"]
    y: Float[np.ndarray, " height"]
    visible: Bool[np.ndarray, "cam height width"]
    sigma: Float[np.ndarray, "height width"]
    radius: float

    @property
    def cameras(self) -> Int[np.ndarray, "height width"]:
        """(H, W) number of cameras that see each cell."""
        return self.visible.sum(axis=0)

    @property
    def xy(self) -> Float[np.ndarray, "height width 2"]:
        """(H, W, 2) ground coordinates of the cell centres."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)

    @property
    def area(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max of the outer edges of the cells."""
        edges = []
        for centres in (self.x, self.y):
            half = (centres[1] - centres[0]) / 2 if len(centres) > 1 else self.radius / 2
            edges += [float(centres[0] - half), float(centres[-1] + half)]
        return edges[0], edges[1], edges[2], edges[3]

    @property
    def covered(self) -> float:
        """Share of the area that at least two cameras see: elsewhere nobody can be localized."""
        return float((self.cameras >= 2).mean())

    @property
    def median_sigma(self) -> float:
        """Median uncertainty over the area; inf if less than half of it is covered."""
        return float(np.sort(self.sigma, axis=None)[self.sigma.size // 2])

    @property
    def accuracy(self) -> float:
        """Chance that a person anywhere in the area is localized within `radius`.

        The mean of `1 - exp(-radius² / (2 sigma²))`, the mass of an isotropic Gaussian in a disc;
        0 where sigma is infinite. One finite number that never falls when a camera is added.
        """
        with np.errstate(over="ignore"):
            return float(np.mean(-np.expm1(-((self.radius / self.sigma) ** 2) / 2)))

    def __str__(self) -> str:
        return (
            f"{100 * self.covered:.0f} % of the area seen by two cameras, median sigma "
            f"{self.median_sigma:.3g}, {100 * self.accuracy:.0f} % of positions expected within "
            f"{self.radius:.3g}"
        )


class CameraRanking(eqx.Module):
    """What the rig would lose with each of its cameras.

    Attributes:
        order: (K,) the registered cameras, the one that matters least first.
        accuracy: `Coverage.accuracy` of the whole rig.
        accuracy_without: (K,) the same without each camera of `order`.
        covered_without: (K,) share of the area then seen by two cameras.
        median_sigma_without: (K,) median sigma then, scene units.
    """

    order: Int[np.ndarray, " k"]
    accuracy: float
    accuracy_without: Float[np.ndarray, " k"]
    covered_without: Float[np.ndarray, " k"]
    median_sigma_without: Float[np.ndarray, " k"]


def coverage(
    scene: Scene,
    area: Area | None = None,
    *,
    resolution: float | int | None = None,
    sigma_theta: float | int = SIGMA_THETA,
    person_height: float | int | None = None,
) -> Coverage:
    """Where on the ground this rig can localize people, and how precisely.

    Args:
        scene: cameras, ground and extent.
        area: x_min, x_max, y_min, y_max in ground coordinates (`Plane.basis`), scene units; None
            for `visible_area(scene)`.
        resolution: side of a cell in scene units; None for E / 100.
        sigma_theta: angular noise of a foot ray in radians.
        person_height: a person counts as seen only if the head, so far above the feet (scene
            units), is inside the picture too; None looks at the feet alone.

    Returns:
        The map. It moves with the scene under similarity transforms.

    Raises:
        InsufficientDataError: if fewer than two cameras are registered.
        InvalidInputError: if the area is empty, or resolution or sigma_theta is not positive.

    Source:
        paper, Eq. sigma, with the true directions and weight 1.
    """
    require_instance(scene, Scene, "scene")
    known = np.asarray(scene.rig.registered)
    return _coverage(scene, known, area, resolution, sigma_theta, person_height)


def coverage_without(
    scene: Scene, camera: int, area: Area | None = None, **options: Any
) -> Coverage:
    """The coverage that is left if one camera fails.

    Args:
        scene: cameras, ground and extent.
        camera: index of the camera to leave out.
        area: as in `coverage`; None for the area of the whole rig, so that maps can be compared.
        **options: the other options of `coverage`.

    Raises:
        InvalidInputError: if there is no such camera.
    """
    count = scene.rig.camera_count
    if not 0 <= camera < count:
        raise InvalidInputError(
            f"There is no camera {camera}; the rig has cameras 0 to {count - 1}."
        )
    active = np.asarray(scene.rig.registered) & (np.arange(count) != camera)
    filled = {"resolution": None, "sigma_theta": SIGMA_THETA, "person_height": None} | options
    return _coverage(scene, active, area, **filled)


def coverage_with(
    scene: Scene,
    K: Float[np.ndarray | Array, "3 3"],
    R: Float[np.ndarray | Array, "3 3"],
    t: Float[np.ndarray | Array, "3"],
    image_size: Any,
    area: Area | None = None,
    **options: Any,
) -> Coverage:
    """The coverage with one camera more, which stands nowhere yet.

    Args:
        scene: cameras, ground and extent.
        K: (3, 3) intrinsics of the new camera in pixels.
        R: (3, 3) its world-to-camera rotation.
        t: (3,) its world-to-camera translation in scene units.
        image_size: (2,) its width and height in pixels.
        area: as in `coverage`; None for the area of the present rig, so that maps can be compared.
        **options: the other options of `coverage`.

    Returns:
        Coverage whose last camera is the new one.
    """
    rig = scene.rig

    def append(values: Any, more: Any) -> np.ndarray:
        return np.concatenate([np.asarray(values, np.float64), np.asarray(more, np.float64)[None]])

    larger = Rig(
        append(rig.K, K),
        append(rig.R, R),
        append(rig.t, t),
        append(rig.image_size, image_size),
        None if rig.distortion is None else append(rig.distortion, np.zeros(5)),
        np.append(rig.registered, True),
    )
    area = visible_area(scene) if area is None else area
    ground = Plane(np.asarray(scene.ground.normal, np.float64), np.float64(scene.ground.offset))
    extent = np.float64(scene.extent)
    return coverage(Scene(larger, ground, extent, scene.metric), area, **options)


def rank_cameras(scene: Scene, area: Area | None = None, **options: Any) -> CameraRanking:
    """Which camera matters least, and what each one is worth.

    Args:
        scene: cameras, ground and extent.
        area: as in `coverage`.
        **options: the other options of `coverage`.

    Returns:
        Cameras sorted by the accuracy that is left without them, the most dispensable first.
    """
    area = visible_area(scene) if area is None else area
    cameras = np.flatnonzero(scene.rig.registered)
    rest = [coverage_without(scene, int(camera), area, **options) for camera in cameras]
    left = np.array([one.accuracy for one in rest])
    order = np.argsort(-left, kind="stable")
    return CameraRanking(
        order=cameras[order],
        accuracy=coverage(scene, area, **options).accuracy,
        accuracy_without=left[order],
        covered_without=np.array([one.covered for one in rest])[order],
        median_sigma_without=np.array([one.median_sigma for one in rest])[order],
    )


def visible_area(scene: Scene) -> tuple[float, float, float, float]:
    """The rectangle around the ground that at least two cameras see, not beyond E from the rig.

    Returns:
        x_min, x_max, y_min, y_max in ground coordinates, scene units; the square of side 2 E
        around the cameras' middle if no two of them see any common ground.
    """
    known = np.asarray(scene.rig.registered)
    _require_two(known)
    middle = np.asarray(scene.rig.centers, np.float64)[known].mean(0) @ np.asarray(
        scene.ground.basis, np.float64
    )
    reach, extent = np.linspace(-1, 1, CELLS_PER_EXTENT + 1), float(scene.extent)
    offset = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    offset = offset[np.linalg.norm(offset, axis=-1) <= 1]
    visible, _ = _look(scene, known, middle + extent * offset, SIGMA_THETA, None)
    shared = offset[visible.sum(0) >= 2]
    shared = offset if len(shared) == 0 else shared
    margin = 1 / CELLS_PER_EXTENT
    low = middle + extent * (shared.min(0) - margin)
    high = middle + extent * (shared.max(0) + margin)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _require_two(registered: Bool[np.ndarray, " cam"]) -> None:
    if registered.sum() < 2:
        raise InsufficientDataError(
            f"Coverage needs at least 2 registered cameras, got {int(registered.sum())}: one ray "
            "alone cannot be triangulated."
        )


def _coverage(
    scene: Scene,
    active: Bool[np.ndarray, " cam"],
    area: Area | None,
    resolution: float | int | None,
    sigma_theta: float | int,
    person_height: float | int | None,
) -> Coverage:
    _require_two(np.asarray(scene.rig.registered))
    extent = float(scene.extent)
    cell = extent / CELLS_PER_EXTENT if resolution is None else float(resolution)
    if not (np.isfinite(cell) and cell > 0):
        raise InvalidInputError(f"resolution is {cell}; it must be a positive length.")
    if not sigma_theta > 0:
        raise InvalidInputError(f"sigma_theta is {sigma_theta}; it must be a positive angle.")
    bounds = visible_area(scene) if area is None else tuple(float(edge) for edge in area)
    if len(bounds) != 4 or not (bounds[0] < bounds[1] and bounds[2] < bounds[3]):
        raise InvalidInputError(
            f"area is {bounds}; it must be (x_min, x_max, y_min, y_max) with min < max."
        )
    x, y = _cell_centres(bounds[0], bounds[1], cell), _cell_centres(bounds[2], bounds[3], cell)
    places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    visible, sigma = _look(scene, active, places, sigma_theta, person_height)
    shape = (len(y), len(x))
    return Coverage(
        x, y, visible.reshape(-1, *shape), sigma.reshape(shape), SUPPRESSION_RADIUS * extent
    )


def _cell_centres(low: float, high: float, cell: float) -> np.ndarray:
    count = max(int(np.ceil((high - low) / cell - 1e-6)), 1)
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _look(
    scene: Scene,
    active: Bool[np.ndarray, " cam"],
    places: Float[np.ndarray, "n 2"],
    sigma_theta: float | int,
    person_height: float | int | None,
) -> tuple[Bool[np.ndarray, "cam n"], Float[np.ndarray, " n"]]:
    """Who sees each place of the ground, and the sigma in scene units."""
    frame = CanonicalFrame.of(scene)
    rig = frame.rig(scene.rig)
    normal = np.asarray(scene.ground.normal, np.float64)
    on_plane = -np.asarray(scene.ground.offset, np.float64) * normal
    world = places @ np.asarray(scene.ground.basis, np.float64).T + on_plane
    count = len(places)
    points = np.pad(frame.to_canonical(world), ((0, -count % PLACES_BLOCK), (0, 0)))
    points[:, 2] = 0
    height = None if person_height is None else jnp.asarray(person_height / frame.extent)
    # A camera that is not registered may hold NaN.
    K, R, t = (
        jnp.asarray(np.where(np.reshape(active, (-1,) + (1,) * (a.ndim - 1)), a, b))
        for a, b in ((rig.K, np.eye(3)), (rig.R, np.eye(3)), (rig.t, np.zeros(3)))
    )
    distortion = None
    if rig.distortion is not None:
        distortion = jnp.asarray(np.where(active[:, None], rig.distortion, 0))
    visible, sigma = _look_everywhere(
        jnp.asarray(points),
        K,
        R,
        t,
        jnp.asarray(rig.image_size, K.dtype),
        distortion,
        jnp.asarray(active),
        jnp.asarray(sigma_theta, K.dtype),
        height,
    )
    return np.asarray(visible)[:count].T, np.asarray(sigma, np.float64)[:count] * frame.extent


@jax.jit
def _look_everywhere(points: Array, *rig: Any) -> tuple[Array, Array]:
    blocks = points.reshape(-1, PLACES_BLOCK, 3)
    visible, sigma = jax.lax.map(jax.vmap(lambda point: _look_at(point, *rig)), blocks)
    return visible.reshape(len(points), -1), sigma.reshape(-1)


def _look_at(
    point: Array,
    K: Array,
    R: Array,
    t: Array,
    size: Array,
    distortion: Array | None,
    active: Array,
    sigma_theta: Array,
    height: Array | None,
) -> tuple[Array, Array]:
    """(C,) who sees a canonical ground point, and its sigma as a share of E."""
    inside = partial(_inside, distorted=distortion is not None)
    see = jax.vmap(inside, (0, 0, 0, 0, None if distortion is None else 0, None))
    visible = active & see(K, R, t, size, distortion, point)
    if height is not None:
        head = point + jnp.array([0, 0, 1], point.dtype) * height.astype(point.dtype)
        visible = visible & see(K, R, t, size, distortion, head)
    origins = -jnp.einsum("cji,cj->ci", R, t)
    sight = point[None, :] - origins
    length = jnp.sqrt(jnp.sum(sight * sight, axis=-1))
    directions = sight / jnp.where(length > 0, length, 1)[:, None]
    matrix = information(point, origins, directions, visible.astype(point.dtype), sigma_theta)
    ground = Plane(jnp.array([0, 0, 1], point.dtype), jnp.zeros((), point.dtype))
    return visible, ground_sigma(matrix, ground)


def _inside(
    K: Array,
    R: Array,
    t: Array,
    size: Array,
    distortion: Array | None,
    point: Array,
    *,
    distorted: bool,
) -> Array:
    """Whether a camera has a point in its picture (whose border is half a pixel out)."""
    pixel, depth = project(K, R, t, point, distortion)
    inside = (depth > 0) & jnp.all((pixel >= -0.5) & (pixel <= size - 0.5))
    if distorted:
        origin, direction = pixel_to_ray(K, R, t, pixel, distortion)
        inside = inside & (angular_residual(point, origin, direction) < FOLD_TOLERANCE)
    return inside
