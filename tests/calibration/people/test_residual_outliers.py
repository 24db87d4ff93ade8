"""A camera that fits far worse than the others is found, at any scale of the residuals."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people._residual_outliers import residual_outliers, worst_outlier
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
FEWEST = RULES.fewest_to_compare
usual = st.floats(0.9, 1.1)


def outlier(residual, support=None, tried=()):
    support = np.where(np.isnan(residual), np.nan, 0.2) if support is None else support
    return worst_outlier(residual, support, RULES, tried)


@pytest.mark.slow
@given(
    st.lists(usual, min_size=FEWEST, max_size=8),
    st.integers(0, 7),
    st.floats(0.01, 100.0),
    st.randoms(),
)
def test_the_one_that_stands_out(values, at, scale, random):
    residual = np.array(values)
    assert outlier(residual * scale) is None
    at %= len(values)
    residual[at] = 1.2 * RULES.strained_residual * 1.1
    assert outlier(residual * scale) == at
    assert outlier(residual * scale, tried={at}) is None
    order = list(range(len(values)))
    random.shuffle(order)
    assert order[outlier(residual[order])] == at


@given(st.lists(usual, min_size=FEWEST, max_size=8), st.integers(0, 7), st.floats(0.0, 0.15))
def test_the_one_whose_boxes_belong_to_nobody(values, at, share):
    support = np.array(values) * 0.3
    residual = np.ones(len(values))
    assert outlier(residual, support) is None
    at %= len(values)
    support[at] = share * 0.3
    residual[at] = np.nan if share == 0 else 0.1
    assert outlier(residual, support) == at
    assert outlier(residual, support, tried={at}) is None


@given(st.lists(usual, min_size=FEWEST, max_size=6), st.integers(1, 3))
def test_cameras_outside_the_rig_are_no_measure(values, missing):
    residual = np.array([5.0, *values, *[np.nan] * missing])
    assert outlier(residual) == 0
    assert outlier(np.full(5, np.nan)) is None
    assert outlier(np.full(5, np.nan), np.full(5, 0.1)) is None


def test_few_cameras_bend_each_other():
    three = np.array([1.0, 1.0, 9.0])
    assert outlier(three) is None
    assert residual_outliers(three, RULES).tolist() == [False, False, True]
    assert not residual_outliers(np.full(3, np.nan), RULES).any()
    assert outlier(np.zeros(0)) is None


def test_the_worst_of_two_comes_first():
    residual = np.array([1.0, 3.0, 1.0, 1.0, 4.0])
    assert outlier(residual) == 4
    assert outlier(residual, tried=[4]) == 1
