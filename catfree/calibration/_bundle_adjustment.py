"""Bundle adjustment of cameras and the people they see, with the people eliminated (Schur).

Every person is one 3-D point whose foot pixel is known in several cameras. Free are the rotation,
centre and focal length of each camera; the principal point is not. Feet lie close to one plane, in
which focal length and height of a camera are hardly told apart, so the cameras are also tied to
where they started, within errors that a reconstruction has. That tie fixes frame and scale too.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration._adjusted_cameras import NEAREST_DEPTH, Cameras

PARAMETERS = 7  # rotation vector, centre, log focal length
HUBER = 1.345  # standard deviations; 95 % efficient where all errors are normal
RAYLEIGH_MEDIAN = 1.1774  # median length of a 2-D normal vector, in standard deviations
SMALLEST_NOISE = 0.1  # px: boxes are not more exact, and exact data must not divide by zero
FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e8
CONVERGED = 1e-6  # relative fall of the cost that ends the iteration


@dataclass(frozen=True)
class CameraTie:
    """How far cameras may be from where they started: standard deviations.

    Attributes:
        rotation: radians about each axis.
        center: along each axis, as a share of E.
        log_focal: of the logarithm of the focal length.
    """

    rotation: float = np.deg2rad(2.0)
    center: float = 0.03
    log_focal: float = 0.02

    @property
    def precision(self) -> Float[np.ndarray, "7"]:
        """(7,) inverse variances in the order of the parameters."""
        deviation = [self.rotation] * 3 + [self.center] * 3 + [self.log_focal]
        return np.array(deviation) ** -2.0


@dataclass(frozen=True)
class Sightings:
    """Foot pixels of people, one row a person and one column a camera.

    Attributes:
        pixel: (P, C, 2) foot pixels without lens distortion; anything where weight is 0.
        weight: (P, C) reliability, 0 where the camera does not see the person.
    """

    pixel: Float[np.ndarray, "person cam 2"]
    weight: Float[np.ndarray, "person cam"]

    @property
    def present(self) -> Bool[np.ndarray, "person cam"]:
        """(P, C) who is seen by whom."""
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
    """Adjust cameras and people to the foot pixels, by Levenberg and Marquardt's method.

    Args:
        sightings: who is seen where.
        cameras: where the iteration begins, in the canonical frame (E = 1).
        points: (P, 3) where the people begin.
        start: what the cameras are tied to; `cameras` if None.
        tie: how strongly.
        iterations: at most this many steps.

    Returns:
        The adjusted cameras and people. Cameras that see nobody stay at `start`.

    Source:
        Sec. "Camera configuration and ground estimation"; Triggs et al. (2000), "Bundle
        adjustment: a modern synthesis", for the elimination of the points.
    """
    start = cameras if start is None else start
    precision = (CameraTie() if tie is None else tie).precision
    noise = _noise(sightings, cameras, points)
    linear = _linearise(sightings, cameras, points, noise)
    cost = linear.cost + _tie_cost(cameras, start, precision)
    damping = FIRST_DAMPING
    for _ in range(iterations):
        step, shift = _step(linear, cameras.away_from(start), precision, damping)
        trial, placed = cameras.moved(step), points + shift
        proposed = _linearise(sightings, trial, placed, noise)
        lower = proposed.cost + _tie_cost(trial, start, precision)
        if lower < cost:
            settled = cost - lower < CONVERGED * cost
            cameras, points, linear, cost = trial, placed, proposed, lower
            damping /= 10
            if settled:
                break
        else:
            damping *= 10
            if damping > LARGEST_DAMPING:
                break
    return Adjustment(cameras, points, cost, noise)


@dataclass(frozen=True)
class _Linear:
    """Standardised residuals and derivatives, all multiplied by the root of Huber's weight."""

    residual: Float[np.ndarray, "person cam 2"]
    by_camera: Float[np.ndarray, "person cam 2 7"]
    by_point: Float[np.ndarray, "person cam 2 3"]
    cost: float


def _project(
    cameras: Cameras, points: Float[np.ndarray, "person 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points in the cameras, their depths with a floor, who is in front, and their pixels."""
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
    """Standard deviation of a foot pixel of weight 1, from the median residual."""
    _, _, in_front, offset = _project(cameras, points)
    length = np.linalg.norm(_residual(sightings, cameras, offset), axis=-1)
    standard = (length * np.sqrt(sightings.weight))[sightings.present & in_front]
    median = float(np.median(standard)) if standard.size else 0.0
    return max(median / RAYLEIGH_MEDIAN, SMALLEST_NOISE)


def _linearise(sightings: Sightings, cameras: Cameras, points: np.ndarray, noise: float) -> _Linear:
    local, depth, in_front, offset = _project(cameras, points)
    used = sightings.present & in_front
    precision = np.where(used, np.sqrt(sightings.weight) / noise, 0.0)
    residual = _residual(sightings, cameras, offset) * precision[..., None]
    length = np.linalg.norm(residual, axis=-1)
    far = length > HUBER
    loss = np.where(far, HUBER * (2 * length - HUBER), length**2)
    # A sighting that fell behind its camera costs as much as one at the other end of the picture.
    behind = sightings.present & ~in_front
    hopeless = 2 * HUBER * np.sqrt(sightings.weight) * 2 * cameras.K[:, 0, 2] / noise
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
    cost = float(loss[used].sum() + hopeless[behind].sum())
    return _Linear(residual * root[..., None], by_camera, by_point, cost)


def _tie_cost(cameras: Cameras, start: Cameras, precision: np.ndarray) -> float:
    return float((cameras.away_from(start) ** 2 * precision).sum())


def _step(
    linear: _Linear, away: np.ndarray, precision: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """Steps of the cameras, (C, 7), and of the people, (P, 3)."""
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
    # The second term keeps a person whom nothing holds (all sightings behind) in place.
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
