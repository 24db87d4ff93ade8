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
        batch = list(inputs[start : start + length])
        count = len(batch)
        if fixed:
            batch += [batch[-1]] * (fixed - count)
        outputs = graph.run(np.stack(batch))[output]
        if len(outputs) != len(batch):
            raise graph.mismatch(
                f"its output {quoted(output)} has {len(outputs)} rows for a batch of {len(batch)}"
            )
        rows.extend(outputs[:count])
    return rows
