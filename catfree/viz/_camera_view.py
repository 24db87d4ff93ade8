"""Projection of points and lines into a camera's picture, with lines cut outside the view."""

from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.geometry import angular_residual, pixel_to_ray, project
from catfree.types import Rig

BLOCK = 256  # points are padded to multiples of this, so that few sizes compile
# A lens polynomial may fold points far outside the view back into the picture. Such a point is
# farther than this angle in radians from the ray of its pixel.
FOLD_TOLERANCE = 1e-2


def project_points(
    rig: Rig, camera: int, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Project world points to pixels, and mark those in front of the camera.

    Args:
        rig: the cameras.
        camera: index of a registered camera.
        points: (N, 3) in scene units.

    Returns:
        pixel: (N, 2), possibly outside the picture.
        in_front: (N,) bool; false where the pixel is meaningless.
    """
    padded = _padded(np.asarray(points, np.float64))
    distortion = None if rig.distortion is None else rig.distortion[camera]
    pixel, depth, miss = _project(rig.K[camera], rig.R[camera], rig.t[camera], padded, distortion)
    n = len(points)
    in_front = (np.asarray(depth) > 0) & (np.asarray(miss) < FOLD_TOLERANCE)
    return np.asarray(pixel, np.float64)[:n], in_front[:n]


def rays_of_pixels(
    rig: Rig, camera: int, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """(N, 3) unit directions in the world frame of a camera's pixels (N, 2)."""
    padded = _padded(np.asarray(pixels, np.float64))
    distortion = None if rig.distortion is None else rig.distortion[camera]
    direction = _directions(rig.K[camera], rig.R[camera], rig.t[camera], padded, distortion)
    return np.asarray(direction, np.float64)[: len(pixels)]


def visible_runs(
    pixel: Float[np.ndarray, "n 2"],
    in_front: Bool[np.ndarray, " n"],
    image_size: tuple[int, int],
) -> list[Float[np.ndarray, "k 2"]]:
    """Split a polyline into the drawable pieces: at least two successive points in front.

    A point more than one picture size outside the picture also ends a piece, because drawing
    routines overflow on it.
    """
    size = np.asarray(image_size, np.float64)
    near = ((pixel > -size) & (pixel < 2 * size)).all(-1) & in_front
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    return [pixel[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 2]


def _padded(rows: np.ndarray) -> np.ndarray:
    return np.pad(rows, ((0, -len(rows) % BLOCK), (0, 0)))


@jax.jit
def _project(
    K: Array, R: Array, t: Array, points: Array, distortion: Array | None
) -> tuple[Array, Array, Array]:
    pixel, depth = jax.vmap(partial(project, distortion=distortion), (None, None, None, 0))(
        K, R, t, points
    )
    if distortion is None:
        return pixel, depth, 0 * depth
    cast = jax.vmap(partial(pixel_to_ray, distortion=distortion), (None, None, None, 0))
    origin, direction = cast(K, R, t, pixel)
    miss = jax.vmap(angular_residual)(points, origin, direction)
    return pixel, depth, miss


@jax.jit
def _directions(K: Array, R: Array, t: Array, pixels: Array, distortion: Array | None) -> Array:
    cast = jax.vmap(partial(pixel_to_ray, distortion=distortion), (None, None, None, 0))
    return cast(K, R, t, pixels)[1]
