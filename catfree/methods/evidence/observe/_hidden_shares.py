"""Shares of image regions hidden by nearer people."""

import numpy as np
from jaxtyping import Float, Int

BOXES_AT_A_TIME = 1 << 20  # compared with regions; 8 MB per number kept of each pair
COLUMNS = 8  # sampled columns of a box; rows are integrated exactly


def hidden_shares(
    region: Float[np.ndarray, "n 4"],
    own_box: Int[np.ndarray, " n"],
    frame: Int[np.ndarray, " n"],
    camera: Int[np.ndarray, " n"],
    box: Float[np.ndarray, "box 4"],
    table: Int[np.ndarray, "frame cam slot"],
) -> Float[np.ndarray, " n"]:
    """Share of each rectangle hidden by boxes that reach lower, i.e. by nearer people.

    In each column, such a box covers everything below its top edge, so the union is exact.

    Args:
        region: (n, 4) x1, y1, x2, y2 in pixels.
        own_box: (n,) the person's own box, which does not hide the region, or -1.
        frame: (n,) frame index.
        camera: (n,) camera.
        box: (N, 4) all boxes in pixels.
        table: (F, C, B) rows of each frame and camera, -1 for none.

    Returns:
        (n,) shares in [0, 1].
    """
    left, top, right, bottom = box.T
    lowest = np.append(bottom, -np.inf)  # the last for slots without a box
    shares = np.zeros(len(region))
    at_a_time = max(1, BOXES_AT_A_TIME // table.shape[2])
    steps = (np.arange(COLUMNS) + 0.5) / COLUMNS
    for first in range(0, len(region), at_a_time):
        part = slice(first, first + at_a_time)
        x1, y1, x2, y2 = region[part].T
        slots = table[frame[part], camera[part]]
        row, slot = np.nonzero(lowest[slots] > y2[:, None])
        near = slots[row, slot]
        overlap = (top[near] < y2[row]) & (left[near] <= x2[row]) & (right[near] >= x1[row])
        overlap &= near != own_box[part][row]
        row, near = row[overlap], near[overlap]
        if not len(row):
            continue
        column = x1[row, None] + steps * (x2 - x1)[row, None]
        inside = (left[near, None] <= column) & (column <= right[near, None])
        hidden = np.where(inside, (y2[row] - np.maximum(top[near], y1[row]))[:, None], 0.0)
        begin = np.flatnonzero(np.diff(row, prepend=-1))
        hidden, row = np.maximum.reduceat(hidden, begin), row[begin]
        shares[first + row] = hidden.mean(1) / np.maximum(y2 - y1, 1e-9)[row]
    return np.clip(shares, 0, 1)
