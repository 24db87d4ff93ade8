"""Choice of the input size of a detector's graph."""

import ast
import math

from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.errors import InvalidInputError

_USUAL_SIDE = 640


def choose_input_size(
    graph: OnnxGraph, image_size: int | tuple[int, int] | None, stride: int
) -> tuple[int, int]:
    """Choose the graph's fixed input size, or one that fills its open axes.

    Args:
        graph: input [batch, 3, H, W].
        image_size: requested side or (height, width); None for the exporter's, or else 640.
        stride: open axes are rounded up to a multiple of it.

    Returns:
        (width, height) in pixels.

    Raises:
        InvalidInputError: if the size is not positive or differs from that of a fixed graph.
    """
    fixed = graph.input_shape[2:]
    size = _exported_size(graph) if image_size is None else image_size
    height, width = (size, size) if isinstance(size, int) else size
    if min(height, width) < 1:
        raise InvalidInputError(f"image_size must be positive pixels, got {image_size}.")
    height, width = (math.ceil(side / stride) * stride for side in (height, width))
    sides = tuple(side or free for side, free in zip(fixed, (height, width), strict=True))
    if image_size is not None and sides != (height, width):
        raise InvalidInputError(
            f"{graph.path} is fixed to an input of {sides[0]} x {sides[1]} px (height x width), "
            f"but image_size asks for {height} x {width}. Export it with open axes, or leave "
            "image_size out."
        )
    return sides[1], sides[0]


def _exported_size(graph: OnnxGraph) -> int | tuple[int, int]:
    """Read the size that the exporter stored, or return the usual one."""
    try:
        height, width = ast.literal_eval(graph.metadata["imgsz"])
        return int(height), int(width)
    except (KeyError, ValueError, SyntaxError, TypeError):
        return _USUAL_SIDE
