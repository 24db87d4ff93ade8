"""Rays of pixels and pixels of points for the cameras of a rig, whatever their lenses."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry.camera._fisheye import fisheye_pixel, fisheye_ray
from catfree.geometry.camera._pinhole import pinhole_pixel, pinhole_ray
from catfree.geometry.camera._ray_grid import grid_pixel, grid_ray
from catfree.types import Lens, Rig
from catfree.types._validation import as_integer, require_known_cameras, require_shape

BLOCK = 1024  # pixels or points computed together


def rays_of_pixels(
    rig: Rig, camera: int | np.integer | Int[np.ndarray, " n"], pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Find the directions in which the cameras of a rig see at pixels.

    Args:
        rig: the cameras.
        camera: (n,) the camera of each pixel, or one for all.
        pixels: (n, 2) in original image pixels.

    Returns:
        (n, 3) unit vectors in the rig's world frame, float64; NaN if a camera's parameters are.
        Beyond the fold of a lens they are finite but arbitrary.

    Raises:
        InvalidInputError: if the rig has no such camera, or there is not one for each pixel.
    """
    cameras = _cameras(rig, camera, len(pixels))
    (ray,) = _by_lens(rig, cameras, np.asarray(pixels, np.float64), _RAYS, (np.zeros((0, 3)),))
    return np.einsum("nji,nj->ni", np.asarray(rig.R, np.float64)[cameras], ray)


def pixels_of_points(
    rig: Rig, camera: int | np.integer | Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Find the pixels at which the cameras of a rig see points.

    Args:
        rig: the cameras.
        camera: (n,) the camera of each point, or one for all.
        points: (n, 3) in the rig's world frame.

    Returns:
        pixel: (n, 2) in original image pixels, possibly outside the image; float64.
        imaged: (n,) whether the pixel is the point's image: the point is in front of the camera and
            inside the fold of its lens. The caller compares the pixel with the border.

    Raises:
        InvalidInputError: if the rig has no such camera, or there is not one for each point.
    """
    cameras = _cameras(rig, camera, len(points))
    R, t = (np.asarray(part, np.float64)[cameras] for part in (rig.R, rig.t))
    local = np.einsum("nij,nj->ni", R, np.asarray(points, np.float64)) + t
    empty = (np.zeros((0, 2)), np.zeros(0, bool))
    pixel, imaged = _by_lens(rig, cameras, local, _PIXELS, empty)
    return pixel, imaged


def _cameras(
    rig: Rig, camera: int | np.integer | Int[np.ndarray, " n"], count: int
) -> Int[np.ndarray, " n"]:
    """Validate the camera of each row, given for each or for all."""
    given = as_integer(camera, "camera")
    if given.shape != ():
        require_shape(given, (count,), "camera")
    require_known_cameras(given.reshape(-1), rig.camera_count)
    return np.broadcast_to(given, count)


def _by_lens(
    rig: Rig,
    camera: Int[np.ndarray, " n"],
    rows: Float[np.ndarray, "n k"],
    functions: dict[Lens, Callable[..., Any]],
    empty: tuple[np.ndarray, ...],
) -> tuple[np.ndarray, ...]:
    """Apply the function of each row's lens, in float64."""
    results = tuple(np.zeros((len(rows), *one.shape[1:]), one.dtype) for one in empty)
    for lens in Lens:
        mine = np.flatnonzero(rig.lenses[camera] == lens)
        # A grid is large: it is passed once per camera, not once per row.
        parts = [mine]
        if lens == Lens.RAYS:
            parts = [mine[camera[mine] == one] for one in np.unique(camera[mine])]
        for part in parts:
            if not len(part):
                continue
            with jax.enable_x64(True):
                outputs = _apply(functions[lens], lens, rig, camera[part], rows[part])
            for result, values in zip(results, jax.tree.leaves(outputs), strict=True):
                result[part] = values
    return results


def _apply(
    function: Callable[..., Any], lens: Lens, rig: Rig, camera: np.ndarray, rows: np.ndarray
) -> Any:
    if lens == Lens.RAYS:
        grid = np.asarray(rig.rays, np.float64)[camera[0]]
        size = rig.image_size[camera[0]].astype(np.float64)
        return in_blocks(lambda part: function(grid, size, part), (rows,), BLOCK)
    K = np.asarray(rig.K, np.float64)[camera]
    coefficients = None
    if rig.distortion is not None:
        coefficients = np.asarray(rig.distortion, np.float64)[camera]
    if lens == Lens.FISHEYE:
        none = np.zeros((len(camera), 4))
        coefficients = none if coefficients is None else coefficients[:, :4]
    return in_blocks(function, (K, rows, coefficients), BLOCK)


_RAYS = {
    Lens.PINHOLE: jax.jit(jax.vmap(pinhole_ray)),
    Lens.FISHEYE: jax.jit(jax.vmap(fisheye_ray)),
    Lens.RAYS: jax.jit(jax.vmap(grid_ray, (None, None, 0))),
}
_PIXELS = {
    Lens.PINHOLE: jax.jit(jax.vmap(pinhole_pixel)),
    Lens.FISHEYE: jax.jit(jax.vmap(fisheye_pixel)),
    Lens.RAYS: jax.jit(jax.vmap(grid_pixel, (None, None, 0))),
}
