"""Changes over time, on costs with a known truth."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.calibration.watching._agreement import Window
from catfree.calibration.watching._changes import fit_course, lost_since
from catfree.calibration.watching._sights import LAG, LAGS, TURN

CAMERAS, WINDOWS = 3, 20


def windows(errors, seed=0, *, noise=1.0, groups=4):
    """Make windows of `groups` people each, which measure errors (W, 8C) with known noise."""
    rng = np.random.default_rng(seed)
    p = errors.shape[1]
    sd = np.tile([0.002, 0.002, 0.002, 0.2, 0.1, 0.1, 0.1, 0.02], p // 8)
    result = []
    for w, error in enumerate(errors):
        matrix, vector = [], []
        for _ in range(groups):
            draw = rng.normal(size=(p + 4, p)) / sd / np.sqrt(p)
            information = draw.T @ draw
            off = (
                np.sqrt(noise) * np.linalg.cholesky(np.linalg.inv(information)) @ rng.normal(size=p)
            )
            matrix.append(information)
            vector.append(information @ (error + off))
        told = np.array(matrix), np.array(vector)
        blank = np.zeros((4, p // 8), np.int64)
        result.append(Window(10 * w, 10 * w + 10, *told, blank, error.reshape(-1, 8)))
    return result


@pytest.mark.slow
def test_nothing_changes_where_nothing_changed():
    alarms = 0
    for seed in range(40):
        course = fit_course(windows(np.zeros((WINDOWS, 8 * CAMERAS)), seed, noise=3.0), 1e-3)
        alarms += len(course.changes)
    # 40 recordings, 19 windows, 3 cameras, 2 kinds, each with a chance of 1e-3: 4.6 expected.
    assert alarms <= 11


@pytest.mark.parametrize(("camera", "kind", "size"), [(1, TURN, 0.01), (2, LAG, 1.5)])
def test_a_change_is_found_in_its_camera_at_its_window(camera, kind, size):
    errors = np.zeros((WINDOWS, 8 * CAMERAS))
    column = 8 * camera + (1 if kind is TURN else 3)
    errors[12:, column] = size
    course = fit_course(windows(errors, 5), 1e-5)
    assert len(course.changes) == 1
    change = course.changes[0]
    assert (change.camera, change.kind) == (camera, kind)
    assert change.window == 12
    value, covariance = course.of_changes([0])
    at = 1 if kind is TURN else 0
    assert abs(value[at] - size) < 3 * np.sqrt(covariance[at, at])


def test_changes_of_one_camera_add_up():
    errors = np.zeros((WINDOWS, 8 * CAMERAS))
    errors[7:, 8] = 0.02
    errors[14:, 8] += 0.01
    course = fit_course(windows(errors, 3), 1e-5)
    assert [(c.camera, c.kind) for c in course.changes] == [(1, TURN)] * 2
    total, covariance = course.of_changes([0, 1])
    each = [course.of_changes([i])[0] for i in (0, 1)]
    np.testing.assert_allclose(total, np.sum(each, axis=0), rtol=1e-12)
    assert abs(total[0] - 0.03) < 3 * np.sqrt(covariance[0, 0])
    last, none = (course.at(WINDOWS - 1, changed)[0].reshape(CAMERAS, 8) for changed in (None, 0))
    np.testing.assert_allclose((last - none)[1, :3], total, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose((last - none)[[0, 2]], 0, atol=1e-12)


def test_a_clock_that_jumps_is_told_from_those_that_do_not():
    """Also if it is the median camera after its jump, or the reference of the lags."""
    errors = np.zeros((WINDOWS, 8 * CAMERAS))
    errors[:, 3], errors[:9, 8 + 3], errors[:, 16 + 3] = -1.0, -8.0, 1.0
    course = fit_course(windows(errors, 3), 1e-5)
    assert [(c.camera, c.kind, c.window) for c in course.changes] == [(1, LAG, 9)]
    assert course.reference != 1
    for reference, before in ((1, [7.0, 0.0, 9.0]), (2, [-2.0, -9.0, 0.0])):
        course = replace(course, reference=reference)
        for window, jump in ((8, 0.0), (9, 8.0)):
            lag = course.at(window)[0][LAGS]
            np.testing.assert_allclose(lag, before + jump * np.eye(CAMERAS)[1], atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [2.0, 6.0])
def test_people_tell_the_noise(noise):
    errors = np.zeros((WINDOWS, 8 * CAMERAS))
    courses = [fit_course(windows(errors, seed, noise=noise), 0.0) for seed in range(5)]
    assert np.mean([course.noise for course in courses]) == pytest.approx(noise, rel=0.15)


@pytest.mark.slow
def test_rates_are_within_their_deviations():
    within, total = 0, 0
    time = 10 * np.arange(WINDOWS) + 5
    for seed in range(10):
        errors = np.zeros((WINDOWS, 8 * CAMERAS))
        errors[:, 8 + 3] = 0.02 * (time - time.mean()) + 1.0
        course = fit_course(windows(errors, seed), 1e-6, kinds=[LAG])
        assert course.changes == ()
        rate, covariance = course.rates()
        value, of_value = course.constant()
        true = np.array([0.0, 0.02, 0.0]) - [0.0, 0.02, 0.0][course.reference]
        offset = np.array([0.0, 1.0, 0.0]) - [0.0, 1.0, 0.0][course.reference]
        others = np.arange(CAMERAS) != course.reference
        within += (np.abs(rate - true) < 2 * np.sqrt(covariance.diagonal()))[others].sum()
        within += (np.abs(value[3::8] - offset) < 2 * np.sqrt(of_value.diagonal()[3::8]))[
            others
        ].sum()
        total += 2 * others.sum()
    assert within >= 0.85 * total


def test_a_camera_is_lost_when_nobody_is_matched_any_more():
    expected, seen = np.full(10, 40), np.full(10, 5)
    matched = np.array([35, 33, 36, 38, 36, 34, 0, 1, 0, 0])
    assert lost_since(matched, expected, seen, 0.9, 1e-6) == 6
    assert lost_since(matched[:6], expected[:6], seen[:6], 0.9, 1e-6) is None
    # One window with one person is not enough.
    few = np.append(matched[:6], 0)
    assert lost_since(few, expected[:7], np.full(7, 1), 0.5, 1e-6) is None
