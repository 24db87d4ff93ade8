"""Padded array lengths, so that sequences of different length reuse compiled code."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array


def padded_length(count: int, block: int, factor: int = 4) -> int:
    """Return the smallest of block, block · factor, block · factor², ... that holds `count`.

    A larger factor needs fewer compilations, a smaller one less padding.

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


def padded(array: np.ndarray, *lengths: int) -> Array:
    """Pad the first axes of an array with zeros to these lengths, on the device."""
    widths = [(0, length - n) for length, n in zip(lengths, array.shape, strict=False)]
    whole = np.pad(array, widths + [(0, 0)] * (array.ndim - len(lengths)))
    return jax.device_put(whole)  # `jnp.asarray` would compile a copy of each shape


def in_blocks(function: Callable[..., Any], rows: tuple[Any, ...], block: int) -> Any:
    """Apply a compiled row-wise function to any number of rows, in blocks of one length.

    The function is compiled once, and only the last block is padded.

    Args:
        function: maps arrays of `block` rows to arrays (or pytrees of them) of as many rows, each
            row independently.
        rows: arrays (n, ...) or pytrees of them.
        block: rows per call.

    Returns:
        The function's results for all n rows, on the host.
    """
    n = len(jax.tree.leaves(rows)[0])
    if n == 0:
        rows = jax.tree.map(lambda a: np.zeros((1, *a.shape[1:]), a.dtype), rows)
    structure, whole = None, []
    for begin in range(0, max(n, 1), block):
        index = np.clip(np.arange(begin, begin + block), 0, max(n - 1, 0))
        found = function(*jax.tree.map(lambda a, index=index: a[index], rows))
        parts, structure = jax.tree.flatten(found)
        whole = whole or [np.empty((n, *part.shape[1:]), part.dtype) for part in parts]
        for values, part in zip(whole, parts, strict=True):
            values[begin : begin + block] = np.asarray(part)[: n - begin]
    return jax.tree.unflatten(structure, whole)
