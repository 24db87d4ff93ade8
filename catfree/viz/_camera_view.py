"""Lines in a camera's picture, cut outside the view."""

import numpy as np
from jaxtyping import Bool, Float


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
