"""Bundle adjustment of cameras and the people they see, with the people eliminated (Schur).

Every person is one 3-D point whose foot pixel is known in several cameras. The rotation, center and
focal length of each camera are free; the principal point is fixed. Feet lie close to one plane, on
which the focal length and height of a camera are nearly indistinguishable, so a prior ties the
cameras to their start, within the usual errors of a reconstruction. It also fixes frame and scale.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration._adjusted_cameras import NEAREST_DEPTH, Cameras

PARAMETERS = 7  # rotation vector, center, log focal length
HUBER = 1.345  # standard deviations; 95 % efficient where all errors are normal
RAYLEIGH_MEDIAN = 1.1774  # median length of a 2-D normal vector, in standard deviations
SMALLEST_NOISE = 0.1  # px: no box is more exact; avoids division by zero for exact data
FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e8
CONVERGED = 1e-6  # relative decrease of the cost that ends the iteration


@dataclass(frozen=True)
class CameraTie:
    """Standard deviations of the cameras from their start.

    Attributes:
        rotation: radians about each axis.
        center: along each axis, as a fraction of E.
        log_focal: of the natural logarithm of the focal length.
    """

    rotation: float = np.deg2rad(2.0)
    center: float = 0.03
    log_focal: float = 0.02

    @property
    def precision(self) -> Float[np.ndarray, "7"]:
        """(7,) inverse variances in parameter order."""
        deviation = [self.rotation] * 3 + [self.center] * 3 + [self.log_focal]
        return np.array(deviation) ** -2.0


@dataclass(frozen=True)
class Sightings:
    """Foot pixels of people, one row per person and one column per camera.

    Attributes:
        pixel: (P, C, 2) foot pixels without lens distortion; arbitrary where `weight` is 0.
        weight: (P, C) reliability, 0 where the camera does not see the person.
    """

    pixel: Float[np.ndarray, "person cam 2"]
    weight: Float[np.ndarray, "person cam"]

    @property
    def present(self) -> Bool[np.ndarray, "person cam"]:
        """(P, C) whether the camera sees the person."""
        return self.weight > 0


@dataclass(frozen=True)
class Adjustment:
    """An adjusted rig and its people.

    Attributes:
        cameras: the cameras.
        points: (P, 3) the people's feet.
        cost: robust cost at the end, in squared standard deviations.
        noise: standard deviation in pixels of a foot pixel of weight 1.
    """

    cameras: Cameras
    points: Float[np.ndarray, "person 3"]
    cost: float
    noise: float


def adjust(
    sightings: Sightings,
    cameras: Cameras,
    points: Float[np.ndarray, "person 3"],
    *,
    start: Cameras | None = None,
    tie: CameraTie | None = None,
    iterations: int = 10,
) -> Adjustment:
    """Adjust cameras and people to the foot pixels with Levenberg-Marquardt.

    Args:
        sightings: the foot pixels.
        cameras: initial cameras in the canonical frame (E = 1).
        points: (P, 3) initial people.
        start: the cameras that the prior ties to; `cameras` if None.
        tie: strength of the prior.
        iterations: maximum number of steps.

    Returns:
        The adjusted cameras and people. Cameras that see no people stay at `start`.

    Source:
        Sec. "Camera configuration and ground estimation"; Triggs et al. (2000), "Bundle
        adjustment: a modern synthesis", for the elimination of the points.
    """
    start = cameras if start is None else start
    precision = (CameraTie() if tie is None else tie).precision
    noise = _noise(sightings, cameras, points)
    linear = _linearize(sightings, cameras, points, noise)
    cost = linear.cost + _tie_cost(cameras, start, precision)
    damping = FIRST_DAMPING
    for _ in range(iterations):
        step, shift = _step(linear, cameras.away_from(start), precision, damping)
        trial, moved_points = cameras.moved(step), points + shift
        proposed = _linearize(sightings, trial, moved_points, noise)
        proposed_cost = proposed.cost + _tie_cost(trial, start, precision)
        if proposed_cost < cost:
            converged = cost - proposed_cost < CONVERGED * cost
            cameras, points, linear, cost = trial, moved_points, proposed, proposed_cost
            damping /= 10
            if converged:
                break
        else:
            damping *= 10
            if damping > LARGEST_DAMPING:
                break
    return Adjustment(cameras, points, cost, noise)


@dataclass(frozen=True)
class _Linear:
    """Standardized residuals and derivatives, multiplied by the square root of Huber's weight."""

    residual: Float[np.ndarray, "person cam 2"]
    by_camera: Float[np.ndarray, "person cam 2 7"]
    by_point: Float[np.ndarray, "person cam 2 3"]
    cost: float


def _project(
    cameras: Cameras, points: Float[np.ndarray, "person 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Camera coordinates, safe depths, whether in front, and offsets from the principal point."""
    local = np.einsum("cij,pcj->pci", cameras.R, points[:, None] - cameras.center)
    in_front = local[..., 2] > NEAREST_DEPTH
    depth = np.where(in_front, local[..., 2], 1.0)
    focal = cameras.K[:, :2, :2] * np.exp(cameras.log_scale)[:, None, None]
    offset = np.einsum("cij,pcj->pci", focal, local[..., :2] / depth[..., None])
    return local, depth, in_front, offset


def _residual(sightings: Sightings, cameras: Cameras, offset: np.ndarray) -> np.ndarray:
    pixel = np.where(sightings.present[..., None], sightings.pixel, 0.0)
    return pixel - offset - cameras.K[:, :2, 2]


def _noise(sightings: Sightings, cameras: Cameras, points: np.ndarray) -> float:
    """Estimate the standard deviation of a foot pixel of weight 1 from the median residual."""
    _, _, in_front, offset = _project(cameras, points)
    length = np.linalg.norm(_residual(sightings, cameras, offset), axis=-1)
    standard = (length * np.sqrt(sightings.weight))[sightings.present & in_front]
    median = float(np.median(standard)) if standard.size else 0.0
    return max(median / RAYLEIGH_MEDIAN, SMALLEST_NOISE)


def _linearize(sightings: Sightings, cameras: Cameras, points: np.ndarray, noise: float) -> _Linear:
    local, depth, in_front, offset = _project(cameras, points)
    used = sightings.present & in_front
    precision = np.where(used, np.sqrt(sightings.weight) / noise, 0.0)
    residual = _residual(sightings, cameras, offset) * precision[..., None]
    length = np.linalg.norm(residual, axis=-1)
    far = length > HUBER
    loss = np.where(far, HUBER * (2 * length - HUBER), length**2)
    # A point behind its camera costs as much as a residual of one image width.
    behind = sightings.present & ~in_front
    behind_cost = 2 * HUBER * np.sqrt(sightings.weight) * 2 * cameras.K[:, 0, 2] / noise
    scale = precision * np.sqrt(np.where(far, HUBER / np.where(far, length, 1.0), 1.0))

    focal = cameras.K[:, :2, :2] * np.exp(cameras.log_scale)[:, None, None]
    by_local = np.empty((*local.shape[:2], 2, 3))
    by_local[..., :2] = focal / depth[..., None, None]
    by_local[..., 2] = -offset / depth[..., None]
    by_local *= scale[..., None, None]
    by_point = np.einsum("pcij,cjk->pcik", by_local, cameras.R)
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    by_camera = np.empty((*local.shape[:2], 2, PARAMETERS))
    # d(turn y)/d(turn) = -[y]x, column by column.
    by_camera[..., 0] = by_local[..., 2] * y[..., None] - by_local[..., 1] * z[..., None]
    by_camera[..., 1] = by_local[..., 0] * z[..., None] - by_local[..., 2] * x[..., None]
    by_camera[..., 2] = by_local[..., 1] * x[..., None] - by_local[..., 0] * y[..., None]
    by_camera[..., 3:6] = -by_point
    by_camera[..., 6] = offset * scale[..., None]
    root = np.where(precision > 0, scale / np.where(precision > 0, precision, 1.0), 0.0)
    cost = float(loss[used].sum() + behind_cost[behind].sum())
    return _Linear(residual * root[..., None], by_camera, by_point, cost)


def _tie_cost(cameras: Cameras, start: Cameras, precision: np.ndarray) -> float:
    return float((cameras.away_from(start) ** 2 * precision).sum())


def _step(
    linear: _Linear, away: np.ndarray, precision: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the steps of the cameras, (C, 7), and of the people, (P, 3)."""
    people, count = linear.residual.shape[:2]
    size = count * PARAMETERS
    blocks = np.einsum("pcki,pckj->cij", linear.by_camera, linear.by_camera)
    normal = np.zeros((count, PARAMETERS, count, PARAMETERS))
    normal[np.arange(count), :, np.arange(count)] = blocks + np.diag(precision)
    normal = normal.reshape(size, size)
    gradient = np.einsum("pcki,pck->ci", linear.by_camera, linear.residual)
    gradient = (gradient - away * precision).reshape(size)

    point_normal = np.einsum("pcki,pckj->pij", linear.by_point, linear.by_point)
    point_gradient = np.einsum("pcki,pck->pi", linear.by_point, linear.residual)
    axis = np.arange(3)
    # The second term keeps an unconstrained person (all sightings behind cameras) in place.
    point_normal[:, axis, axis] *= 1 + damping
    point_normal[:, axis, axis] += 1e-9 * point_normal[:, axis, axis].sum(1, keepdims=True) + 1e-12
    inverse = np.linalg.inv(point_normal)
    mixed = np.einsum("pcki,pckj->pcij", linear.by_camera, linear.by_point)
    mixed = mixed.reshape(people, size, 3)
    eliminated = mixed @ inverse

    diagonal = np.arange(size)
    normal[diagonal, diagonal] *= 1 + damping
    reduced = normal - np.tensordot(eliminated, mixed, ([0, 2], [0, 2]))
    right = gradient - np.tensordot(eliminated, point_gradient, ([0, 2], [0, 1]))
    step = np.linalg.solve(reduced, right)
    shift = np.einsum("pij,pj->pi", inverse, point_gradient - np.einsum("psi,s->pi", mixed, step))
    return step.reshape(count, PARAMETERS), shift
