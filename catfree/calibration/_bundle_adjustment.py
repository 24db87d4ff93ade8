"""Bundle adjustment of cameras and people's feet.

Every person is one 3-D point whose foot pixel is known in several cameras. The rotation, center and
focal length of each camera are free; the principal point is fixed. Feet lie close to one plane, on
which the focal length and height of a camera are nearly indistinguishable, so a prior ties the
cameras to their start, within the usual errors of a reconstruction. It also fixes frame and scale.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from catfree.calibration._adjusted_cameras import moved_rig
from catfree.geometry._arrays import safe_norm
from catfree.geometry._buckets import padded, padded_length
from catfree.geometry._least_squares import (
    HUBER,
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    huber,
    minimize,
    robust,
)
from catfree.types import Rig

NEAREST_DEPTH = 1e-6  # fraction of E; closer points, or points behind the camera, have no pixel
RAYLEIGH_MEDIAN = 1.1774  # median length of a 2-D normal vector, in standard deviations
SMALLEST_NOISE = 0.1  # px: no box is more exact; avoids division by zero for exact data
CONVERGED = 1e-6  # relative decrease of the cost that ends the iteration
DAMPING, FALL = 1e-4, 10.0  # rounds stop before convergence, so quick steps matter
PEOPLE_BLOCK, CAMERA_BLOCK = 1024, 4  # people and cameras are padded to multiples of these
# Standard deviations from the start, of cameras and of the ground: about each axis in radians,
# along each axis as a fraction of E, and of the natural logarithm of the focal length.
ROTATION_SD, CENTER_SD, FOCAL_SD = np.deg2rad(2.0), 0.03, 0.02
STEP_SD = np.array([ROTATION_SD] * 3 + [CENTER_SD] * 3 + [FOCAL_SD])


def adjust(
    pixel: Float[np.ndarray, "person cam 2"],
    weight: Float[np.ndarray, "person cam"],
    start: Rig,
    step: Float[np.ndarray, "cam 7"],
    points: Float[np.ndarray, "person 3"],
    *,
    iterations: int,
) -> Float[np.ndarray, "cam 7"]:
    """Adjust cameras and people to the foot pixels with Levenberg-Marquardt.

    Args:
        pixel: (P, C, 2) foot pixels without lens distortion; arbitrary where `weight` is 0.
        weight: (P, C) reliability, 0 where the camera does not see the person.
        start: the cameras that the prior ties to, in the canonical frame (E = 1).
        step: (C, 7) initial step from `start` (`moved_rig`).
        points: (P, 3) initial people.
        iterations: maximum number of steps.

    Returns:
        (C, 7) step of the adjusted cameras. Those that see no people stay at `start`.

    Source:
        Sec. "Camera configuration and ground estimation"; Triggs et al. (2000), "Bundle
        adjustment: a modern synthesis", for the elimination of the points.
    """
    noise = _noise(pixel, weight, moved_rig(start, step), points)
    K, R, center = (np.nan_to_num(part) for part in (start.K, start.R, start.centers))
    people, count = weight.shape
    P, C = padded_length(people, PEOPLE_BLOCK), count + -count % CAMERA_BLOCK
    pixel = np.where(weight[..., None] > 0, pixel, 0.0)
    with jax.enable_x64(True):
        solution = _solve(
            Unknowns(padded(step, C), padded(points, P)),
            _Feet(
                offset=padded((pixel - K[:, :2, 2]).swapaxes(0, 1), C, P),
                precision=padded(np.sqrt(weight).T / noise, C, P),
                R=padded(R, C),
                center=padded(center, C),
                focal=padded(K[:, :2, :2], C),
                image=padded(2 * K[:, 0, 2], C),
            ),
            jnp.asarray(iterations, jnp.int32),
        )
        return np.array(solution.view)[:count]


class _Feet(NamedTuple):
    """Inputs of the residuals.

    Attributes:
        offset: (C, P, 2) foot pixels relative to the principal point.
        precision: (C, P) inverse standard deviations in pixels, 0 where there is no foot.
        R: (C, 3, 3) rotations before the step.
        center: (C, 3) centers before the step.
        focal: (C, 2, 2) focal lengths before the step.
        image: (C,) image widths in pixels.
    """

    offset: Float[Array, "cam person 2"]
    precision: Float[Array, "cam person"]
    R: Float[Array, "cam 3 3"]
    center: Float[Array, "cam 3"]
    focal: Float[Array, "cam 2 2"]
    image: Float[Array, " cam"]


def _rotation(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation by a vector (Rodrigues), differentiable at zero."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    K = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    turns = safe_norm(vector) / jnp.pi
    half = jnp.sinc(turns / 2)
    return jnp.eye(3, dtype=x.dtype) + jnp.sinc(turns) * K + half**2 / 2 * (K @ K)


def _problem(
    unknowns: Unknowns, args: tuple[Float[Array, "0"], _Feet]
) -> tuple[Residuals, Residuals]:
    """Residuals of the steps of all cameras (C, 7) and of people (P, 3)."""
    feet = args[1]

    def foot(
        pose: Float[Array, "3 4"],
        focal: Float[Array, "2 2"],
        image: Float[Array, ""],
        offset: Float[Array, "2"],
        precision: Float[Array, ""],
        point: Float[Array, "3"],
    ) -> Float[Array, "2"]:
        x, y, z = (
            row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3] for row in pose
        )
        in_front = z > NEAREST_DEPTH
        depth = jnp.where(in_front, z, 1.0)
        u, v = (row[0] * x / depth + row[1] * y / depth for row in focal)
        # A point behind its camera costs as much as a residual of one image width.
        column = jnp.where(in_front, u - offset[0], image)
        return jnp.stack([column, jnp.where(in_front, v - offset[1], 0.0)]) * precision

    step = unknowns.view
    R = jnp.einsum("cij,cjk->cik", jax.vmap(_rotation)(step[:, :3]), feet.R)
    t = -jnp.einsum("cij,cj->ci", R, feet.center + step[:, 3:6])
    focal = feet.focal * jnp.exp(step[:, 6])[:, None, None]
    of_camera = jax.vmap(foot, (None, None, None, 0, 0, 0))
    residual = jax.vmap(of_camera, (0, 0, 0, 0, 0, None))(
        jnp.concatenate([R, t[..., None]], axis=2),
        focal,
        feet.image,
        feet.offset,
        feet.precision,
        unknowns.block,
    )
    residuals = Residuals(
        residual[:, :, None], (step / STEP_SD[None]).ravel(), jnp.zeros((len(unknowns.block), 0))
    )
    return robust(residuals, partial(huber, width=HUBER))


@jax.jit
def _solve(start: Unknowns, feet: _Feet, most_steps: Array) -> Unknowns:
    args = jnp.zeros(0, start.view.dtype), feet
    solver = SchurLevenbergMarquardt(
        CONVERGED, 0.0, damping=DAMPING, fall=FALL, most_steps=most_steps
    )
    return minimize(_problem, start, args, solver).value


def project_directions(
    rig: Rig, direction: Float[np.ndarray, "person cam 3"]
) -> Float[np.ndarray, "person cam 2"]:
    """Pixels, without lens distortion, of world directions; arbitrary behind the camera."""
    local = np.einsum("cij,pcj->pci", rig.R, direction)
    depth = np.where(local[..., 2] > NEAREST_DEPTH, local[..., 2], 1.0)
    offset = np.einsum("cij,pcj->pci", rig.K[:, :2, :2], local[..., :2] / depth[..., None])
    return offset + rig.K[:, :2, 2]


def _noise(
    pixel: Float[np.ndarray, "person cam 2"],
    weight: Float[np.ndarray, "person cam"],
    rig: Rig,
    points: Float[np.ndarray, "person 3"],
) -> float:
    """Estimate the standard deviation of a foot pixel of weight 1 from the median residual."""
    direction = points[:, None] - rig.centers
    in_front = np.einsum("ci,pci->pc", rig.R[:, 2], direction) > NEAREST_DEPTH
    length = np.linalg.norm(pixel - project_directions(rig, direction), axis=-1)
    standard = (length * np.sqrt(weight))[(weight > 0) & in_front]
    median = float(np.median(standard)) if standard.size else 0.0
    return max(median / RAYLEIGH_MEDIAN, SMALLEST_NOISE)
