"""Tiling of large pictures, so that small people fill more input pixels.

A network finds a person who is tall enough in its input, whatever the picture's size. That height
is the height in the picture times the smaller of the two ratios input width / picture width and
input height / picture height. n x n tiles multiply it by n - (n - 1) * overlap: by 1.8, 2.6 and 3.4
for n = 2, 3 and 4 with a fifth of overlap; a larger input does the same without cutting people.
The necessary height depends on the network and is stated by the detectors' classes.

Tiles cut people. A person taller or wider than the overlap of two tiles may be whole in none, so
finer tiles lose tall people again. Choose the overlap so that its size in pixels, overlap * picture
height / (n - (n - 1) * overlap), holds a person.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from catfree.errors import InvalidInputError

Tiles = int | tuple[int, int] | None
Window = tuple[int, int, int, int]


def tile_windows(width: int, height: int, tiles: Tiles, overlap: float) -> list[Window]:
    """List the windows x1, y1, x2, y2 in whole pixels: the whole picture, then its tiles.

    The whole picture is included because people larger than the overlap of two tiles may be whole
    in no tile.

    Args:
        width: width of the picture in pixels.
        height: height of the picture in pixels.
        tiles: None for the whole picture only, n for n x n, or (columns, rows).
        overlap: share of a tile that overlaps its neighbor.

    Raises:
        InvalidInputError: if a count is not positive or the overlap not in [0, 1).
    """
    whole = (0, 0, width, height)
    if tiles is None:
        return [whole]
    columns, rows = (tiles, tiles) if isinstance(tiles, int) else tiles
    if columns < 1 or rows < 1 or not 0 <= overlap < 1:
        raise InvalidInputError(
            f"tiles must be positive counts and tile_overlap in [0, 1), got {tiles} and {overlap}."
        )
    windows = [
        (x1, y1, x2, y2)
        for y1, y2 in _spans(height, rows, overlap)
        for x1, x2 in _spans(width, columns, overlap)
    ]
    return [whole, *(window for window in windows if window != whole)]


def _spans(length: int, count: int, overlap: float) -> list[tuple[int, int]]:
    # count tiles of size s with steps s (1 - overlap) cover the length: s (count - (count-1) o).
    size = min(length, math.ceil(length / (count - (count - 1) * overlap)))
    starts = np.round(np.linspace(0, length - size, count)).astype(int)
    return sorted({(int(start), int(start) + size) for start in starts})


def cut_by_window(
    box: Float[np.ndarray, "n 4"], window: Window, picture: Sequence[int], margin: float
) -> Bool[np.ndarray, " n"]:
    """Return whether a window's edge inside the picture cuts a box.

    Args:
        box: (n, 4) xyxy in pixels of the picture.
        window: x1, y1, x2, y2 of the tile the boxes were found in.
        picture: (width, height) of the whole picture.
        margin: a box within this many pixels of the edge counts as cut.

    Returns:
        (n,) true for boxes that show only part of a person.
    """
    cut = np.zeros(len(box), bool)
    for axis in (0, 1):
        if window[axis] > 0:
            cut |= box[:, axis] <= window[axis] + margin
        if window[axis + 2] < picture[axis]:
            cut |= box[:, axis + 2] >= window[axis + 2] - margin
    return cut
