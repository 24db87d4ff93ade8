"""Which rows of a table belong to one picture."""

import numpy as np
from jaxtyping import Int


def rows_of_picture(
    frames: Int[np.ndarray, " n"], cameras: Int[np.ndarray, " n"], frame: int, camera: int
) -> Int[np.ndarray, " k"]:
    """Find the rows of one picture in a table sorted by frame; the other frames cost nothing.

    Args:
        frames: (n,) frame of each row, in order.
        cameras: (n,) camera of each row.
        frame: of the picture.
        camera: of the picture.
    """
    begin, end = np.searchsorted(frames, [frame, frame + 1])
    return begin + np.flatnonzero(cameras[begin:end] == camera)
