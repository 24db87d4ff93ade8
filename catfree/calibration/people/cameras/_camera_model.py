"""Seven-parameter camera in an upright world.

A camera is (log f, tilt, roll, pan, X, Y, Z): focal length in pixels, angle of the optical axis
below the horizon, rotation about it, heading, and center in meters over the ground z = 0. Pixels
are relative to the principal point, which is fixed at the image center, because freeing it would
let the rig warp.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.settings import CalibrationSettings
from catfree.types import Rig, Scene
from catfree.types._annotations import HostOrDevice
from catfree.types._scene import metric_scene

# The bundle adjustment appends the radial distortion k1 to the seven parameters of a camera.
LOG_FOCAL, TILT, ROLL, PAN, X, Y, Z, K1 = range(8)


def rotation(parameters: Float[HostOrDevice, "*n 7"]) -> Any:
    """World-to-camera rotations (..., 3, 3) of parameters (..., 7), of NumPy or JAX."""
    xp = parameters.__array_namespace__()
    tilt, roll, pan = (parameters[..., i] for i in (TILT, ROLL, PAN))
    st, ct, sp, cp = (g(a) for a in (tilt, pan) for g in (xp.sin, xp.cos))
    # Before roll: x to the right along the ground, y down, z forward and down.
    right = xp.stack([cp, sp, xp.zeros_like(cp)], axis=-1)
    down = xp.stack([st * sp, -st * cp, -ct], axis=-1)
    forward = xp.stack([-ct * sp, ct * cp, -st], axis=-1)
    sr, cr = xp.sin(roll)[..., None], xp.cos(roll)[..., None]
    return xp.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-2)


def projection(parameters: Float[HostOrDevice, "*n 7"]) -> Any:
    """Projections (..., 3, 4) of homogeneous world points to pixels from the image center."""
    xp = parameters.__array_namespace__()
    R, focal = rotation(parameters), xp.exp(parameters[..., LOG_FOCAL])
    pose = xp.concatenate([R, -(R @ parameters[..., X:, None])], axis=-1)
    return xp.stack([focal, focal, xp.ones_like(focal)], axis=-1)[..., None] * pose


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


def usual_focal(
    size: Int[np.ndarray, "cam 2"], settings: CalibrationSettings
) -> Float[np.ndarray, " cam"]:
    """(C,) middle of the focal lengths to try, in pixels, for image sizes (C, 2)."""
    return np.median(settings.focal_shares) * size.max(1)


def scene_of(
    parameters: Float[np.ndarray, "cam 7"],
    size: Int[np.ndarray, "cam 2"],
    k1: Float[np.ndarray, " cam"],
) -> Scene:
    """Make the metric scene of cameras over the ground z = 0; NaN cameras are not registered.

    Args:
        parameters: (C, 7) cameras.
        size: (C, 2) image widths and heights in pixels.
        k1: (C,) radial distortion; if all are 0, the rig has no distortion.
    """
    registered = np.isfinite(parameters[:, LOG_FOCAL])
    K, R, t = to_matrices(parameters, size)
    K[~registered] = np.nan
    distortion = np.zeros((len(k1), 5))
    distortion[:, 0] = np.where(registered, k1, 0.0)
    rig = Rig(K, R, t, size, distortion if distortion.any() else None, registered)
    return metric_scene(rig)


def of_rig(rig: Rig) -> Float[np.ndarray, "cam 7"]:
    """Parameters (C, 7) of a rig's registered cameras over the ground z = 0; NaN for others."""
    parameters = from_matrices(*(np.asarray(part, np.float64) for part in (rig.K, rig.R, rig.t)))
    return np.where(rig.registered[:, None], parameters, np.nan)


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
