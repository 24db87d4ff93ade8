"""Points and lines in a camera's picture, cut outside the view."""

import numpy as np
from jaxtyping import Bool, Float, Int


def in_reach(
    pixel: Float[np.ndarray, "*n 2"], image_size: tuple[int, int] | Int[np.ndarray, "2"]
) -> Bool[np.ndarray, "*n"]:
    """Mark the pixels less than one picture size outside the picture: further out, drawing fails.

    Args:
        pixel: (..., 2).
        image_size: width and height of the picture.
    """
    (u, v), (width, height) = np.moveaxis(pixel, -1, 0), image_size
    return (u > -width) & (u < 2 * width) & (v > -height) & (v < 2 * height)


def visible_runs(
    pixel: Float[np.ndarray, "n 2"],
    in_front: Bool[np.ndarray, " n"],
    image_size: tuple[int, int],
) -> list[Float[np.ndarray, "k 2"]]:
    """Split a polyline into the drawable pieces: two or more points in front and `in_reach`."""
    near = in_reach(pixel, image_size) & in_front
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    return [pixel[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 2]
