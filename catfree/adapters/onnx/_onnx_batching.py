"""Running a graph over many inputs when its batch axis is open, or fixed at one or more."""

from collections.abc import Sequence

import numpy as np

from catfree.adapters.onnx._onnx_session import OnnxGraph


def run_batched(
    graph: OnnxGraph, inputs: Sequence[np.ndarray], output: str, largest_batch: int
) -> list[np.ndarray]:
    """The named output of each input, whatever batch length the graph takes.

    Args:
        graph: its input's first axis is the batch.
        inputs: one array an item, without the batch axis, all of one shape.
        output: name of the output.
        largest_batch: bound on memory where the graph leaves the batch length open.

    Returns:
        One array an item, without the batch axis.

    Raises:
        FileFormatError: if the graph does not return one row an item.
    """
    fixed = graph.input_shape[0]
    length = fixed or largest_batch
    rows: list[np.ndarray] = []
    for start in range(0, len(inputs), length):
        items = list(inputs[start : start + length])
        count = len(items)
        if fixed:
            items += [items[-1]] * (fixed - count)
        values = graph.run(np.stack(items))[output]
        if len(values) != len(items):
            raise graph.mismatch(
                f"its output {output!r} has {len(values)} rows for a batch of {len(items)}"
            )
        rows.extend(values[:count])
    return rows
