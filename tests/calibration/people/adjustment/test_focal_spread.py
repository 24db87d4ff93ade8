"""The spread of focal lengths, against the density of SciPy."""

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from catfree.calibration.people.adjustment._focal_spread import SURE, learn_focal_spread
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
ALIKE = RULES.shared_focal_sd


@pytest.mark.slow
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.1, 0.4]))
def test_cameras_are_of_one_kind_unless_another_spread_is_surely_likelier(seed, spread):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    root = rng.normal(0, 0.01, (count, count))
    errors = root @ root.T
    log_focal = rng.multivariate_normal(np.full(count, 7), errors + spread**2 * np.eye(count))
    found = learn_focal_spread(log_focal, errors, RULES)
    across = scipy.linalg.null_space(np.ones((1, count))).T  # differences between cameras only
    apart = across @ log_focal

    def covariance(spread):
        return across @ (errors + spread**2 * np.eye(count)) @ across.T

    def log_likelihood(spread):
        return scipy.stats.multivariate_normal.logpdf(apart, cov=covariance(spread))

    best = max(map(log_likelihood, np.geomspace(ALIKE, RULES.focal_log_sd, 500)))
    gain = best - log_likelihood(ALIKE)
    if found == ALIKE:
        assert gain < SURE + 0.05
        return
    assert gain > SURE - 0.05
    if count <= 3:
        assert found == np.inf
    elif found < np.inf:
        misfit = apart @ np.linalg.solve(covariance(found), apart)
        assert misfit <= count - 3 + 1e-9
        assert misfit > (count - 3) / 1.3  # too large for the next smaller spread


def test_two_kinds_of_cameras_are_told_from_one_kind():
    errors = 0.01**2 * np.eye(6)
    assert learn_focal_spread(np.full(6, 7.0), errors, RULES) == ALIKE
    two = np.repeat([7.0, 7.3], 3)
    # The sum of squares of six differences of 0.15, divided by C - 3.
    assert learn_focal_spread(two, errors, RULES) == pytest.approx(0.15 * 2**0.5, rel=0.1)


def test_what_nobody_can_know_is_assumed():
    assert learn_focal_spread(np.array([7.0]), np.eye(1), RULES) == ALIKE
    assert learn_focal_spread(np.array([7.0, 7.3, 7.1]), np.eye(3), RULES) == ALIKE
