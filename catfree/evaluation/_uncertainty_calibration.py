"""Calibration of reported uncertainties: covariance ellipses and existence probabilities."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InvalidInputError
from catfree.evaluation._position_matching import matched_rows
from catfree.evaluation._rows import Frames, Number, as_rows, read_sequence
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import (
    as_boolean,
    as_count,
    as_float,
    as_number,
    as_positive,
    refuse,
)

ASYMMETRY = 1e-5  # of a covariance rotated in single precision, relative to its standard deviations


def matched_predictions(
    ground_truth: ArrayInput, predictions: ArrayInput, threshold: Number = 0.5
) -> Bool[np.ndarray, " p"]:
    """Mark the predictions that are true positives, as defined by `detection_metrics`.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], meters.
        predictions: (P, 4) rows of the same form.
        threshold: largest distance of a match in meters.

    Returns:
        (P,) bool in the order of `predictions`, for the argument `correct` of `calibration_curve`.

    Raises:
        InvalidInputError: naming the first bad row.
    """
    gate = as_positive(threshold, "threshold")
    sequence = read_sequence(ground_truth, predictions)
    correct = np.zeros(len(sequence.predicted), dtype=bool)
    correct[matched_rows(sequence, gate)[1]] = True
    return correct


@dataclass(frozen=True, eq=False)
class EllipseCoverage:
    """Share of true positions inside the uncertainty ellipses of their predictions.

    Attributes:
        level: the expected share inside.
        squared_mahalanobis: (M,) of each matched pair; chi-square with two degrees of freedom if
            the covariances are right.
    """

    level: float
    squared_mahalanobis: Float[np.ndarray, " m"]

    @property
    def matched(self) -> int:
        """Number of matched pairs."""
        return len(self.squared_mahalanobis)

    @property
    def _limit(self) -> float:
        """Quantile of the squared distance: chi-square with two degrees of freedom."""
        return float(-2 * np.log1p(-self.level))

    @property
    def share(self) -> float:
        """Share inside the ellipse, nan without pairs; below `level` if overconfident."""
        inside = self.squared_mahalanobis <= self._limit
        return float(inside.mean()) if self.matched else float("nan")

    @property
    def sigma_factor(self) -> float:
        """Factor on all sigmas that would bring `share` to `level`; nan without pairs."""
        if not self.matched:
            return float("nan")
        needed = np.quantile(self.squared_mahalanobis, self.level)
        return float(np.sqrt(needed / self._limit))

    def __str__(self) -> str:
        return (
            f"{100 * self.share:.1f} % of {self.matched} matched positions inside the "
            f"{100 * self.level:g} % ellipse (sigmas should be x {self.sigma_factor:.2f})"
        )


def ellipse_coverage(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    covariance: ArrayInput,
    frames: Frames | None = None,
    threshold: Number = 1.0,
    *,
    level: Number = 0.95,
) -> EllipseCoverage:
    """Check ground covariances against the true positions.

    Predictions are matched to the ground truth by distance. The gate cuts off larger errors, so it
    should be well above the sigmas: otherwise the coverage looks better than it is.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], meters.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        covariance: (P, 2, 2) of the predicted x, y in square meters, symmetric positive definite.
        frames: the frames to use; rows of other frames are ignored. None uses all.
        threshold: largest distance of a match in meters.
        level: probability content of the ellipse.

    Returns:
        The coverage and the squared Mahalanobis distance of every pair.

    Raises:
        InvalidInputError: naming the first bad row or covariance.
    """
    gate = as_positive(threshold, "threshold")
    level = as_number(level, "level")
    if not 0 < level < 1:
        raise InvalidInputError(f"level is {level}; it must be a probability inside (0, 1).")
    sequence = read_sequence(ground_truth, predictions, frames)
    covariances = np.asarray(as_float(covariance, "covariance"), np.float64)
    rows = as_rows(predictions, "predictions")
    n = len(rows)
    if covariances.shape != (n, 2, 2) and (n or covariances.size):
        raise InvalidInputError(
            f"covariance must have shape ({n}, 2, 2), one per prediction, got {covariances.shape}."
        )
    covariances = covariances.reshape(n, 2, 2)
    _require_positive_definite(covariances)
    covariances = covariances[np.isin(rows[:, 0], sequence.frames)]
    truth, predicted = matched_rows(sequence, gate)
    error = sequence.truth[truth, 2:] - sequence.predicted[predicted, 2:]
    solved = np.linalg.solve(covariances[predicted], error[:, :, None])[:, :, 0]
    return EllipseCoverage(level=level, squared_mahalanobis=(error * solved).sum(axis=1))


def _require_positive_definite(covariances: Float[np.ndarray, "p 2 2"]) -> None:
    xx, xy, yx, yy = covariances.reshape(-1, 4).T
    with np.errstate(invalid="ignore"):
        good = (xx > 0) & (yy > 0) & (xx * yy - xy * yx > 0)
        good &= np.abs(xy - yx) <= ASYMMETRY * np.sqrt(xx * yy)
    good &= np.isfinite(covariances).all(axis=(1, 2))
    fault = "; it must be finite, symmetric and positive definite."
    refuse(~good, covariances, "covariance", fault)


@dataclass(frozen=True, eq=False)
class CalibrationCurve:
    """Reliability diagram: claimed probabilities against observed frequencies.

    Attributes:
        edges: (B + 1,) borders of the bins in [0, 1].
        count: (B,) number of probabilities in each bin.
        mean_probability: (B,) mean claimed probability, nan for an empty bin.
        observed_frequency: (B,) share that was correct, nan for an empty bin.
        expected_calibration_error: mean gap between the two, weighted by `count`.
        brier_score: mean squared difference between probability and outcome.
    """

    edges: Float[np.ndarray, " edge"]
    count: Int[np.ndarray, " bin"]
    mean_probability: Float[np.ndarray, " bin"]
    observed_frequency: Float[np.ndarray, " bin"]
    expected_calibration_error: float
    brier_score: float

    def __str__(self) -> str:
        return (
            f"expected calibration error {self.expected_calibration_error:.3f}, Brier score "
            f"{self.brier_score:.3f} ({int(self.count.sum())} predictions)"
        )


def calibration_curve(
    probability: ArrayInput, correct: ArrayInput, bins: int = 10
) -> CalibrationCurve:
    """Compare claimed probabilities with observed frequencies.

    Args:
        probability: (N,) claimed probabilities in [0, 1].
        correct: (N,) whether each prediction was correct.
        bins: number of bins of equal width; a value on a border belongs to the upper bin.

    Returns:
        The curve; its scores are nan if N is 0.

    Raises:
        InvalidInputError: naming the first probability outside [0, 1], or if the lengths differ.

    Source:
        Naeini et al., "Obtaining well calibrated probabilities using Bayesian binning" (2015).
    """
    claimed = np.asarray(as_float(probability, "probability"), np.float64)
    outcome = as_boolean(correct, "correct")
    if claimed.ndim != 1 or outcome.shape != claimed.shape:
        raise InvalidInputError(
            f"probability {claimed.shape} and correct {outcome.shape} must be flat and of the same "
            "length."
        )
    bins = as_count(bins, "bins", least=1)
    bad = ~((claimed >= 0) & (claimed <= 1))
    refuse(bad, claimed, "probability", "; it must be in [0, 1].")
    edges = np.arange(bins + 1) / bins  # 3 / 10 is 0.3, which `linspace` misses
    index = np.minimum(np.searchsorted(edges, claimed, side="right") - 1, bins - 1)
    count = np.bincount(index, minlength=bins)
    claimed_sum = np.bincount(index, weights=claimed, minlength=bins)
    outcome_sum = np.bincount(index, weights=outcome, minlength=bins)
    with np.errstate(invalid="ignore"):
        return CalibrationCurve(
            edges=edges,
            count=count,
            mean_probability=claimed_sum / count,
            observed_frequency=outcome_sum / count,
            expected_calibration_error=float(
                np.abs(claimed_sum - outcome_sum).sum() / np.float64(len(claimed))
            ),
            brier_score=float(((claimed - outcome) ** 2).sum() / np.float64(len(claimed))),
        )
