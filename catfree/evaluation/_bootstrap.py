"""Confidence intervals of the detection metrics by resampling frames with replacement."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.evaluation._detection_metrics import DetectionMetrics, detection_rates
from catfree.evaluation._rows import Number
from catfree.types._validation import as_count, as_number, require_instance


class Interval(NamedTuple):
    """A value with its confidence interval.

    Attributes:
        low: lower end.
        high: upper end.
        value: the value over the whole sequence.
    """

    low: float
    high: float
    value: float

    def __str__(self) -> str:
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


@dataclass(frozen=True)
class DetectionIntervals:
    """Intervals of the four detection rates, in percent.

    Attributes:
        moda: of MODA.
        modp: of MODP.
        precision: of precision.
        recall: of recall.
        level: share of resamples inside each interval.
        samples: number of resamples.
        block_length: number of successive frames drawn together.
    """

    moda: Interval
    modp: Interval
    precision: Interval
    recall: Interval
    level: float
    samples: int
    block_length: int

    def __str__(self) -> str:
        return (
            f"MODA {self.moda}  MODP {self.modp}  precision {self.precision}  "
            f"recall {self.recall}  ({100 * self.level:g} % intervals)"
        )


def bootstrap(
    metrics: DetectionMetrics,
    samples: int = 2000,
    *,
    seed: int | np.random.Generator = 0,
    level: Number = 0.95,
    block_length: int = 1,
) -> DetectionIntervals:
    """Estimate how much the metrics would vary with other annotated frames of the scene.

    Each resample draws as many frames as there are, with replacement. Neighboring frames show the
    same people, so their errors are correlated and drawing single frames gives intervals that are
    too narrow. Blocks of successive frames (wrapping around the end) keep that dependence.

    Args:
        metrics: the counts of every frame, from `detection_metrics`.
        samples: number of resamples.
        seed: seed of the random generator, or the generator itself.
        level: share of resamples inside the interval; equal shares lie below and above.
        block_length: number of successive frames drawn together; 1 treats frames as independent.

    Returns:
        Percentile intervals. Resamples in which a rate is undefined are left out of its interval.

    Raises:
        InvalidInputError: if an argument is out of range.
        InsufficientDataError: if there are no frames.

    Source:
        Efron and Tibshirani, "An introduction to the bootstrap" (1993); Politis and Romano, "A
        circular block-resampling procedure for stationary data" (1992).
    """
    require_instance(metrics, DetectionMetrics, "metrics")
    n = len(metrics.frames)
    if n == 0:
        raise InsufficientDataError("Cannot bootstrap: 0 frames were evaluated, at least 1 needed.")
    block_length = as_count(block_length, "block_length")
    if not 1 <= block_length <= n:
        raise InvalidInputError(f"block_length is {block_length}; it must be between 1 and {n}.")
    samples, level = as_count(samples, "samples"), as_number(level, "level")
    if samples < 1 or not 0 < level < 1:
        raise InvalidInputError(
            f"samples is {samples} and level {level}; give at least 1 and a share inside (0, 1)."
        )
    if not isinstance(seed, np.random.Generator):
        seed = as_count(seed, "seed", least=0)
    generator = np.random.default_rng(seed)
    starts = generator.integers(n, size=(samples, -(-n // block_length)))
    blocks = starts[:, :, None] + np.arange(block_length)
    drawn = blocks.reshape(samples, -1)[:, :n] % n
    rates = detection_rates(
        metrics.tp_per_frame[drawn].sum(axis=1),
        metrics.fp_per_frame[drawn].sum(axis=1),
        metrics.fn_per_frame[drawn].sum(axis=1),
        metrics.distance_sum_per_frame[drawn].sum(axis=1),
        metrics.threshold,
        clamped=metrics.clamped,
    )
    intervals = (
        Interval(*_percentiles(resampled, level), value)
        for resampled, value in zip(rates, metrics.rates, strict=True)
    )
    return DetectionIntervals(*intervals, level=level, samples=samples, block_length=block_length)


def _percentiles(values: np.ndarray, level: Number) -> tuple[float, float]:
    """Both ends of the central interval, rounded outwards to values that occurred."""
    ordered = np.sort(values[~np.isnan(values)])
    if not len(ordered):
        return float("nan"), float("nan")
    # No interpolation: MODA may be -inf in a resample, and inf - inf would be nan.
    tail = (1 - level) / 2 * (len(ordered) - 1)
    return float(ordered[int(np.floor(tail))]), float(
        ordered[int(np.ceil(len(ordered) - 1 - tail))]
    )
