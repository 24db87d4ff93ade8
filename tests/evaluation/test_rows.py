"""Which frames count: listed frames without rows, and rows of frames that are not listed."""

import inspect

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import evaluation
from catfree.errors import InvalidInputError

AREA = (-10.0, 10.0, -10.0, 10.0)
cells = st.integers(-8, 8).map(lambda cell: cell / 8)


@st.composite
def people(draw):
    """Draw rows of at most three people in frames 0 to 3, each identity once per frame."""
    keys = draw(st.sets(st.tuples(st.integers(0, 3), st.integers(0, 2))))
    rows = [[frame, identity, draw(cells), draw(cells)] for frame, identity in sorted(keys)]
    return np.array(rows, dtype=float).reshape(-1, 4)


def scores(truth, predicted, frames):
    detection = evaluation.detection_metrics(truth, predicted, frames)
    area = evaluation.detection_metrics_in_area(truth, predicted, AREA, frames).metrics
    tracking = evaluation.tracking_metrics(truth, predicted, frames)
    hota = evaluation.hota(truth, predicted, frames)
    covariance = np.broadcast_to(np.eye(2), (len(predicted), 2, 2))
    ellipses = evaluation.ellipse_coverage(truth, predicted, covariance, frames)
    return np.array(
        [
            *detection.rates,
            detection.fp,
            detection.fn,
            *area.rates,
            tracking.mota,
            tracking.idf1,
            tracking.id_switches,
            hota.hota,
            hota.loca,
            ellipses.matched,
        ]
    )


def test_columns_of_a_table_in_another_order_are_refused():
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"id": [7], "frame": [0], "x": [1.0], "y": [2.0]})
    with pytest.raises(InvalidInputError, match=r"ground_truth has the columns \['id', 'frame',"):
        evaluation.detection_metrics(table, [])
    right = table[["frame", "id", "x", "y"]]
    assert evaluation.detection_metrics(right, right.to_numpy()).tp == 1


@pytest.mark.slow
@given(people(), people())
def test_a_listed_frame_without_rows_changes_no_score(truth, predicted):
    np.testing.assert_array_equal(
        scores(truth, predicted, [0, 1, 2, 3, 4, 99]), scores(truth, predicted, range(4))
    )
    metrics = evaluation.detection_metrics(truth, predicted, [0, 1, 2, 3, 99])
    np.testing.assert_array_equal(metrics.frames, [0, 1, 2, 3, 99])
    assert metrics.tp_per_frame[-1] == metrics.fp_per_frame[-1] == metrics.fn_per_frame[-1] == 0


@pytest.mark.slow
@given(people(), people(), st.sets(st.integers(0, 3), min_size=1))
def test_rows_of_frames_that_are_not_listed_are_as_if_they_were_not_there(truth, predicted, frames):
    def listed(rows):
        return rows[np.isin(rows[:, 0], list(frames))]

    np.testing.assert_array_equal(
        scores(truth, predicted, frames), scores(listed(truth), listed(predicted), frames)
    )


def test_a_frame_with_rows_on_one_side_counts_them_as_errors():
    one, other = [[0, 1, 0.0, 0.0], [1, 1, 0.0, 0.0]], [[0, 1, 0.0, 0.0], [2, 1, 0.0, 0.0]]
    metrics = evaluation.detection_metrics(one, other, [0, 1, 2, 3])
    assert (metrics.tp, metrics.fp, metrics.fn) == (1, 1, 1)
    assert metrics.moda == pytest.approx(0)


def test_imaginary_parts_are_not_dropped():
    with pytest.raises(InvalidInputError, match=r"ground_truth must be .* got complex128"):
        evaluation.detection_metrics(np.ones((1, 4)) * 1j, np.zeros((0, 4)))


def test_frames_that_share_nothing_with_the_rows_leave_nothing_to_score():
    one = [[0, 1, 0.0, 0.0]]
    metrics = evaluation.detection_metrics(one, one, [5, 10])
    assert np.isnan(metrics.moda)
    assert (metrics.tp, metrics.fp, metrics.fn) == (0, 0, 0)


@pytest.mark.parametrize("frames", [frozenset({1, 2}), {1: "a", 2: "b"}.keys(), range(1, 3)])
def test_frames_may_be_any_set(frames):
    rows = np.array([[1, 0, 0.0, 0.0], [3, 0, 0.0, 0.0]])
    assert evaluation.detection_metrics(rows, rows, frames).frames.tolist() == [1, 2]


@pytest.mark.parametrize("threshold", ["0.5 m", None, -1.0, np.nan])
def test_a_threshold_that_is_no_length_is_refused(threshold):
    with pytest.raises(InvalidInputError, match="threshold"):
        inspect.unwrap(evaluation.detection_metrics)(*np.zeros((2, 0, 4)), None, threshold)
