"""Lengths to which arrays are padded, so that the next sequence finds its code compiled."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

SHORT = 2**15  # rows: computing twice as many takes less than the second that compiling takes


def coarse_length(count: int, block: int, factor: int = 4) -> int:
    """The smallest of block, block · factor, block · factor², ... that holds `count`.

    For stages whose cost hardly depends on the padding: the fewest compilations.

    Args:
        count: rows to hold.
        block: the shortest length.
        factor: ratio of successive lengths.

    Returns:
        The padded length.
    """
    length = block
    while length < count:
        length *= factor
    return length


def fine_length(count: int, minimum: int = 64) -> int:
    """The smallest of few lengths that holds `count`: doubling ones, then four an octave.

    For stages whose cost grows with the padding. Short arrays are computed faster than code for
    another length is compiled; of long ones at most a quarter is wasted.

    Args:
        count: rows to hold.
        minimum: the shortest length.

    Returns:
        The padded length.
    """
    length = minimum
    while length < count:
        short = length < SHORT
        length += length if short else 1 << max(length.bit_length() - 3, 0)
    return length


def in_blocks(function: Callable[..., Any], rows: tuple[Any, ...], *blocks: int) -> Any:
    """Apply a compiled function of rows to any number of them, at one of few lengths.

    For stages whose cost hardly depends on how many rows a call has: compiled once for each length,
    and of the last block alone some is wasted.

    Args:
        function: of arrays of `block` rows each, to arrays (or pytrees of them) of as many; every
            row on its own.
        rows: arrays (n, ...) or pytrees of them.
        blocks: rows of a call, ascending: the shortest that holds all rows, else the longest.

    Returns:
        What the function returns for all n rows, on the host.
    """
    n = len(jax.tree.leaves(rows)[0])
    block = next((length for length in blocks if length >= n), blocks[-1])
    if n == 0:
        rows = jax.tree.map(lambda a: np.zeros((1, *a.shape[1:]), a.dtype), rows)
    parts = []
    for begin in range(0, max(n, 1), block):
        index = np.clip(np.arange(begin, begin + block), 0, max(n - 1, 0))
        parts.append(function(*jax.tree.map(lambda a, index=index: a[index], rows)))
    return jax.tree.map(lambda *pieces: np.concatenate([np.asarray(p) for p in pieces])[:n], *parts)
