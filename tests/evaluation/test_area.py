"""Metrics in an area: inside, and both ways to count positions outside."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import evaluation
from catfree.errors import InvalidInputError

AREA = (0.0, 4.0, -1.0, 3.0)
cells = st.integers(-40, 60).map(lambda cell: cell / 8)
tables = st.lists(st.tuples(st.integers(0, 3), cells, cells), max_size=12).map(
    lambda rows: np.array([[f, i, x, y] for i, (f, x, y) in enumerate(rows)]).reshape(-1, 4)
)


@given(tables)
def test_crop_keeps_exactly_the_rows_inside_and_is_idempotent(table):
    inside = evaluation.crop(table, AREA)
    expected = [row for row in table.tolist() if 0 <= row[2] <= 4 and -1 <= row[3] <= 3]
    assert inside.tolist() == expected
    assert evaluation.crop(inside, AREA).tolist() == expected
    assert evaluation.crop(table, {"x": AREA[:2], "y": AREA[2:]}).tolist() == expected
    assert table[evaluation.inside(table.tolist(), AREA)].tolist() == expected


@pytest.mark.slow
@given(tables, tables)
def test_ignoring_the_outside_equals_cropping_both(truth, predicted):
    result = evaluation.detection_metrics_in_area(truth, predicted, AREA, range(4))
    expected = evaluation.detection_metrics(
        evaluation.crop(truth, AREA), evaluation.crop(predicted, AREA), range(4)
    )
    assert str(result.metrics) == str(expected)
    assert result.ground_truth_outside == len(truth) - len(evaluation.crop(truth, AREA))
    assert result.predictions_outside == len(predicted) - len(evaluation.crop(predicted, AREA))


@given(tables, tables)
def test_counting_the_outside_changes_only_predictions(truth, predicted):
    ignored = evaluation.detection_metrics_in_area(truth, predicted, AREA)
    counted = evaluation.detection_metrics_in_area(truth, predicted, AREA, outside="false_positive")
    assert counted.metrics.tp >= ignored.metrics.tp
    assert counted.metrics.tp + counted.metrics.fp == len(predicted)
    assert counted.metrics.frames.tolist() == ignored.metrics.frames.tolist()
    total = ignored.metrics.tp + ignored.metrics.fn
    assert counted.metrics.tp + counted.metrics.fn == total
    assert counted.predictions_outside == ignored.predictions_outside


@given(tables, tables)
def test_an_endless_area_changes_nothing(truth, predicted):
    endless = (-np.inf, np.inf, -np.inf, np.inf)
    result = evaluation.detection_metrics_in_area(truth, predicted, endless)
    assert str(result.metrics) == str(evaluation.detection_metrics(truth, predicted))
    assert (result.ground_truth_outside, result.predictions_outside) == (0, 0)


def test_a_person_outside_by_hand():
    truth = [[0, 1, 1.0, 1.0], [0, 2, 9.0, 1.0]]
    predicted = [[0, 1, 1.0, 1.0], [0, 2, 9.0, 1.0]]
    ignored = evaluation.detection_metrics_in_area(truth, predicted, AREA)
    counted = evaluation.detection_metrics_in_area(truth, predicted, AREA, outside="false_positive")
    assert (ignored.metrics.moda, counted.metrics.moda) == (100.0, 0.0)
    assert "outside: 1 true, 1 predicted (ignore)" in str(ignored)


def test_frames_whose_people_are_all_outside_still_count():
    truth = [[0, 1, 1.0, 1.0], [1, 1, 9.0, 9.0]]
    result = evaluation.detection_metrics_in_area(truth, truth, AREA)
    assert result.metrics.frames.tolist() == [0, 1]


@pytest.mark.parametrize(
    "area",
    [
        (0, 1, 2),
        (1, 0, 0, 1),
        (0, 1, np.nan, 1),
        {"x": (0, 1)},
        None,
        "area",
        (0, 0, 0, 1),
        (0, 10**400, 0, 1),
    ],
)
def test_a_malformed_area_is_refused(area):
    with pytest.raises(InvalidInputError, match=r"^area is "):
        evaluation.crop([[0, 1, 0.0, 0.0]], area)


def test_an_unknown_way_to_count_is_refused():
    with pytest.raises(InvalidInputError, match="outside is 'drop'; it must be"):
        evaluation.detection_metrics_in_area([], [], AREA, outside="drop")
