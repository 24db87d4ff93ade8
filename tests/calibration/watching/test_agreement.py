"""Windows of simulated recordings, and errors that nobody tells of."""

import numpy as np
import pytest

from catfree.calibration.watching._agreement import PARAMETERS, solve_window
from catfree.calibration.watching._matching import Correction, corrected_place, match
from catfree.calibration.watching._sights import sights
from catfree.methods import localize
from catfree.synthetic import make_world

NOISE = np.array([0.05, 0.04, 0.05])


@pytest.fixture(scope="module")
def seen():
    world = make_world("ring4", 3, frames=20, people=6)
    tracks = localize(world.detections, world.true_scene).tracks
    return sights(world.true_scene, world.detections, tracks)


def test_errors_stay_where_nobody_tells_of_them(seen):
    start = [Correction(np.array([0.1, -0.2, 0.3]) * c, 5.0 * c) for c in range(4)]
    window, found = solve_window(seen, 7, 7, start, NOISE)
    for one, other in zip(found, start, strict=True):
        np.testing.assert_allclose(one.turn, other.turn, atol=1e-12)
        assert one.lag == pytest.approx(other.lag)
    assert window.matrix.shape == (0, 4 * PARAMETERS, 4 * PARAMETERS)
    assert not window.boxes.any()


def test_a_window_tells_of_a_turn_that_it_starts_without(seen):
    turn = np.deg2rad([0.3, 0.8, 0.0])
    wrong = Correction(turn, 0.0)
    still = [Correction(np.zeros(3), 0.0)] * 4
    _, found = solve_window(seen, 0, 20, [still[0], wrong, *still[2:]], NOISE)
    off = [np.linalg.norm(one.turn - found[0].turn) for one in found]
    assert max(off) < 0.5 * np.linalg.norm(turn)


def test_the_center_and_the_zoom_of_a_camera_move_its_map(seen):
    point = np.array([1.0, -0.5, 0.4, 1.0])
    at = Correction(np.zeros(3), 0.0, np.array([0.2, -0.1, 0.3]), 0.05)
    moved = point - [*(seen.unit * at.center), 0.0]
    expected = (seen.place[1] @ moved) * [1.0, 1.0, np.exp(-0.05)]
    np.testing.assert_allclose(corrected_place(seen, 1, at) @ point, expected, rtol=1e-12)


def test_nobody_is_expected_outside_the_recording(seen):
    person = np.arange(len(seen.people.frame))
    for lag in (0.0, 15.0, -15.0, 40.0):
        found = match(seen, 1, person, seen.people.state, Correction(np.zeros(3), lag))
        shown = seen.people.frame[found.expected] + lag
        assert ((shown >= 0) & (shown < seen.steps)).all()
        assert found.share <= 1
