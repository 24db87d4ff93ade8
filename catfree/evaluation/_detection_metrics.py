"""Ground-plane detection metrics: MODA, MODP, precision and recall."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError, quoted
from catfree.evaluation._pooling import pool
from catfree.evaluation._position_matching import GATE_TOLERANCE, match_within
from catfree.evaluation._rows import Frames, Number, Sequence, read_sequence
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_positive


class DetectionRates(NamedTuple):
    """The four rates in percent; scalars or arrays of one shape."""

    moda: Any
    modp: Any
    precision: Any
    recall: Any


def detection_rates(
    tp: Any, fp: Any, fn: Any, distance_sum: Any, threshold: Number, *, clamped: bool
) -> DetectionRates:
    """Turn counts into percentages, elementwise.

    Args:
        tp: matched pairs.
        fp: unmatched predictions.
        fn: unmatched ground truth.
        distance_sum: summed distance of the matched pairs in meters.
        threshold: the gate in meters, the distance at which a pair adds 0 to MODP.
        clamped: whether a negative or nan MODA becomes 0.

    Returns:
        The rates. MODA without ground truth is nan, or -inf if there are predictions; the others
        are 0 where their denominator is 0.
    """
    tp, fp, fn, distance_sum = (
        np.asarray(value, dtype=np.float64) for value in (tp, fp, fn, distance_sum)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        moda = 100 * (1 - (fn + fp) / (tp + fn))
        return DetectionRates(
            moda=np.fmax(moda, 0.0) if clamped else moda,
            modp=np.where(tp > 0, 100 * (1 - distance_sum / (threshold * tp)), 0.0),
            precision=np.where(tp + fp > 0, 100 * tp / (tp + fp), 0.0),
            recall=np.where(tp + fn > 0, 100 * tp / (tp + fn), 0.0),
        )


@dataclass(frozen=True, eq=False)
class DetectionMetrics:
    """Detection quality over a sequence, with the counts of every frame.

    Attributes:
        frames: (F,) evaluated frames.
        tp_per_frame: (F,) matched pairs.
        fp_per_frame: (F,) unmatched predictions.
        fn_per_frame: (F,) unmatched ground truth.
        distance_sum_per_frame: (F,) summed distance of the matched pairs in meters.
        threshold: the gate in meters.
        clamped: whether negative MODA is reported as 0 (one historical evaluator does).
    """

    frames: Int[np.ndarray, " f"]
    tp_per_frame: Int[np.ndarray, " f"]
    fp_per_frame: Int[np.ndarray, " f"]
    fn_per_frame: Int[np.ndarray, " f"]
    distance_sum_per_frame: Float[np.ndarray, " f"]
    threshold: float
    clamped: bool = False

    @property
    def tp(self) -> int:
        """Matched pairs."""
        return int(self.tp_per_frame.sum())

    @property
    def fp(self) -> int:
        """Predictions without a ground-truth partner."""
        return int(self.fp_per_frame.sum())

    @property
    def fn(self) -> int:
        """Ground truth without a prediction."""
        return int(self.fn_per_frame.sum())

    @property
    def rates(self) -> DetectionRates:
        """MODA, MODP, precision and recall in percent."""
        rates = detection_rates(
            self.tp,
            self.fp,
            self.fn,
            self.distance_sum_per_frame.sum(),
            self.threshold,
            clamped=self.clamped,
        )
        return DetectionRates(*(float(rate) for rate in rates))

    @property
    def moda(self) -> float:
        """100 (1 - (FN + FP) / GT): 100 is perfect, negative is possible."""
        return self.rates.moda

    @property
    def modp(self) -> float:
        """Mean of 100 (1 - d / threshold) over the matched pairs."""
        return self.rates.modp

    @property
    def precision(self) -> float:
        """Percent of the predictions that are matched."""
        return self.rates.precision

    @property
    def recall(self) -> float:
        """Percent of the ground truth that is matched."""
        return self.rates.recall

    def __str__(self) -> str:
        return (
            f"MODA {self.moda:.2f}  MODP {self.modp:.2f}  precision {self.precision:.2f}  "
            f"recall {self.recall:.2f}  TP {self.tp}  FP {self.fp}  FN {self.fn}  "
            f"({len(self.frames)} frames)"
        )


def detection_metrics(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    frames: Frames | None = None,
    threshold: Number = 0.5,
    *,
    compat: str | None = None,
) -> DetectionMetrics:
    """Compare predicted with true ground positions frame by frame, regardless of identity.

    In each frame, pairs at most `threshold` apart are matched one to one: as many pairs as
    possible, then the smallest total distance. Nothing is cropped; a prediction outside the
    annotated area is a false positive unless you remove it first, for instance with `crop`.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], x and y in meters on the ground; the id is
            ignored.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        frames: the frames to evaluate, also those without rows; rows of other frames are ignored.
            None evaluates every frame that either array mentions.
        threshold: largest distance of a match in meters.
        compat: None for the definition above. "mvdet_frames" evaluates only frames with
            predictions, so ground truth elsewhere is never missed. "mvdet_python" reproduces the
            Python evaluator of MVDet: it also drops the frames after the last one that has both
            predictions and ground truth, loses pairs at exactly the threshold even after assigning
            them, and reports negative MODA as 0.

    Returns:
        The metrics, in percent.

    Raises:
        InvalidInputError: naming the first bad row or argument.

    Source:
        Kasturi et al., "Framework for performance evaluation of face, text, and vehicle detection
        and tracking in video" (PAMI 2009), with MODP pooled over pairs as in Hou et al.,
        "Multiview detection with feature perspective transformation" (ECCV 2020).
    """
    gate = as_positive(threshold, "threshold")
    sequence = read_sequence(ground_truth, predictions, frames)
    kept = _evaluated(sequence, compat)
    strict = compat == "mvdet_python"
    tp, fp, fn, distance_sum = [], [], [], []
    for truth, predicted in sequence:
        distance = match_within(sequence.distances(truth, predicted), gate).distance
        if strict:
            distance = distance[distance < gate - GATE_TOLERANCE]
        tp.append(len(distance))
        fp.append(len(predicted) - len(distance))
        fn.append(len(truth) - len(distance))
        distance_sum.append(distance.sum())
    return DetectionMetrics(
        frames=sequence.frames[kept],
        tp_per_frame=np.array(tp, dtype=np.int64)[kept],
        fp_per_frame=np.array(fp, dtype=np.int64)[kept],
        fn_per_frame=np.array(fn, dtype=np.int64)[kept],
        distance_sum_per_frame=np.array(distance_sum, dtype=np.float64)[kept],
        threshold=gate,
        clamped=strict,
    )


def _evaluated(sequence: Sequence, compat: str | None) -> np.ndarray:
    """Mark the frames that count, (F,) bool."""
    predicted = np.array([len(rows) > 0 for rows in sequence.predicted_rows], dtype=bool)
    true = np.array([len(rows) > 0 for rows in sequence.truth_rows], dtype=bool)
    if compat is None:
        return np.ones(len(sequence.frames), dtype=bool)
    if compat == "mvdet_frames":
        return predicted
    if compat == "mvdet_python":
        with_both = np.flatnonzero(predicted & true)
        last = with_both[-1] if len(with_both) else -1
        return predicted & (np.arange(len(predicted)) <= last)
    raise InvalidInputError(
        f"compat is {quoted(compat)}; it must be None, 'mvdet_python' or 'mvdet_frames'."
    )


def combine_detection(parts: Iterable[DetectionMetrics]) -> DetectionMetrics:
    """Combine the metrics of several sequences by concatenating their frames.

    Args:
        parts: metrics of the sequences, all made with the same threshold and `compat`.

    Returns:
        The metrics of the pooled counts.

    Raises:
        InvalidInputError: if there are no parts, or their thresholds or MODA clamping differ.
    """
    alike = {"threshold": "threshold", "clamped": "compat"}
    return pool(parts, DetectionMetrics, np.concatenate, alike=alike, name="detection")
