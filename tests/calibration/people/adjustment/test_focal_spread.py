"""The spread of focal lengths, against the density of SciPy."""

import numpy as np
import pytest
import scipy
from hypothesis import given, strategies as st

from catfree.calibration.people.adjustment._focal_spread import SURE, learn_focal_spread
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
ALIKE = RULES.shared_focal_sd


def of_cameras(errors):
    """Return the covariance of cameras whose log focal lengths alone have errors."""
    covariance = np.zeros((len(errors), 7, len(errors), 7))
    covariance[:, LOG_FOCAL, :, LOG_FOCAL] = errors
    return covariance


@pytest.mark.slow
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.1, 0.4]))
def test_cameras_are_of_one_kind_unless_another_spread_is_surely_likelier(seed, spread):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    root = rng.normal(0, 0.01, (count, count))
    errors = root @ root.T
    log_focal = rng.multivariate_normal(np.full(count, 7), errors + spread**2 * np.eye(count))
    found, _ = learn_focal_spread(log_focal, of_cameras(errors), RULES)
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
    assert learn_focal_spread(np.full(6, 7.0), of_cameras(errors), RULES)[0] == ALIKE
    two = np.repeat([7.0, 7.3], 3)
    # The sum of squares of six differences of 0.15, divided by C - 3.
    found, _ = learn_focal_spread(two, of_cameras(errors), RULES)
    assert found == pytest.approx(0.15 * 2**0.5, rel=0.1)


def test_what_nobody_can_know_is_assumed():
    for log_focal in ([7.0], [7.0, 7.3, 7.1]):
        errors = of_cameras(np.eye(len(log_focal)))
        assert learn_focal_spread(np.array(log_focal), errors, RULES)[0] == ALIKE
    alone = of_cameras(np.eye(1))
    np.testing.assert_array_equal(learn_focal_spread(np.array([7.0]), alone, RULES)[1], alone)


@given(st.integers(0, 10**6), st.integers(2, 6), st.sampled_from([0.0, 0.03, 0.3]))
def test_the_covariance_is_that_of_a_mixture_of_priors(seed, count, spread):
    """Against the posteriors of dense normal distributions."""
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.02, (7 * count, 7 * count + 3))
    joint = root @ root.T
    log_focal = rng.normal(7, np.hypot(spread, 0.03), count)
    chosen, covariance = learn_focal_spread(log_focal, joint.reshape(count, 7, count, 7), RULES)
    at = 7 * np.arange(count) + LOG_FOCAL
    estimate = np.zeros(7 * count)
    estimate[at] = log_focal
    across = scipy.linalg.null_space(np.ones((1, count))).T

    def posterior(spread):
        """Return the mean and covariance with a prior on the differences of focal lengths."""
        prior = np.zeros_like(joint)
        prior[np.ix_(at, at)] = across.T @ across / spread**2
        after = np.linalg.inv(np.linalg.inv(joint) + prior)
        return after @ np.linalg.solve(joint, estimate), after

    spreads = np.geomspace(ALIKE, RULES.focal_log_sd)
    errors = joint[np.ix_(at, at)]
    likelihood = [
        scipy.stats.multivariate_normal.logpdf(
            across @ log_focal, cov=across @ (errors + s**2 * np.eye(count)) @ across.T
        )
        for s in spreads
    ]
    weights = scipy.special.softmax(likelihood)
    center = estimate if chosen == np.inf else posterior(chosen)[0]
    expected = np.zeros_like(joint)
    for weight, one in zip(weights, spreads, strict=True):
        mean, after = posterior(one)
        expected += weight * (after + np.outer(mean - center, mean - center))
    found = covariance.reshape(7 * count, 7 * count)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert np.linalg.eigvalsh(found).min() > 0
