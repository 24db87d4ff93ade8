"""The spread of focal lengths, by the densities and integrals of SciPy."""

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from catfree.calibration.people.adjustment._focal_spread import learn_focal_spread
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
NARROW, WIDE = RULES.shared_focal_sd, RULES.focal_log_sd


@pytest.mark.slow
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.1, 0.4]))
def test_the_spread_is_the_mean_over_all_spreads_that_may_be(seed, spread):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    root = rng.normal(0, 0.01, (count, count))
    errors = root @ root.T
    log_focal = rng.multivariate_normal(np.full(count, 7), errors + spread**2 * np.eye(count))
    across = scipy.linalg.null_space(np.ones((1, count))).T  # differences between cameras only
    apart = across @ log_focal

    def likelihood(log_spread):
        covariance = across @ (errors + np.exp(2 * log_spread) * np.eye(count)) @ across.T
        return scipy.stats.multivariate_normal.pdf(apart, cov=covariance)

    log_spread = np.linspace(np.log(NARROW), np.log(WIDE), 4001)
    density = np.array([likelihood(one) for one in log_spread])
    any_kind, mean = (
        scipy.integrate.simpson(values, log_spread) / np.log(WIDE / NARROW)
        for values in (density, density * np.exp(log_spread))
    )
    one_kind = likelihood(np.log(NARROW))
    found = learn_focal_spread(log_focal, errors, RULES)
    assert found == pytest.approx((one_kind * NARROW + mean) / (one_kind + any_kind), rel=0.05)


def test_two_kinds_of_cameras_are_told_from_one_kind():
    errors = 0.01**2 * np.eye(6)
    assert learn_focal_spread(np.full(6, 7.0), errors, RULES) < 0.01
    two = np.repeat([7.0, 7.3], 3)
    assert learn_focal_spread(two, errors, RULES) == pytest.approx(0.15, rel=0.3)


def test_nothing_is_learned_from_one_camera_or_from_errors_larger_than_any_spread():
    usual = (NARROW + (WIDE - NARROW) / np.log(WIDE / NARROW)) / 2  # of one kind, or of any
    assert learn_focal_spread(np.array([7.0]), np.eye(1), RULES) == pytest.approx(usual, rel=0.05)
    found = learn_focal_spread(np.array([7.0, 7.3, 7.1]), 100 * np.eye(3), RULES)
    assert found == pytest.approx(usual, rel=0.05)
