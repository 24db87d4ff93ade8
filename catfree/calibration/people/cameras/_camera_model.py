"""Seven-parameter camera in an upright world, and the box of a standing person in its image.

A camera is (log f, tilt, roll, pan, X, Y, Z): focal length in pixels, angle of the optical axis
below the horizon, rotation about it, heading, and center in meters over the ground z = 0. Pixels
are relative to the principal point, which is fixed at the image center: freeing it allows the rig
to warp.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

LOG_FOCAL, TILT, ROLL, PAN, X, Y, Z = range(7)
K1 = 7  # radial distortion, which follows the seven parameters in the bundle adjustment


def rotation(parameters: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 3 3"]:
    """World-to-camera rotations (..., 3, 3) of parameters (..., 7)."""
    return _rotation(parameters)


def _rotation(parameters: Any) -> Any:
    """`rotation` of NumPy or JAX arrays."""
    xp = parameters.__array_namespace__()
    tilt, roll, pan = (parameters[..., i] for i in (TILT, ROLL, PAN))
    st, ct, sp, cp = (g(a) for a in (tilt, pan) for g in (xp.sin, xp.cos))
    # Before roll: x to the right along the ground, y down, z forward and down.
    right = xp.stack([cp, sp, xp.zeros_like(cp)], axis=-1)
    down = xp.stack([st * sp, -st * cp, -ct], axis=-1)
    forward = xp.stack([-ct * sp, ct * cp, -st], axis=-1)
    sr, cr = xp.sin(roll)[..., None], xp.cos(roll)[..., None]
    return xp.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-2)


def projection(parameters: Float[Array, "7"]) -> Float[Array, "3 4"]:
    """Projection (3, 4) of homogeneous world points to pixels from the image center."""
    R, one = _rotation(parameters), jnp.ones((), parameters.dtype)
    focal = jnp.exp(parameters[LOG_FOCAL])
    pose = jnp.concatenate([R, -(R @ parameters[X:])[:, None]], axis=1)
    return jnp.stack([focal, focal, one])[:, None] * pose


def project(
    parameters: Float[np.ndarray, "7"], points: Float[np.ndarray, "*n 3"]
) -> tuple[Float[np.ndarray, "*n 2"], Float[np.ndarray, "*n"]]:
    """Pixels (..., 2) and depths (...) of world points (..., 3) in one camera (7,)."""
    local = (points - parameters[X:]) @ rotation(parameters).T
    depth = local[..., 2]
    safe = np.where(depth > 1e-3, depth, 1.0)
    return np.exp(parameters[LOG_FOCAL]) * local[..., :2] / safe[..., None], depth


def predict_boxes(
    parameters: Float[np.ndarray, "7"],
    xy: Float[np.ndarray, "*n 2"],
    height: Float[np.ndarray, "*n"],
    foot_offset: float,
) -> tuple[Float[np.ndarray, "*n 3"], Bool[np.ndarray, "*n"]]:
    """Predict the boxes of standing people in one camera.

    Args:
        parameters: (7,) the camera.
        xy: (..., 2) ground positions in meters.
        height: (...) person heights in meters.
        foot_offset: meters by which the visible foot is closer to the camera.

    Returns:
        (..., 3) horizontal center, top row and bottom row in pixels from the image center, and
        (...) whether the person is in front of the camera.
    """
    toward = xy - parameters[X:Z]
    distance = np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-6)
    foot = xy - foot_offset * toward / distance
    foot_pixel, foot_depth = project(
        parameters, np.concatenate([foot, np.zeros_like(distance)], -1)
    )
    head_pixel, head_depth = project(parameters, np.concatenate([xy, height[..., None]], -1))
    box = np.stack(
        [
            (foot_pixel[..., 0] + head_pixel[..., 0]) / 2,
            head_pixel[..., 1],
            foot_pixel[..., 1],
        ],
        -1,
    )
    return box, (foot_depth > 0.1) & (head_depth > 0.1)


def to_matrices(
    parameters: Float[np.ndarray, "cam 7"], size: Int[np.ndarray, "cam 2"]
) -> tuple[Float[np.ndarray, "cam 3 3"], Float[np.ndarray, "cam 3 3"], Float[np.ndarray, "cam 3"]]:
    """Convert parameters (C, 7) and image sizes (C, 2) to K (C, 3, 3), R (C, 3, 3) and t (C, 3)."""
    R = rotation(parameters)
    K = np.zeros((len(parameters), 3, 3))
    K[:, 0, 0] = K[:, 1, 1] = np.exp(parameters[:, LOG_FOCAL])
    K[:, :2, 2] = (size - 1) / 2
    K[:, 2, 2] = 1
    return K, R, -np.einsum("cij,cj->ci", R, parameters[:, X:])


def from_matrices(
    K: Float[np.ndarray, "cam 3 3"],
    R: Float[np.ndarray, "cam 3 3"],
    t: Float[np.ndarray, "cam 3"],
) -> Float[np.ndarray, "cam 7"]:
    """Convert matrices to parameters over the ground z = 0; the inverse of `to_matrices`.

    Args:
        K: (C, 3, 3) intrinsics in pixels; only the focal length is used.
        R: (C, 3, 3) world-to-camera rotations.
        t: (C, 3) world-to-camera translations in meters.

    Returns:
        (C, 7) parameters.
    """
    out = np.empty((len(K), 7))
    out[:, LOG_FOCAL] = np.log(K[:, 0, 0])
    out[:, TILT] = np.arcsin(np.clip(-R[:, 2, 2], -1, 1))
    out[:, ROLL] = np.arctan2(-R[:, 0, 2], -R[:, 1, 2])
    out[:, PAN] = np.arctan2(-R[:, 2, 0], R[:, 2, 1])
    out[:, X:] = -np.einsum("cji,cj->ci", R, t)
    return out
