"""Calibration of uncertainty: simulated truth with known coverage, laws, worked examples."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import evaluation
from catfree.errors import InvalidInputError


def simulate(seed, n=4000, reported=1.0):
    """Simulate people 10 m apart, one per frame, with errors drawn from their covariances."""
    random = np.random.default_rng(seed)
    truth = np.column_stack([np.arange(n), np.zeros(n), random.uniform(-5, 5, (n, 2))])
    factor = random.normal(0, 0.08, (n, 2, 2)) + 0.1 * np.eye(2)
    covariance = factor @ factor.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), random.normal(size=(n, 2)))
    predicted = truth.copy()
    predicted[:, 2:] += error
    return truth, predicted, covariance * reported**2


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_honest_covariances_cover_their_level(level):
    coverage = evaluation.ellipse_coverage(*simulate(0), threshold=5.0, level=level)
    assert coverage.matched == 4000
    # Four standard deviations of a binomial share.
    assert coverage.share == pytest.approx(level, abs=4 * math.sqrt(level * (1 - level) / 4000))
    assert coverage.sigma_factor == pytest.approx(1.0, abs=0.05)
    assert coverage.squared_mahalanobis.mean() == pytest.approx(2.0, abs=0.15)


@pytest.mark.slow
def test_overconfidence_is_seen_and_measured():
    coverage = evaluation.ellipse_coverage(*simulate(1, reported=0.5), threshold=5.0)
    # With half the sigma, the 95 % ellipse contains 1 - 0.05^(1/4) of a plane Gaussian.
    assert coverage.share == pytest.approx(1 - 0.05**0.25, abs=0.035)
    assert coverage.sigma_factor == pytest.approx(2.0, abs=0.1)
    assert "matched positions inside the 95 % ellipse" in str(coverage)


@pytest.mark.slow
@given(st.floats(-3, 3), st.floats(0.3, 3))
def test_rotating_or_scaling_the_world_changes_no_mahalanobis_distance(angle, scale):
    truth, predicted, covariance = simulate(2, n=30)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = [table.copy() for table in (truth, predicted)]
    for table in moved:
        table[:, 2:] = table[:, 2:] @ turn.T
    expected = evaluation.ellipse_coverage(truth, predicted, covariance, threshold=2)
    result = evaluation.ellipse_coverage(*moved, turn @ covariance @ turn.T, threshold=2 * scale)
    np.testing.assert_allclose(result.squared_mahalanobis, expected.squared_mahalanobis, rtol=1e-7)


def test_a_rotated_circle_is_symmetric():
    angle = np.linspace(0, 3, 50)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn = np.moveaxis(turn, -1, 0).astype(np.float32)
    rows = [[frame, 0, 0, 0] for frame in range(50)]
    covariance = turn @ (0.3 * turn.transpose(0, 2, 1))
    assert (covariance != covariance.transpose(0, 2, 1)).any()
    assert evaluation.ellipse_coverage(rows, rows, covariance).matched == 50


def test_covariances_stay_with_their_rows_when_frames_are_chosen():
    truth = [[0, 0, 0, 0], [1, 0, 0, 0], [2, 0, 0, 0]]
    predicted = [[2, 0, 0.3, 0.0], [0, 0, 0.0, 0.4], [1, 0, 0.1, 0.0]]
    covariance = np.array([np.diag([0.09, 1.0]), np.diag([1.0, 0.04]), np.diag([0.01, 1.0])])
    everything = evaluation.ellipse_coverage(truth, predicted, covariance)
    assert sorted(everything.squared_mahalanobis) == pytest.approx([1, 1, 4])
    some = evaluation.ellipse_coverage(truth, predicted, covariance, [0, 2])
    assert some.squared_mahalanobis == pytest.approx([4, 1])
    none = evaluation.ellipse_coverage(truth, predicted, covariance, [7])
    assert none.matched == 0
    assert math.isnan(none.share)
    assert math.isnan(none.sigma_factor)
    assert evaluation.ellipse_coverage([], [], []).matched == 0


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(2), r"must have shape \(2, 2, 2\)"),
        ([np.eye(2), np.diag([1.0, 0.0])], r"covariance\[1\]"),
        ([np.eye(2), -np.eye(2)], r"covariance\[1\]"),
        ([np.array([[1.0, 0.5], [0.2, 1.0]]), np.eye(2)], r"covariance\[0\].*symmetric"),
        ([np.eye(2), np.full((2, 2), np.nan)], r"covariance\[1\].*finite"),
    ],
)
def test_bad_covariances_are_named(covariance, message):
    rows = [[0, 0, 0, 0], [1, 0, 0, 0]]
    with pytest.raises(InvalidInputError, match=message):
        evaluation.ellipse_coverage(rows, rows, covariance)


def test_level_outside_the_unit_interval_is_refused():
    with pytest.raises(InvalidInputError, match="level is 1"):
        evaluation.ellipse_coverage([], [], [], level=1)


def test_matched_predictions_are_the_true_positives_in_input_order():
    truth = [[0, 0, 0, 0], [1, 0, 0, 0]]
    predicted = [[1, 0, 0.6, 0], [0, 0, 0.5, 0], [1, 1, 0.2, 0], [3, 0, 0, 0]]
    correct = evaluation.matched_predictions(truth, predicted)
    assert correct.tolist() == [False, True, True, False]
    assert correct.sum() == evaluation.detection_metrics(truth, predicted).tp


probabilities = st.lists(st.floats(0, 1), max_size=30)


@given(probabilities, st.integers(1, 12), st.data())
def test_calibration_curve_equals_a_count_by_hand(claimed, bins, data):
    correct = [data.draw(st.booleans()) for _ in claimed]
    curve = evaluation.calibration_curve(claimed, correct, bins)
    assert curve.count.sum() == len(claimed)
    error = 0.0
    for b in range(bins):
        last = b == bins - 1
        inside = [
            k
            for k, p in enumerate(claimed)
            if curve.edges[b] <= p and (last or p < curve.edges[b + 1])
        ]
        assert curve.count[b] == len(inside)
        if not inside:
            assert math.isnan(curve.mean_probability[b])
            continue
        mean = sum(claimed[k] for k in inside) / len(inside)
        frequency = sum(correct[k] for k in inside) / len(inside)
        assert curve.mean_probability[b] == pytest.approx(mean)
        assert curve.observed_frequency[b] == pytest.approx(frequency)
        error += len(inside) / len(claimed) * abs(mean - frequency)
    if claimed:
        assert curve.expected_calibration_error == pytest.approx(error, abs=1e-12)
        assert 0 <= curve.brier_score <= 1
    else:
        assert math.isnan(curve.expected_calibration_error)


@pytest.mark.parametrize("bins", [1, 3, 10, 20, 100])
def test_a_probability_on_a_border_is_in_the_upper_bin(bins):
    borders = [k / bins for k in range(bins)]
    curve = evaluation.calibration_curve(borders, [True] * bins, bins)
    np.testing.assert_array_equal(curve.count, 1)


def test_honest_probabilities_have_little_calibration_error():
    random = np.random.default_rng(3)
    claimed = random.uniform(0, 1, 20000)
    correct = random.uniform(0, 1, 20000) < claimed
    honest = evaluation.calibration_curve(claimed, correct)
    assert honest.expected_calibration_error < 0.02
    assert honest.brier_score == pytest.approx(1 / 6, abs=0.01)  # mean of p (1 - p)
    boastful = evaluation.calibration_curve(np.sqrt(claimed), correct)
    assert boastful.expected_calibration_error == pytest.approx(2 / 3 - 1 / 2, abs=0.02)


@pytest.mark.parametrize(
    ("claimed", "correct", "bins", "message"),
    [
        ([0.5, 1.2], [1, 0], 10, r"probability\[1\] is 1.2"),
        ([0.5, math.nan], [1, 0], 10, r"probability\[1\] is nan"),
        ([0.5], [2], 10, r"correct\[0\] is neither"),
        ([0.5], [1, 0], 10, "the same length"),
        ([0.5], [1], 0, "bins is 0"),
    ],
)
def test_bad_probabilities_are_named(claimed, correct, bins, message):
    with pytest.raises(InvalidInputError, match=message):
        evaluation.calibration_curve(claimed, correct, bins)


def test_one_line_summary():
    text = str(evaluation.calibration_curve([0.75, 0.75], [1, 0]))
    assert text == "expected calibration error 0.250, Brier score 0.312 (2 predictions)"
