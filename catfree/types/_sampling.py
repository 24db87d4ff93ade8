"""Evenly spread subsets of rows."""

import numpy as np
from jaxtyping import Shaped


def evenly_spread(rows: Shaped[np.ndarray, "n *rest"], most: int) -> Shaped[np.ndarray, "m *rest"]:
    """Take at most `most` rows, evenly spread from the first to the last.

    Args:
        rows: (n, ...) in the order over which to spread.
        most: how many to keep, at least 1.

    Returns:
        (min(n, most), ...) distinct rows in their original order.
    """
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
