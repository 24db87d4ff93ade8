"""Boxes of standing people: projection, its derivatives, and its inverse on the ground."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.adjustment._resection import MatchedPeople, fit_cameras
from catfree.calibration.people.cameras._camera_model import (
    from_matrices,
    projection,
    rotation,
    to_matrices,
)
from catfree.calibration.people.cameras._ground_map import GroundMap, map_ground
from catfree.calibration.people.matching._placement import (
    FINER,
    LONGEST_ABSENCE,
    Placement,
    _length_of_stay,
    turn,
    vote,
)
from catfree.geometry._person import height_at
from catfree.settings import CalibrationSettings
from tests.calibration.people.boxes_of_rows import boxes_of_rows

SETTINGS = CalibrationSettings()
NEAR_FEET = CalibrationSettings(foot_offset=0.12)


def floats(low, high):
    return st.floats(low, high, allow_nan=False)


cameras = st.tuples(
    floats(6.5, 7.6),  # log focal
    floats(0.05, 0.7),
    floats(-0.2, 0.2),
    floats(-3.1, 3.1),
    floats(-5, 5),
    floats(-5, 5),
    floats(2.0, 6.0),
).map(np.array)


def one_box(camera, xy, height, offset):
    """Return the box (3,) of a person in front of the camera."""
    return boxes_of_rows(camera, xy[None], np.array([height]), float(offset))[0]


def in_front(camera, distance, side):
    """Return the ground point at these distances in front of a camera and to its side."""
    return camera[4:6] + turn(np.array([side, distance]), camera[3])


@given(cameras, floats(6, 15), floats(-2, 2))
def test_matrices_project_like_the_model(camera, distance, side):
    size = np.array([[1920, 1080]])
    K, R, t = to_matrices(camera[None], size)
    point = np.append(in_front(camera, distance, side), 1.7)
    homogeneous = K[0] @ (R[0] @ point + t[0])
    box = one_box(camera, point[:2], 1.7, 0.0)
    assert homogeneous[1] / homogeneous[2] - 539.5 == pytest.approx(box[1], abs=1e-6)
    np.testing.assert_allclose(from_matrices(K, R, t)[0], camera, atol=1e-9)
    np.testing.assert_allclose(rotation(camera) @ rotation(camera).T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R[0]) == pytest.approx(1)


@given(cameras, floats(4, 12), floats(-2, 2))
def test_ground_map_returns_where_a_person_of_usual_height_stands(camera, distance, side):
    xy = in_front(camera, distance, side)
    box = one_box(camera, xy, SETTINGS.person_height, 0.12)
    one = box[None, None], np.array([[4.0]]), np.array([[True]])
    found = map_ground(camera, *one, NEAR_FEET, range_tolerance=0.02)
    assert found.valid.all()
    # The lean of the body axis is corrected to first order.
    assert np.linalg.norm(found.xy[0, 0] - xy) < 0.02 * distance
    assert np.linalg.eigvalsh(found.covariance[0, 0]).min() > 0
    height = height_at(projection(camera), xy[None], box[1:2])
    assert height[0] == pytest.approx(SETTINGS.person_height, abs=1e-9)


def test_hidden_feet_do_not_move_a_person():
    camera = np.array([np.log(1200.0), 0.35, 0.0, 0.0, 0.0, 0.0, 4.0])
    xy = np.array([0.0, 9.0])
    box = one_box(camera, xy, 1.7, 0.12)
    box[2] -= 0.4 * (box[2] - box[1])  # a table in front of the legs
    one = box[None, None], np.array([[6.0]]), np.array([[True]])
    found = map_ground(camera, *one, NEAR_FEET, range_tolerance=0.02)
    assert np.linalg.norm(found.xy[0, 0] - xy) < 0.6
    foot_only = 4.0 / np.tan(0.35 + np.arctan(box[2] / 1200.0)) + 0.12
    assert foot_only - 9.0 > 1.5


def walkers(seed, frames=36, people=10):
    """Simulate people who cross a square of 12 m, each frame with a deviation of a decimeter."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(-6, 6, (2, people, 2))
    share = (np.arange(frames)[:, None] / frames * rng.uniform(1, 3, people)) % 1
    xy = start + share[..., None] * (end - start)
    covariance = np.broadcast_to(0.01 * np.eye(2), (frames, people, 2, 2))
    return GroundMap(
        xy, covariance, np.full(share.shape, 1.7), np.full(share.shape, 0.05), share >= 0
    )


@pytest.mark.slow
@given(floats(0, 6.28), floats(-8, 8), floats(-8, 8), st.integers(0, 5))
def test_voting_finds_a_planted_motion(angle, x, y, seed):
    target = walkers(seed)
    moved = turn(target.xy - np.array([x, y]), -angle)
    source = GroundMap(moved, target.covariance, target.height, target.height_sd, target.valid)
    # A stray placement may have more votes, but the evidence is compared later.
    errors = [
        np.linalg.norm(turn(moved, best.angle) + best.translation - target.xy, axis=-1).mean()
        for _, best in vote(target, source, SETTINGS, 3)
    ]
    assert min(errors) < SETTINGS.voting_cell


@pytest.mark.slow
@given(floats(0, 6.28), floats(-8, 8), floats(-8, 8), st.integers(0, 20))
def test_a_crowd_is_not_taken_for_its_neighbors(angle, x, y, seed):
    people = walkers(seed, people=40)  # less than a meter from one to the next
    source = turn(people.xy - np.array([x, y]), -angle)
    (_, best), *_ = vote(people, replace(people, xy=source), SETTINGS, 3)
    off = np.linalg.norm(turn(source, best.angle) + best.translation - people.xy, axis=-1)
    assert np.median(off) < 2 * SETTINGS.voting_cell / FINER  # votes are blurred over two bins


@given(st.integers(-8, 8), st.integers(-8, 8))
def test_bins_with_equal_votes_are_one_placement(x, y):
    # Two people who stand 3 m apart vote for two placements, each with equal votes in many bins.
    xy = np.tile([[[0.5, 0.5], [3.5, 0.5]]], (9, 1, 1))
    covariance = np.broadcast_to(0.01 * np.eye(2), (9, 2, 2, 2))
    known = np.full((9, 2), 1.7), np.full((9, 2), 0.05), np.arange(18).reshape(9, 2) < 9
    target = GroundMap(xy, covariance, *known)
    found = vote(target, replace(target, xy=xy - np.array([x, y])), SETTINGS, 4)
    places = [(placement.angle, *placement.translation) for _, placement in found]
    apart = np.ptp(np.array(places)[:, None] - places, axis=-1)
    assert len(found) >= 2
    assert apart[~np.eye(len(found), dtype=bool)].min() > 1e-6


visits = st.lists(st.tuples(st.integers(0, 12), st.integers(-2, 1), st.integers(-1, 0)))


@given(visits)
def test_a_stay_ends_when_its_places_are_empty_for_longer_than_an_absence(visits):
    frame = np.array([at for at, *_ in visits], np.int64)
    cells = np.array([[one, 0, other, -1] for _, one, other in visits], float).reshape(-1, 4)
    expected = []
    for first, place in zip(frame, cells, strict=True):
        here = set(frame[(cells == place).all(1)].tolist())
        stay, reached = set(), {int(first)}
        while reached - stay:
            stay |= reached
            reached = {t for t in here if min(abs(t - s) for s in stay) <= LONGEST_ABSENCE}
        expected.append(np.isin(frame[(cells == place).all(1)], list(stay)).sum())
    np.testing.assert_array_equal(_length_of_stay(frame, cells), expected)


@pytest.mark.slow
@given(floats(0, 6.28), floats(-8, 8), floats(-8, 8), st.integers(0, 20))
def test_people_who_stand_still_do_not_outvote_those_who_walk(angle, x, y, seed):
    people, waiting = walkers(seed), 6
    here = np.arange(len(people.xy)) < len(people.xy) // 2

    def with_waiting(xy, place):
        """Simulate people, and others who spend half the time outside the other camera's view."""
        wait = np.broadcast_to(place, (len(xy), waiting, 2))
        covariance = np.repeat(people.covariance[:, :1], xy.shape[1] + waiting, axis=1)
        valid = np.hstack([people.valid, np.repeat(here[:, None], waiting, axis=1)])
        known = np.full(valid.shape, 1.7), np.full(valid.shape, 0.05)
        return GroundMap(np.hstack([xy, wait]), covariance, *known, valid)

    one, other = np.random.default_rng(seed).uniform(-6, 6, (2, waiting, 2))
    source = turn(people.xy - np.array([x, y]), -angle)
    found = vote(with_waiting(people.xy, one), with_waiting(source, other), SETTINGS, 3)
    errors = [
        np.linalg.norm(turn(source, best.angle) + best.translation - people.xy, axis=-1).mean()
        for _, best in found
    ]
    assert min(errors) < 2 * SETTINGS.voting_cell


@given(cameras, floats(0, 6.28), floats(-8, 8), floats(-8, 8))
def test_a_placed_camera_sees_placed_people_the_same(camera, angle, x, y):
    placement = Placement(angle, np.array([x, y]))
    xy = in_front(camera, 9.0, 0.5)
    before = one_box(camera, xy, 1.7, 0.12)
    after = one_box(placement.place(camera), turn(xy, angle) + placement.translation, 1.7, 0.12)
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)


RIG = np.array(
    [
        [np.log(1100.0), 0.35, 0.02, 0.0, 0.0, -9.0, 3.5],
        [np.log(1300.0), 0.40, -0.03, 1.6, 9.0, 0.0, 4.0],
        [np.log(1000.0), 0.30, 0.0, 3.1, 0.0, 9.0, 3.0],
    ]
)


def exact_boxes(seed, count=60):
    """Make people and their exact boxes in three cameras."""
    rng = np.random.default_rng(seed)
    xy, height = rng.uniform(-3, 3, (count, 2)), rng.normal(1.7, 0.05, count)
    person, camera = (a.ravel() for a in np.indices((count, 3)))
    box = boxes_of_rows(RIG[camera], xy[person], height[person], SETTINGS.foot_offset)
    return xy, height, BoxMeasurements(person, camera, box, np.full(box.shape, 1.0))


def test_bundle_adjustment_recovers_a_disturbed_rig():
    xy, _, data = exact_boxes(0)
    rng = np.random.default_rng(1)
    sizes = np.array([0.05, 0.02, 0.02, 0.02, 0.3, 0.3, 0.2])
    start = RIG + sizes * rng.normal(size=RIG.shape)
    found = adjust_people_bundle(
        data,
        start,
        np.column_stack([xy + rng.normal(0, 0.2, xy.shape), np.full(len(xy), 1.7)]),
        weak_prior(data.camera, start, np.full(3, 7.0), SETTINGS),
        SETTINGS,
        focal_spread=np.inf,
        iterations=60,
    )
    np.testing.assert_allclose(np.exp(found.parameters[:, 0] - RIG[:, 0]), 1, atol=0.02)
    np.testing.assert_allclose(found.parameters[:, 6] / RIG[:, 6], 1, atol=0.02)
    between = np.linalg.norm(found.parameters[0, 4:6] - found.parameters[2, 4:6])
    assert between == pytest.approx(18.0, rel=0.02)
    assert found.residual < 0.2
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9


def seen_by(camera, xy, height, data, count):
    """Return the first people of `exact_boxes` in a camera."""
    box = data.box[data.camera == camera][:count]
    people = np.column_stack([xy, height])[:count]
    covariance = np.broadcast_to(1e-6 * np.eye(3), (len(people), 3, 3))
    return MatchedPeople(box, np.ones(len(box)), people, covariance)


@pytest.mark.slow
def test_resection_is_exact_on_exact_people_alone_or_with_other_fits():
    xy, height, data = exact_boxes(2)
    off = np.array([0.03, 0.02, 0.01, -0.03, 0.2, -0.2, 0.1])
    starts = [RIG[1] + sign * off for sign in (1, -1, 0.5, -0.5, 0)]  # more than one padded block
    matches = [seen_by(1, xy, height, data, count) for count in (len(xy), 50, 30, 20, 10)]

    def fit(chosen):
        fitted = [starts[at] for at in chosen]
        for _ in range(5):
            matched = [matches[at] for at in chosen]
            fitted = fit_cameras(list(fitted), matched, SETTINGS, log_focal=float(RIG[1, 0]))
        return fitted

    together = fit(range(5))
    np.testing.assert_allclose(together[0], RIG[1], atol=2e-3)
    for at in range(5):
        np.testing.assert_allclose(fit([at])[0], together[at], atol=1e-6)
    assert fit([]).shape == (0, 7)
