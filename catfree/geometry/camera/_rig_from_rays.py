"""Cameras with any lens, from a function that gives the rays of their pixels."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.errors import InvalidInputError
from catfree.geometry.camera._rig_cameras import rays_of_pixels
from catfree.types import Lens, Rig
from catfree.types._validation import as_count, as_float, as_integer, require_shape

FEWEST_NODES = 9  # along the shorter side
LARGEST_ERROR = 2e-3  # radians of a ray between the nodes: moves a foot at 20 m by 4 cm
SMALLEST_TURN = 1e-12  # steradians of a pixel, whose rays differ by a microradian
USUAL = 0.95  # share of the rays that must be as good: a panorama's poles are not


def rig_from_rays(
    source: Callable[[int, Float[np.ndarray, "n 2"]], Any],
    R: Any,
    t: Any,
    image_size: Any,
    *,
    nodes: int = 65,
) -> Rig:
    """Sample the rays of cameras with any lens into a rig.

    Args:
        source: a `catfree.adapters.RaySource`: `source(camera, pixels)` gives the (n, 3) unit rays
            in camera axes (x right, y down, z forward) of (n, 2) pixels. The pixels reach half a
            pixel beyond the centers of the outermost ones, that is, to the edge of the image.
        R: (C, 3, 3) world-to-camera rotations.
        t: (C, 3) world-to-camera translations in scene units.
        image_size: (C, 2) width and height in pixels, or one pair for all cameras.
        nodes: number of rays along the longer side of each image.

    Returns:
        A rig whose cameras are grids of rays (`Lens.RAYS`). Their `K` has the focal length at the
        middle of the image, which only tells how large things appear.

    Raises:
        InvalidInputError: if an argument is invalid; or naming the camera, if its rays have
            a wrong shape, are not unit vectors, are the same at all pixels, or differ too much
            between the nodes to be a grid.
    """
    if not callable(source):
        raise InvalidInputError(
            f"source must be a function of a camera and its pixels, got {type(source).__name__}."
        )
    R, t = (np.asarray(as_float(value, name), np.float64) for name, value in (("R", R), ("t", t)))
    require_shape(R, (None, 3, 3), "R")
    count = len(R)
    if not count:
        raise InvalidInputError("R has no rotations; give that of at least one camera.")
    require_shape(t, (count, 3), "t")
    nodes = as_count(nodes, "nodes", least=1)
    size = as_integer(image_size, "image_size")
    size = np.tile(size, (count, 1)) if size.shape == (2,) else size
    require_shape(size, (count, 2), "image_size")
    if (size <= 0).any():
        raise InvalidInputError("image_size must hold positive numbers of pixels.")
    shape = np.maximum(np.round(nodes * size.max(0) / size.max()).astype(int), FEWEST_NODES)
    grids = [_rays(source, camera, _nodes(size[camera], shape)) for camera in range(count)]
    K = np.tile(np.eye(3), (count, 1, 1))
    for camera, (width, height) in enumerate(size.tolist()):
        middle = np.array([width - 1, height - 1]) / 2
        around = middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]])
        right, left, below, above = _rays(source, camera, around)
        turn = np.linalg.norm(np.cross(right - left, below - above))
        if not turn > SMALLEST_TURN:
            raise InvalidInputError(
                f"The rays of camera {camera} are not finite, or all the same, around the middle "
                "of its image. Give every pixel its own direction."
            )
        K[camera, 0, 0] = K[camera, 1, 1] = 1 / np.sqrt(turn)
        K[camera, :2, 2] = middle
    rays = np.stack(grids).reshape(count, shape[1], shape[0], 3)
    rig = Rig(K, R, t, size, lens=[Lens.RAYS] * count, rays=rays)
    _require_smooth(source, rig, shape)
    return rig


def _nodes(size: np.ndarray, shape: np.ndarray) -> Float[np.ndarray, "n 2"]:
    """Pixels of the nodes, row by row."""
    columns, rows = (np.linspace(-0.5, side - 0.5, n) for side, n in zip(size, shape, strict=True))
    return np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)


def _rays(
    source: Callable[[int, Float[np.ndarray, "n 2"]], Any], camera: int, pixels: np.ndarray
) -> Float[np.ndarray, "n 3"]:
    rays = np.asarray(as_float(source(camera, pixels)), np.float64)
    if rays.shape != (len(pixels), 3):
        raise InvalidInputError(
            f"The ray source gave shape {rays.shape} for {len(pixels)} pixels of camera {camera}; "
            f"it must be ({len(pixels)}, 3)."
        )
    return rays


def _require_smooth(
    source: Callable[[int, Float[np.ndarray, "n 2"]], Any], rig: Rig, shape: np.ndarray
) -> None:
    """Compare the rays between the nodes with those of the source."""
    still = replace(rig, R=np.tile(np.eye(3), (rig.camera_count, 1, 1)))
    for camera in range(rig.camera_count):
        cell = rig.image_size[camera] / (shape - 1)
        between = _nodes(rig.image_size[camera], shape) + cell / 2
        between = between[(between < rig.image_size[camera] - 0.5).all(-1)]
        wrong = rays_of_pixels(still, camera, between) - _rays(source, camera, between)
        error = float(np.quantile(np.linalg.norm(wrong, axis=-1), USUAL))
        if error > LARGEST_ERROR:
            raise InvalidInputError(
                f"The rays of camera {camera} differ from those between the nodes by {error:.2g} "
                f"radians. Pass more nodes than {shape.max()}, and check that neighboring pixels "
                "have neighboring rays."
            )
