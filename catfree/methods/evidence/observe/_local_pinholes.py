"""Pinholes that approximate any lens near one pixel, so that boxes need no other camera model."""

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry.camera import rays_of_pixels
from catfree.types import Rig

STEP = 0.5  # pixels; half-width of the central difference of rays
FLATTEST = 1e-12  # square radians per square pixel; below, as at a pole, no pinhole fits


def local_pinholes(
    rig: Rig, camera: Int[np.ndarray, " n"], pixel: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3 3"], Bool[np.ndarray, " n"]]:
    """Compute the pinhole whose rays agree with the lens around each pixel, to first order.

    The pinhole looks along the ray of the pixel, which is its principal point, and shifts the pixel
    under small rotations as the lens does. Near this pixel, its pixels are those of the image.

    Args:
        rig: the cameras, with any lenses.
        camera: (n,) camera of each pixel, registered.
        pixel: (n, 2) in original image pixels.

    Returns:
        K: (n, 3, 3) intrinsics, with skew.
        R: (n, 3, 3) rotations from the rig's world frame; the center is the camera's.
        usable: (n,) whether such a pinhole exists; otherwise K and R are finite but arbitrary.
    """
    n = len(pixel)
    across, down = np.array([STEP, 0.0]), np.array([0.0, STEP])
    around = np.concatenate([pixel, pixel + across, pixel - across, pixel + down, pixel - down])
    ray, right, left, below, above = rays_of_pixels(rig, np.tile(camera, 5), around).reshape(
        5, n, 3
    )
    change = np.stack([right - left, below - above], -1) / (2 * STEP)
    # Any two directions perpendicular to the ray will do.
    least = np.eye(3)[np.abs(ray).argmin(-1)]
    first = np.cross(least, ray)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    beside = np.stack([first, np.cross(ray, first)], 1)
    per_pixel = beside @ change
    usable = np.linalg.det(per_pixel) > FLATTEST
    scale = np.linalg.inv(np.where(usable[:, None, None], per_pixel, np.eye(2)))
    # scale = upper triangle times rotation: the rotation turns the pinhole about its axis.
    length = np.hypot(scale[:, 1, 0], scale[:, 1, 1])
    cos, sin = scale[:, 1, 1] / length, scale[:, 1, 0] / length
    roll = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], 1)
    K = np.tile(np.eye(3), (n, 1, 1))
    K[:, :2, :2] = scale @ roll.transpose(0, 2, 1)
    K[:, 1, 0] = 0
    K[:, :2, 2] = pixel
    return K, np.concatenate([roll @ beside, ray[:, None]], 1), usable


def project_rays(
    K: Float[np.ndarray, "n 3 3"], R: Float[np.ndarray, "n 3 3"], ray: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Project rays into pinholes; return pixels, and whether the rays are in front."""
    local = np.einsum("nij,nj->ni", K, np.einsum("nij,nj->ni", R, ray))
    in_front = local[:, 2] > 1e-3
    return local[:, :2] / np.where(in_front, local[:, 2], 1.0)[:, None], in_front
