"""Running a graph over many inputs, with an open or a fixed batch axis."""

from collections.abc import Sequence

import numpy as np

from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.errors import quoted


def run_batched(
    graph: OnnxGraph, inputs: Sequence[np.ndarray], output: str, largest_batch: int
) -> list[np.ndarray]:
    """Compute the named output of each input, with whatever batch length the graph takes.

    Args:
        graph: a graph whose first input axis is the batch.
        inputs: one array per item, without the batch axis, all of one shape.
        output: name of the output.
        largest_batch: largest batch length if the graph leaves it open, to bound memory.

    Returns:
        One array per item, without the batch axis.

    Raises:
        FileFormatError: if the graph does not return one row per item.
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
                f"its output {quoted(output)} has {len(values)} rows for a batch of {len(items)}"
            )
        rows.extend(values[:count])
    return rows
