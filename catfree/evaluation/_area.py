"""Detection metrics inside a rectangle of the ground, ignoring or counting predictions outside."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from catfree.errors import InvalidInputError, quoted
from catfree.evaluation._detection_metrics import DetectionMetrics, detection_metrics
from catfree.evaluation._rows import Frames, Number, as_rows, read_sequence
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_area


def crop(rows: ArrayInput, area: Any) -> Float[np.ndarray, "n 4"]:
    """Keep the rows whose position lies in a rectangle, including its border.

    Args:
        rows: (N, 4) rows [frame, id, x, y], meters.
        area: (x_min, x_max, y_min, y_max) in meters, or {"x": (x_min, x_max), "y": (y_min, y_max)}.

    Returns:
        The rows inside, in input order.

    Raises:
        InvalidInputError: if a row or the area is malformed.
    """
    array = as_rows(rows, "rows")
    return array[inside(array, area)]


def inside(rows: ArrayInput, area: Any) -> Bool[np.ndarray, " n"]:
    """Mark the rows that lie in an axis-aligned rectangle, including its border.

    Args:
        rows: (N, 4) rows [frame, id, x, y], meters.
        area: `x_min, x_max, y_min, y_max` in meters, or a mapping with the pairs `x` and `y`.

    Returns:
        (N,) bool, the rows that `crop` would keep.

    Raises:
        InvalidInputError: if a row or the area is malformed.
    """
    x, y = as_rows(rows, "rows")[:, 2:].T
    x_min, x_max, y_min, y_max = as_area(area, finite=False)
    return (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)


@dataclass(frozen=True, eq=False)
class AreaMetrics:
    """Detection metrics inside an area, and the number of rows outside it.

    Attributes:
        metrics: the metrics.
        ground_truth_outside: number of ground-truth rows outside the area; they never count.
        predictions_outside: number of predictions outside the area.
        outside: how those predictions were counted.
    """

    metrics: DetectionMetrics
    ground_truth_outside: int
    predictions_outside: int
    outside: str

    def __str__(self) -> str:
        return (
            f"{self.metrics}  outside: {self.ground_truth_outside} true, "
            f"{self.predictions_outside} predicted ({self.outside})"
        )


def detection_metrics_in_area(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    area: Any,
    frames: Frames | None = None,
    threshold: Number = 0.5,
    *,
    outside: str = "ignore",
    compat: str | None = None,
) -> AreaMetrics:
    """Compute detection metrics of the people annotated in an area.

    Benchmarks annotate only a rectangle, and people walk outside it. Counting predictions there as
    false positives penalizes correct ones; ignoring them hides wrong ones. Report which you did.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], meters; rows outside the area are dropped.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        area: see `crop`.
        frames: the frames to evaluate, also those without rows; rows of other frames are ignored.
            None evaluates every frame that either array mentions, inside the area or not.
        threshold: largest distance of a match in meters.
        outside: "ignore" drops predictions outside the area; "false_positive" keeps them, so each
            is a false positive unless it matches a person just inside.
        compat: see `detection_metrics`.

    Returns:
        The metrics and the number of rows outside.

    Raises:
        InvalidInputError: naming the first bad row or argument.
    """
    if outside not in ("ignore", "false_positive"):
        raise InvalidInputError(
            f"outside is {quoted(outside)}; it must be 'ignore' or 'false_positive'."
        )
    sequence = read_sequence(ground_truth, predictions, frames)
    truth_inside = inside(sequence.truth, area)
    predicted_inside = inside(sequence.predicted, area)
    kept = predicted_inside if outside == "ignore" else slice(None)
    metrics = detection_metrics(
        sequence.truth[truth_inside],
        sequence.predicted[kept],
        sequence.frames,
        threshold,
        compat=compat,
    )
    return AreaMetrics(
        metrics=metrics,
        ground_truth_outside=int((~truth_inside).sum()),
        predictions_outside=int((~predicted_inside).sum()),
        outside=outside,
    )
