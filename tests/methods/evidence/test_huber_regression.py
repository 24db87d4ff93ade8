"""Huber regression compared with SciPy's least squares and closed forms."""

import numpy as np
from hypothesis import given, strategies as st
from scipy.optimize import least_squares

from catfree.methods.evidence._huber_regression import WIDTH, huber_regression


def drawn(seed, outliers):
    """Draw rows of two columns with coefficients 2 and -1 and unit noise."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(0, 1, (200, 2))
    target = columns @ [2.0, -1.0] + rng.normal(0, 1, 200)
    target[:outliers] += 20
    return columns, target


@given(st.integers(0, 10**6))
def test_with_a_known_scale_it_minimizes_the_loss(seed):
    columns, target = drawn(seed, outliers=10)
    found, covariance = huber_regression(columns, target, np.full(2, 1e3), scale=1.0)
    expected = least_squares(
        lambda p: target - columns @ p, np.zeros(2), loss="huber", f_scale=WIDTH
    )
    np.testing.assert_allclose(found, expected.x, atol=0.01)
    assert (np.abs(found - [2, -1]) < 5 * np.sqrt(np.diag(covariance))).all()


def test_a_narrow_prior_and_no_rows_give_the_prior():
    columns, target = drawn(0, outliers=0)
    narrow, _ = huber_regression(columns, target, np.array([1e-6, np.inf]), 1.0)
    assert abs(narrow[0]) < 1e-6 < abs(narrow[1])
    found, covariance = huber_regression(np.zeros((3, 2)), np.zeros(3), np.array([2.0, 3.0]), 1.0)
    np.testing.assert_array_equal(found, 0)
    np.testing.assert_allclose(covariance, np.diag([4, 9]))


def test_without_outliers_it_is_ridge_regression():
    columns, target = drawn(1, outliers=0)
    found, _ = huber_regression(columns, target, np.array([0.5, 0.1]), scale=1e3)
    normal = columns.T @ columns + np.diag([4, 100])
    np.testing.assert_allclose(found, np.linalg.solve(normal, columns.T @ target))


def test_an_exact_fit_leaves_nothing():
    columns, _ = drawn(2, outliers=0)
    found, _ = huber_regression(columns, columns @ [3.0, 4.0], np.full(2, np.inf), 1.0)
    np.testing.assert_allclose(found, [3, 4])
