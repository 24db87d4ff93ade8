"""Windows of simulated recordings, and unknown errors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.watching._agreement import _Equations, solve_window
from catfree.calibration.watching._matching import best, corrected_place, match_boxes
from catfree.calibration.watching._sights import PARAMETERS, TURN, sights
from catfree.geometry import Similarity, transform_scene
from catfree.methods import localize
from catfree.settings import Settings
from catfree.synthetic import make_world
from catfree.types import Detections

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def seen():
    world = make_world("ring4", 3, frames=20, people=6)
    localization = localize(world.detections, world.true_scene)
    return sights(world.true_scene, world.detections, localization, Settings())


def error_of(turn=(0.0, 0.0, 0.0), lag=0.0, center=(0.0, 0.0, 0.0), zoom=0.0):
    return np.array([*turn, lag, *center, zoom])


def test_errors_stay_where_nobody_tells_of_them(seen):
    start = np.arange(4)[:, None] * error_of((0.1, -0.2, 0.3), 5.0)
    window = solve_window(seen, 7, 7, start)
    np.testing.assert_allclose(window.errors, start, atol=1e-12)
    assert window.matrix.shape == (0, 4 * PARAMETERS, 4 * PARAMETERS)
    assert not window.counts.any()


def test_a_window_tells_of_a_turn_that_it_starts_without(seen):
    turn = np.deg2rad([0.3, 0.8, 0.0])
    wrong = np.zeros((4, PARAMETERS))
    wrong[1, TURN] = turn
    found = solve_window(seen, 0, 20, wrong).errors
    off = [np.linalg.norm(one[TURN] - found[0, TURN]) for one in found]
    assert max(off) < 0.5 * np.linalg.norm(turn)


def test_the_unit_of_length_does_not_matter(seen):
    larger = transform_scene(Similarity(1e5, np.eye(3), np.zeros(3)), seen.scene, metric=False)
    localization = localize(seen.detections, larger)
    scaled = sights(larger, seen.detections, localization, Settings())
    one, other = (solve_window(s, 0, 20, np.zeros((4, PARAMETERS))) for s in (seen, scaled))
    np.testing.assert_allclose(other.errors, one.errors, atol=1e-6)
    np.testing.assert_allclose(other.matrix, one.matrix, rtol=1e-3, atol=1e-4 * one.matrix.max())


@given(st.integers(0, 5), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_what_some_people_say_is_the_elimination_of_their_places(people, cameras, seed):
    rng = np.random.default_rng(seed)
    slope = rng.normal(size=(people, cameras, 3, PARAMETERS + 3))
    residual = rng.normal(size=(people, cameras, 3))
    precision = rng.uniform(0.5, 2, residual.shape)
    held, pull = rng.uniform(1, 2, people), rng.normal(size=people)
    rows = np.flatnonzero(rng.random(people) < 0.7)
    matrix, vector = _Equations.of(slope, residual, precision, held, pull).sums(rows)

    # All unknowns in one dense system: the errors of all cameras, then the place of each person.
    errors = PARAMETERS * cameras
    full, right = (np.zeros((errors + 3 * people,) * k) for k in (2, 1))
    full[range(errors, len(full)), range(errors, len(full))] = 1e-9
    for m in rows:
        place = errors + 3 * m + np.arange(3)
        full[place[2], place[2]] += held[m]
        right[place[2]] += pull[m]
        for camera in range(cameras):
            at = np.append(PARAMETERS * camera + np.arange(PARAMETERS), place)
            weighted = slope[m, camera] * precision[m, camera][:, None]
            full[np.ix_(at, at)] += weighted.T @ slope[m, camera]
            right[at] += weighted.T @ residual[m, camera]
    block, mixed = full[errors:, errors:], full[errors:, :errors]
    eliminated = np.linalg.solve(block, np.column_stack([mixed, right[errors:]]))
    scale = 1 + np.abs(full).max(initial=0)
    close = {"rtol": 1e-6, "atol": 1e-9 * scale}
    np.testing.assert_allclose(
        matrix, full[:errors, :errors] - mixed.T @ eliminated[:, :-1], **close
    )
    np.testing.assert_allclose(vector, right[:errors] - mixed.T @ eliminated[:, -1], **close)


def test_the_center_and_the_zoom_of_a_camera_move_its_map(seen):
    point = np.array([1.0, -0.5, 0.4, 1.0])
    center = np.array([0.2, -0.1, 0.3])
    error = error_of(center=center, zoom=0.05)
    moved = point - [*(seen.unit * center), 0.0]
    expected = (seen.place[1] @ moved) * [1.0, 1.0, np.exp(-0.05)]
    (found,) = corrected_place(seen, np.array([1]), error[None])
    np.testing.assert_allclose(found @ point, expected, rtol=1e-12)


def test_nobody_is_expected_outside_the_recording(seen):
    person = np.arange(len(seen.people.frame))
    for lag in (0.0, 15.0, -15.0, 40.0):
        error = error_of(lag=lag)[None]
        (found,) = match_boxes(seen, person, seen.people.state, np.array([1]), error)
        shown = seen.people.frame[found.expected] + lag
        assert ((shown >= 0) & (shown < seen.steps)).all()
        assert found.score <= len(found.expected)


def test_a_camera_that_began_later_is_not_late():
    world = make_world("ring4", 3, frames=20, people=6)
    still = world.detections[world.detections.frame == 5]
    boxes = Detections.concatenate([replace(still, frame=still.frame - 5 + k) for k in range(20)])
    boxes = boxes[(boxes.camera != 1) | (boxes.frame >= 8)]
    recording = sights(world.true_scene, boxes, localize(boxes, world.true_scene), Settings())
    others = recording.people.seen_by_others(1, recording.people.between(0, 10))
    right, late = error_of(), error_of(lag=7.0)
    np.testing.assert_array_equal(best(recording, 1, others, right, late[None]), right)


def test_cameras_matched_together_match_as_alone(seen):
    person = np.arange(0, len(seen.people.frame), 3)
    state = seen.people.state[person]
    camera = np.array([2, 0, 2])
    error = np.array([error_of((0.0, 0.05, 0.0), 2.3), error_of(), error_of(lag=-1.0)])
    together = match_boxes(seen, person, state, camera, error)
    assert any(len(found.person) for found in together)
    for at, found in enumerate(together):
        (alone,) = match_boxes(seen, person, state, camera[at : at + 1], error[at : at + 1])
        for one, other in zip(found, alone, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9)
    assert match_boxes(seen, person, state, camera[:0], error[:0]) == []
