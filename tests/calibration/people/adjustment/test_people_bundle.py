"""Bundle adjustment of people: minimum and covariance equal those of the full, dense problem."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people.adjustment import _people_bundle
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    RigPrior,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, PAN, ROLL, Z
from catfree.geometry._least_squares import CAUCHY
from catfree.settings import CalibrationSettings
from tests.calibration.people.boxes_of_rows import boxes_of_rows

pytestmark = pytest.mark.slow

RULES = CalibrationSettings()
CAMERAS, PEOPLE = 4, 12
PRIOR = np.full(CAMERAS, 7.0)


def drawn(seed, *, known, count=PEOPLE):
    """Simulate boxes of people surrounded by cameras, the true state, and a prior or None.

    The last camera sees no people.
    """
    rng = np.random.default_rng(seed)
    angle = np.arange(CAMERAS) * np.pi / 2
    place = np.stack([9 * np.cos(angle), 9 * np.sin(angle), np.full(CAMERAS, 4.0)], -1)
    parameters = np.column_stack(
        [np.full((CAMERAS, 3), [7.0, 0.4, 0.02]), angle + np.pi / 2, place]
    )
    there = rng.random((count, CAMERAS)) < 0.9
    there[:, :2] = True
    there[:, 3] = False
    person, camera = np.nonzero(there)
    xy, height = rng.uniform(-3, 3, (count, 2)), rng.normal(1.7, 0.05, count)
    box = boxes_of_rows(parameters[camera], xy[person], height[person], RULES.foot_offset)
    sd = rng.uniform(2, 5, box.shape)
    data = BoxMeasurements(person, camera, box + sd * rng.standard_normal(box.shape), sd)
    precision = np.tile([9.0, 99, 50, 30, 4, 4, 4], (CAMERAS, 1))
    prior = RigPrior(parameters + 0.01, precision)
    return data, (parameters, np.column_stack([xy, height])), prior if known else None


def adjusted(data, state, known, *, spread=np.inf, iterations=200):
    known = known or weak_prior(data.camera, state[0], PRIOR, RULES)
    return adjust_people_bundle(
        data, *state, known, RULES, focal_spread=spread, iterations=iterations
    )


def full_problem(data, state, known, spread):
    """Return the weighted residuals of all boxes and priors as a function of the unknowns."""
    cameras, start = state
    used = np.unique(data.camera)
    anchor = np.argmax(np.bincount(data.camera))

    def residuals(change, weights):
        moved = cameras + change[: cameras.size].reshape(-1, 7)
        x, y, tall = (start + change[cameras.size + 1 :].reshape(-1, 3)).T
        offset = RULES.foot_offset + change[cameras.size]
        box = boxes_of_rows(
            moved[data.camera], np.column_stack([x, y])[data.person], tall[data.person], offset
        )
        log_focal = moved[used, LOG_FOCAL]
        rows = [
            ((box - data.box) / data.sd * weights).ravel(),
            (tall - RULES.apparent_height) / RULES.person_height_sd,
        ]
        rows.append((log_focal - log_focal.mean()) / spread)
        if known is None:
            rows += [
                (log_focal - PRIOR[used]) / RULES.focal_log_sd,
                moved[used, ROLL] / RULES.roll_sd,
                (moved - cameras)[anchor, PAN:Z] / _people_bundle.GAUGE_SD,
            ]
        else:
            rows.append(((moved - known.parameters) * np.sqrt(known.precision))[used].ravel())
        return np.concatenate(rows)

    size = cameras.size + 1 + start.size
    raw = residuals(np.zeros(size), 1.0)[: data.box.size].reshape(-1, 3)
    weights = 1 / np.sqrt(1 + (raw / CAUCHY) ** 2)
    steps = 1e-6 * np.eye(size)
    J = np.stack([(residuals(d, weights) - residuals(-d, weights)) / 2e-6 for d in steps], -1)
    return J, residuals(np.zeros(size), weights)


@pytest.mark.parametrize(("spread", "known"), [(np.inf, False), (0.003, False), (np.inf, True)])
@settings(max_examples=3)
@given(seed=st.integers(0, 10**6))
def test_minimum_and_covariance_are_those_of_the_full_problem(seed, spread, known):
    data, start, prior = drawn(seed, known=known)
    found = adjusted(data, start, prior, spread=spread)
    size = 7 * CAMERAS
    assert np.isnan(found.parameters[3]).all()
    state = np.where(np.isnan(found.parameters), start[0], found.parameters), found.people
    J, r = full_problem(data, state, prior, spread)
    free = np.ones(J.shape[1], bool)
    free[21 : size + 1] = False  # the camera without boxes, and the foot offset
    inverse = np.zeros((J.shape[1],) * 2)
    inverse[np.ix_(free, free)] = np.linalg.inv(J[:, free].T @ J[:, free])
    deviation = np.sqrt(np.diag(inverse))
    # The distance to the minimum is small compared with the uncertainty.
    assert np.all(np.abs(inverse @ J.T @ r) <= 0.1 * deviation)
    by_offset = -inverse @ J.T @ J[:, size]
    by_offset[size] = 1
    expected = inverse + RULES.foot_offset_sd**2 * np.outer(by_offset, by_offset)
    kept = slice(0, size + 1)
    scale = np.sqrt(np.diag(expected)[kept]) + 1e-4
    np.testing.assert_allclose(
        found.covariance / np.outer(scale, scale),
        expected[kept, kept] / np.outer(scale, scale),
        atol=1e-2,
    )


@settings(max_examples=5)
@given(st.integers(0, 10**6), st.floats(-1e4, 1e4))
def test_an_edge_of_no_weight_is_absent(seed, error):
    data, state, _ = drawn(seed, known=False)
    silent = np.random.default_rng(seed).random(data.box.shape) < 0.2
    results = [
        adjusted(
            dataclasses.replace(
                data, box=data.box + wrong * silent, sd=np.where(silent, np.inf, data.sd)
            ),
            state,
            None,
            iterations=3,
        )
        for wrong in (0.0, error)
    ]
    np.testing.assert_allclose(results[0].parameters, results[1].parameters, rtol=1e-9)
    np.testing.assert_allclose(results[0].people[:, :2], results[1].people[:, :2], rtol=1e-9)


def test_one_focal_length_is_shared_by_all():
    data, state, _ = drawn(3, known=False)
    spread = [
        np.nanstd(adjusted(data, state, None, spread=least).parameters[:, LOG_FOCAL])
        for least in (RULES.shared_focal_sd, np.inf)
    ]
    assert spread[0] < RULES.shared_focal_sd < spread[1]


def test_a_second_rig_of_like_size_needs_no_compilation():
    adjusted(*drawn(1, known=False))
    before = _people_bundle._solve._cache_size()
    adjusted(*drawn(2, known=True, count=40), spread=0.003, iterations=7)
    assert _people_bundle._solve._cache_size() == before


def test_a_camera_that_no_rig_can_have_is_left_by_no_step():
    data, (cameras, people), _ = drawn(1, known=False)
    far = RigPrior(cameras + 200.0 * np.eye(7)[Z], np.full((CAMERAS, 7), 1e9))
    found = adjusted(data, (cameras, people), far)
    assert np.nanmax(found.parameters[:, Z]) < _people_bundle.CAMERA_HEIGHTS[1]


def test_a_free_lens_is_found_or_ideal():
    data, (cameras, people), _ = drawn(3, known=False, count=150)
    k1 = np.array([-0.2, -0.1, 0.05, 0.0])
    focal = np.exp(cameras[data.camera, LOG_FOCAL])[:, None]
    ends = [np.stack([data.box[:, 0], data.box[:, i]], -1) / focal for i in (1, 2)]
    head, foot = (focal * end * (1 + k1[data.camera] * (end**2).sum(-1))[:, None] for end in ends)
    box = np.stack([(head[:, 0] + foot[:, 0]) / 2, head[:, 1], foot[:, 1]], -1)
    bent = dataclasses.replace(data, box=box)
    state, known = (cameras, people), weak_prior(data.camera, cameras, PRIOR, RULES)
    rules = {"focal_spread": np.inf, "iterations": 200}
    free, ideal = (
        adjust_people_bundle(bent, *state, known, RULES, **rules, k1=start)
        for start in (np.zeros(CAMERAS), None)
    )
    seen = np.arange(CAMERAS) < CAMERAS - 1
    assert (np.abs(free.k1 - k1)[seen] < 3 * free.k1_sd[seen]).all()
    assert (free.k1_sd[seen] < 0.5 * RULES.distortion_sd).all()
    np.testing.assert_array_equal(ideal.k1_sd, 0)
    np.testing.assert_array_equal(ideal.k1, 0)
    assert free.cost <= (1 - RULES.free_lens_gain) * ideal.cost
