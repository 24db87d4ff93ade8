"""Subsets of rows, rows of a picture, pairs of rows, and the spacing of frames."""

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from catfree.errors import InvalidInputError, quoted

T = TypeVar("T")


def select_rows(record: T, count: int, rows: Any) -> T:
    """Select rows of all columns of a dataclass, in the order of `rows`.

    Args:
        record: a dataclass whose fields are arrays of `count` rows, None, or a `clock`.
        count: their number.
        rows: a slice, a boolean mask, an index or an integer array.

    Raises:
        IndexError: if an index is out of range.
        InvalidInputError: if a mask or an array does not fit.
    """
    try:
        chosen = np.arange(count)[rows].reshape(-1)
    except (IndexError, ValueError) as error:
        if isinstance(rows, int):
            raise  # Python's iteration protocol needs this error
        raise InvalidInputError(
            f"{count} rows are selected by a slice, a mask of as many booleans, or whole numbers "
            f"below {count}: {quoted(error)}."
        ) from error
    columns: dict[str, Any] = vars(record)
    selected = {
        name: column[chosen]
        for name, column in columns.items()
        if column is not None and name != "clock"
    }
    return replace(record, **selected)  # type: ignore[type-var]


def evenly_spread(rows: Shaped[np.ndarray, "n *rest"], most: int) -> Shaped[np.ndarray, "m *rest"]:
    """Take at most `most` rows, evenly spread from the first to the last.

    Args:
        rows: (n, ...) in the order to spread over.
        most: how many to keep, at least 1.

    Returns:
        (min(n, most), ...) distinct rows in their original order.
    """
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]


def frame_step(frames: Int[np.ndarray, " frame"]) -> int:
    """Return the median step between sorted frame numbers (F,); 1 for fewer than two."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1


def common_step(frames: Int[np.ndarray, " frame"]) -> int:
    """Return the largest step whose multiples separate all frames; 1 for fewer than two frames."""
    return int(np.gcd.reduce(np.diff(np.unique(frames)), initial=0)) or 1


def rows_of_picture(
    frames: Int[np.ndarray, " n"], cameras: Int[np.ndarray, " n"], frame: int, camera: int
) -> Int[np.ndarray, " k"]:
    """Find the rows of one picture in a table sorted by frame, by bisection.

    Args:
        frames: (n,) frame of each row, in order.
        cameras: (n,) camera of each row.
        frame: of the picture.
        camera: of the picture.
    """
    begin, end = np.searchsorted(frames, [frame, frame + 1])
    return begin + np.flatnonzero(cameras[begin:end] == camera)


def expand_ranges(
    start: Int[np.ndarray, " n"], stop: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """All (i, j) with start[i] <= j < stop[i], ordered by i, then j.

    Returns:
        (P,) i and (P,) j.
    """
    count = np.maximum(stop - start, 0)
    first = np.repeat(np.arange(len(start)), count)
    offset = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    return first, start[first] + offset


def equal_pairs(
    first: Int[np.ndarray, " a"], second: Int[np.ndarray, " b"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """All (i, j) with first[i] == second[j], ordered by i, then j; `second` is sorted.

    Returns:
        (P,) i and (P,) j.
    """
    start, stop = (np.searchsorted(second, first, side) for side in ("left", "right"))
    return expand_ranges(start, stop)


def mutually_lowest(
    cost: Float[np.ndarray, " pair"], one: Int[np.ndarray, " pair"], other: Int[np.ndarray, " pair"]
) -> Bool[np.ndarray, " pair"]:
    """Mark the pairs that have the lowest cost for both members; ties go to the first.

    Args:
        cost: (p,) cost of each pair; infinite for pairs to ignore.
        one: (p,) first member of each pair.
        other: (p,) second member.
    """
    return _first_lowest(cost, one) & _first_lowest(cost, other)


def _first_lowest(
    cost: Float[np.ndarray, " pair"], group: Int[np.ndarray, " pair"]
) -> Bool[np.ndarray, " pair"]:
    """Mark the first pair with the lowest finite cost in each group."""
    lowest = np.full(int(group.max(initial=-1)) + 1, np.inf, cost.dtype)
    np.minimum.at(lowest, group, cost)
    at = np.flatnonzero((cost == lowest[group]) & np.isfinite(cost))
    marked = np.zeros(len(group), bool)
    marked[at[np.unique(group[at], return_index=True)[1]]] = True
    return marked
