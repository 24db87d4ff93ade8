"""Which input size a detector's graph runs at."""

import ast
import math

from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.errors import InvalidInputError

_USUAL_SIDE = 640


def choose_input_size(
    graph: OnnxGraph, image_size: int | tuple[int, int] | None, stride: int
) -> tuple[int, int]:
    """The graph's own input size, or the one that fills its open axes.

    Args:
        graph: input [batch, 3, H, W].
        image_size: side or (height, width) asked for, or None for the exporter's, or else 640.
        stride: open axes are rounded up to a multiple of it.

    Returns:
        (width, height) in pixels.

    Raises:
        InvalidInputError: if the size is not positive or a fixed graph has another one.
    """
    fixed = graph.input_shape[2:]
    wanted = _exported_size(graph) if image_size is None else image_size
    height, width = (wanted, wanted) if isinstance(wanted, int) else wanted
    if min(height, width) < 1:
        raise InvalidInputError(f"image_size must be positive pixels, got {image_size}.")
    height, width = (math.ceil(side / stride) * stride for side in (height, width))
    sides = tuple(own or asked for own, asked in zip(fixed, (height, width), strict=True))
    if image_size is not None and sides != (height, width):
        raise InvalidInputError(
            f"{graph.path} is fixed to an input of {sides[0]} x {sides[1]} px (height x width), "
            f"but image_size asks for {height} x {width}. Export it with open axes, or leave "
            "image_size out."
        )
    return sides[1], sides[0]


def _exported_size(graph: OnnxGraph) -> int | tuple[int, int]:
    """What the exporter noted, or the usual size where it noted nothing that can be read."""
    try:
        height, width = ast.literal_eval(graph.metadata["imgsz"])
        return int(height), int(width)
    except (KeyError, ValueError, SyntaxError, TypeError):
        return _USUAL_SIDE
