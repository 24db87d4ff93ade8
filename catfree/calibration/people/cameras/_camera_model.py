"""Seven-parameter camera in an upright world, and the box of a standing person in its image.

A camera is (log f, tilt, roll, pan, X, Y, Z): focal length in pixels, angle of the optical axis
below the horizon, rotation about it, heading, and center in meters over the ground z = 0. Pixels
are relative to the principal point, which is fixed at the image center: freeing it allows the rig
to warp.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

LOG_FOCAL, TILT, ROLL, PAN, X, Y, Z = range(7)


def rotation(parameters: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 3 3"]:
    """World-to-camera rotations (..., 3, 3) of parameters (..., 7)."""
    tilt, roll, pan = (parameters[..., i] for i in (TILT, ROLL, PAN))
    st, ct, sr, cr, sp, cp = (g(a) for a in (tilt, roll, pan) for g in (np.sin, np.cos))
    # Before roll: x to the right along the ground, y down, z forward and down.
    R = np.zeros((*parameters.shape[:-1], 3, 3))
    R[..., 0, 0], R[..., 0, 1] = cp, sp
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = st * sp, -st * cp, -ct
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -ct * sp, ct * cp, -st
    right, down = R[..., 0, :].copy(), R[..., 1, :].copy()
    sr, cr = sr[..., None], cr[..., None]
    R[..., 0, :], R[..., 1, :] = cr * right + sr * down, cr * down - sr * right
    return R


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


def box_jacobian(
    parameters: Float[np.ndarray, "n 7"],
    xy: Float[np.ndarray, "n 2"],
    height: Float[np.ndarray, " n"],
    foot_offset: float,
) -> tuple[
    Float[np.ndarray, "n 3"],
    Float[np.ndarray, "n 3 7"],
    Float[np.ndarray, "n 3 3"],
    Float[np.ndarray, "n 3"],
]:
    """Predicted boxes and their derivatives, one camera per row.

    Args:
        parameters: (n, 7) camera of each row.
        xy: (n, 2) ground positions in meters.
        height: (n,) person heights in meters.
        foot_offset: meters by which the visible foot is closer to the camera.

    Returns:
        Boxes (n, 3) in pixels from the image center, and their derivatives with respect to the
        camera (n, 3, 7), the person's x, y and height (n, 3, 3), and the foot offset (n, 3).
    """
    n = len(xy)
    R = rotation(parameters)
    focal = np.exp(parameters[:, LOG_FOCAL])
    toward = xy - parameters[:, X:Z]
    distance = np.maximum(np.linalg.norm(toward, axis=-1), 1e-6)
    unit = toward / distance[:, None]
    # Derivative of the foot offset vector with respect to the person's position.
    turn = (np.eye(2) - unit[:, :, None] * unit[:, None, :]) * (foot_offset / distance)[
        :, None, None
    ]
    roll = parameters[:, ROLL]
    unroll = np.stack([np.cos(roll), np.sin(roll)], -1)
    by_camera, by_person = np.zeros((n, 3, 7)), np.zeros((n, 3, 3))
    by_offset, box = np.zeros((n, 3)), np.zeros((n, 3))
    for is_foot in (True, False):
        ground = xy - foot_offset * unit if is_foot else xy
        point = np.concatenate([ground, (0 * height if is_foot else height)[:, None]], -1)
        difference = point - parameters[:, X:]
        local = np.einsum("nij,nj->ni", R, difference)
        depth = np.where(local[:, 2] > 0.1, local[:, 2], 0.1)
        pixel = focal[:, None] * local[:, :2] / depth[:, None]
        # d pixel / d local point
        inner = np.zeros((n, 2, 3))
        inner[:, 0, 0] = inner[:, 1, 1] = focal / depth
        inner[:, :, 2] = -pixel / depth[:, None]
        world = inner @ R
        camera = np.zeros((n, 2, 7))
        camera[:, :, LOG_FOCAL] = pixel
        # Before roll, the point is (a, b, c); tilt moves it by (0, -c, b), then roll is applied.
        b = unroll[:, 1] * local[:, 0] + unroll[:, 0] * local[:, 1]
        c = local[:, 2]
        tilted = np.stack([-unroll[:, 1] * c, -unroll[:, 0] * c, b], -1)
        camera[:, :, TILT] = np.einsum("nij,nj->ni", inner, tilted)
        rolled = np.stack([local[:, 1], -local[:, 0], np.zeros(n)], -1)
        camera[:, :, ROLL] = np.einsum("nij,nj->ni", inner, rolled)
        spun = np.stack([difference[:, 1], -difference[:, 0]], -1)
        camera[:, :, PAN] = np.einsum("nij,nj->ni", world[:, :, :2], spun)
        camera[:, :, X:] = -world
        person = np.zeros((n, 2, 3))
        person[:, :, :2] = world[:, :, :2]
        offset = np.zeros((n, 2))
        if is_foot:
            moved = world[:, :, :2] @ turn
            person[:, :, :2] -= moved
            camera[:, :, X:Z] += moved
            offset = -np.einsum("nij,nj->ni", world[:, :, :2], unit)
        else:
            person[:, :, 2] = world[:, :, 2]
        edge = 2 if is_foot else 1
        for target, value in (
            (box, pixel),
            (by_camera, camera),
            (by_person, person),
            (by_offset, offset),
        ):
            target[:, 0] += value[:, 0] / 2
            target[:, edge] += value[:, 1]
    return box, by_camera, by_person, by_offset


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
