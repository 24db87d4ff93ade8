"""Boxes of several sources, which do not all have the same columns."""

from collections.abc import Sequence
from dataclasses import replace

from catfree.types import Detections


def concatenate_common(parts: Sequence[Detections]) -> Detections:
    """Join detections, keeping the columns that all detections with rows have.

    Raises:
        InvalidInputError: if embeddings have different lengths.
    """
    full = [part for part in parts if len(part)]
    lacking = {name for part in full for name, value in vars(part).items() if value is None}
    lacking.discard("clock")
    return Detections.concatenate([replace(part, **dict.fromkeys(lacking)) for part in parts])
