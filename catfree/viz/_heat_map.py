"""Where people are most often, without showing the path of any one of them."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import write_text_atomically
from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.types._validation import (
    as_count,
    as_path,
    as_positive,
    require_finite,
    require_instance,
)

MOST_CELLS = 4_000_000


@dataclass(frozen=True)
class HeatMap:
    """Numbers of positions in the cells of a grid on the ground.

    Attributes:
        x: (W,) first ground coordinate of the cell centers, scene units.
        y: (H,) second ground coordinate.
        positions: (H, W) number of positions of tracked people in each cell; NaN in cells that
            fewer than `k` identities visited. Divided by the frame rate, these are
            person-seconds.
        cell: side of a cell in scene units.
        k: fewest identities that a shown cell has.
    """

    x: Float[np.ndarray, " width"]
    y: Float[np.ndarray, " height"]
    positions: Float[np.ndarray, "height width"]
    cell: float
    k: int


def heat_map(tracks: Tracks, cell: float | int, k: int = 5) -> HeatMap:
    """Count positions per cell of the ground; cells that fewer than k people visited stay blank.

    Nothing in the result depends on people in blank cells, not even its extent. The borders of the
    cells are multiples of `cell`, so that maps of several recordings can be added. A person whose
    track was cut counts once for each identity: choose k with some margin.

    Args:
        tracks: tracks over any number of frames; positions without an identity are ignored.
        cell: side of a cell in scene units.
        k: fewest distinct identities that a shown cell has.

    Returns:
        The map, as large as the shown cells require; (0, 0) if there are none.

    Raises:
        InvalidInputError: if `cell` is not a positive length, `k` is below 1, a position is not
            finite, or the shown cells are too far apart.
    """
    require_instance(tracks, Tracks, "tracks")
    side, fewest = as_positive(cell, "cell"), as_count(k, "k", least=1)
    known = np.asarray(tracks.track_id) >= 0
    require_finite(tracks.ground_xy, "ground_xy", known)
    place = np.floor(np.asarray(tracks.ground_xy, np.float64)[known] / side)
    if (np.abs(place) >= 2**53).any():
        raise InvalidInputError(f"cell is {cell!r}, too small for positions this far away.")
    visits = np.column_stack([place.astype(np.int64), np.asarray(tracks.track_id)[known]])
    visitors, count = np.unique(visits, axis=0, return_counts=True)
    cells, of_cell = np.unique(visitors[:, :2], axis=0, return_inverse=True)
    people = np.bincount(of_cell.ravel(), minlength=len(cells))
    positions = np.bincount(of_cell.ravel(), weights=count, minlength=len(cells))
    shown = people >= fewest
    if not shown.any():
        return HeatMap(np.zeros(0), np.zeros(0), np.zeros((0, 0)), side, fewest)
    cells, positions = cells[shown], positions[shown]
    low = cells.min(0)
    width, height = (int(size) for size in cells.max(0) - low + 1)
    if width * height > MOST_CELLS:
        raise InvalidInputError(
            f"The map would have {width} x {height} cells. Pass a cell longer than {cell!r}."
        )
    grid = np.full((height, width), np.nan)
    column, row = (cells - low).T
    grid[row, column] = positions
    x, y = (
        side * (start + 0.5 + np.arange(n)) for start, n in zip(low, (width, height), strict=True)
    )
    return HeatMap(x, y, grid, side, fewest)


def write_heat_map(path: str | os.PathLike[str], heat: HeatMap) -> Path:
    """Write the shown cells as CSV: the columns `x`, `y` (centers) and `positions`.

    Args:
        path: the file.
        heat: the result of `heat_map`.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist, or the path names a picture.
        WriteError: if the disk is full or not writable.
    """
    require_instance(heat, HeatMap, "heat")
    target = as_path(path, "path")
    if target.suffix.lower() == ".png":
        raise InvalidInputError(
            f"The table of a heat map is a CSV file, not {target}: name "
            f"{target.with_suffix('.csv')}. cf.viz.plot_heat_map draws it."
        )
    row, column = np.nonzero(np.isfinite(heat.positions))
    lines = [
        f"{heat.x[c]:.10g},{heat.y[r]:.10g},{heat.positions[r, c]:.0f}"
        for r, c in zip(row, column, strict=True)
    ]
    return write_text_atomically(target, "\n".join(["x,y,positions", *lines]) + "\n")
