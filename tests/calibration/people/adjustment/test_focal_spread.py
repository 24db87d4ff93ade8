"""The spread of focal lengths is the likeliest one, by the density of SciPy."""

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from catfree.calibration.people.adjustment._focal_spread import learn_focal_spread
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
ALIKE = RULES.shared_focal_sd


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.1, 0.4]))
def test_it_is_the_likeliest_if_that_pays(seed, spread):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    root = rng.normal(0, 0.01, (count, count))
    errors = root @ root.T
    log_focal = rng.multivariate_normal(np.full(count, 7), errors + spread**2 * np.eye(count))
    found = learn_focal_spread(log_focal, errors, RULES)
    across = scipy.linalg.null_space(np.ones((1, count))).T  # differences between cameras only

    def log_likelihood(spread):
        covariance = across @ (errors + spread**2 * np.eye(count)) @ across.T
        return scipy.stats.multivariate_normal.logpdf(across @ log_focal, cov=covariance)

    best = max(map(log_likelihood, np.geomspace(ALIKE, RULES.focal_log_sd, 500)))
    if found == ALIKE:
        assert best - log_likelihood(ALIKE) < 1.05
    else:
        assert log_likelihood(found) - log_likelihood(ALIKE) > 1
        assert best - log_likelihood(found) < 0.05


def test_two_kinds_of_cameras_are_told_from_one_kind():
    errors = 0.01**2 * np.eye(6)
    assert learn_focal_spread(np.full(6, 7.0), errors, RULES) == ALIKE
    two = np.repeat([7.0, 7.3], 3)
    assert learn_focal_spread(two, errors, RULES) == pytest.approx(0.15, rel=0.2)


def test_what_nobody_can_know_is_assumed():
    assert learn_focal_spread(np.array([7.0]), np.eye(1), RULES) == ALIKE
    assert learn_focal_spread(np.array([7.0, 7.3, 7.1]), np.eye(3), RULES) == ALIKE
