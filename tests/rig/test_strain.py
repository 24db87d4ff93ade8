"""A camera that fits far worse than the others is found, whatever the scale of the residuals."""

import numpy as np
from hypothesis import given, strategies as st

from catfree.rig.strain import FEWEST_TO_COMPARE, STRAINED, most_strained

usual = st.floats(0.9, 1.1)


@given(
    st.lists(usual, min_size=FEWEST_TO_COMPARE, max_size=8),
    st.integers(0, 7),
    st.floats(0.01, 100.0),
    st.randoms(),
)
def test_the_one_that_stands_out(values, at, scale, random):
    residual = np.array(values)
    assert most_strained(residual * scale) is None
    at %= len(values)
    residual[at] = 1.2 * STRAINED * 1.1
    assert most_strained(residual * scale) == at
    assert most_strained(residual * scale, tried={at}) is None
    order = list(range(len(values)))
    random.shuffle(order)
    assert order[most_strained(residual[order])] == at


@given(st.lists(usual, min_size=FEWEST_TO_COMPARE, max_size=6), st.integers(1, 3))
def test_cameras_outside_the_rig_are_no_measure(values, missing):
    residual = np.array([5.0, *values, *[np.nan] * missing])
    assert most_strained(residual) == 0
    assert most_strained(np.full(5, np.nan)) is None


def test_few_cameras_bend_each_other():
    assert most_strained(np.array([1.0, 1.0, 9.0])) is None
    assert most_strained(np.zeros(0)) is None


def test_the_worst_of_two_comes_first():
    residual = np.array([1.0, 3.0, 1.0, 1.0, 4.0])
    assert most_strained(residual) == 4
    assert most_strained(residual, tried=[4]) == 1
