"""Linking of positions: radius, appearance, length; static tracks."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Origin
from catfree.methods.paper.trajectories import (
    Positions,
    drop_short,
    link_positions,
    position_appearance,
)
from catfree.settings import TrajectorySettings

RULES = TrajectorySettings()  # link radius 0.04, appearance weight 1.5


def positions(rows, member=None, track=None) -> Positions:
    """Make positions with rows (frame, x, y); by default each has its own observation."""
    frame = np.array([row[0] for row in rows], int)
    count = len(rows)
    return Positions(
        frame,
        np.array([row[1:3] for row in rows], float).reshape(-1, 2),
        np.arange(count)[:, None] if member is None else np.array(member),
        np.full(count, -1) if track is None else np.array(track),
        np.full(count, int(Origin.DETECTED)),
    )


def link(rows, looks=None, time=None, rules=RULES) -> list[int]:
    frames = int(max(row[0] for row in rows)) + 1
    time = np.arange(frames) if time is None else np.array(time)
    appearance = None if looks is None else np.array(looks, np.float32)
    return link_positions(positions(rows), time, appearance, rules).tolist()


def test_steps_up_to_the_radius_are_linked():
    assert link([(0, 0, 0), (1, 0.03, 0), (2, 0.06, 0)]) == [0, 0, 0]
    assert link([(0, 0, 0), (1, 0.0401, 0)]) == [0, 1]


def test_only_consecutive_time_steps_are_linked():
    assert link([(0, 0, 0), (1, 0, 0)], time=[0, 2]) == [0, 1]
    assert link([(0, 0, 0), (2, 0, 0)]) == [0, 1]


def test_as_many_links_as_possible_then_the_shortest():
    rows = [(0, 0, 0), (0, 0.03, 0), (1, 0.02, 0), (1, 0.05, 0)]
    assert link(rows) == [0, 1, 0, 1]
    # The nearest neighbor would take 0.03 to 0.02 and leave both others alone.
    rows = [(0, 0, 0), (0, 0.03, 0), (1, 0.028, 0), (1, 0.06, 0)]
    assert link(rows) == [0, 1, 0, 1]


def test_appearance_decides_between_neighbours():
    rows = [(0, 0, 0), (0, 0.01, 0), (1, 0.001, 0), (1, 0.009, 0)]
    red, blue = [1.0, 0], [0, 1.0]
    assert link(rows) == [0, 1, 0, 1]
    assert link(rows, [red, blue, blue, red]) == [0, 1, 1, 0]
    off = TrajectorySettings(appearance_in_linking=False)
    assert link(rows, [red, blue, blue, red], rules=off) == [0, 1, 0, 1]
    weak = TrajectorySettings(appearance_weight=0.1)
    assert link(rows, [red, blue, blue, red], rules=weak) == [0, 1, 0, 1]


def test_tracks_are_numbered_by_first_appearance():
    rows = [(0, 0, 0), (1, 0.5, 0), (1, 0, 0), (2, 0.5, 0), (2, 0, 0), (2, 0.9, 0)]
    assert link(rows) == [0, 1, 0, 1, 0, 2]


COORDINATE = st.floats(0, 0.2).map(lambda x: round(x, 3))


@given(
    st.lists(st.tuples(st.integers(0, 3), COORDINATE, COORDINATE), max_size=12).map(sorted),
    st.floats(0.01, 0.1),
)
def test_tracks_visit_a_frame_once_and_take_short_steps(rows, radius):
    rules = TrajectorySettings(link_radius=radius)
    some = positions(rows)
    track = link_positions(some, np.arange(4), None, rules)
    for number in np.unique(track):
        mine = track == number
        assert (np.diff(some.frame_index[mine]) == 1).all()
        step = np.diff(some.ground_xy[mine], axis=0)
        assert (np.hypot(*step.T) <= radius).all()


def test_appearance_of_a_position_is_the_unit_mean_of_its_support():
    appearance = np.array([[1, 0], [0, 1], [1, 0]], np.float32)
    member = np.array([[0, 1], [0, 2], [-1, 1], [-1, -1]])
    half = np.sqrt(0.5)
    wanted = [[half, half], [1, 0], [0, 1], [0, 0]]
    np.testing.assert_allclose(position_appearance(appearance, member), wanted, atol=1e-7)


def test_short_tracks_are_dropped():
    track = np.array([0, 1, 0, 2, 2, 2])
    xy = np.zeros((6, 2))
    for length, wanted in [(1, [1] * 6), (2, [1, 0, 1, 1, 1, 1]), (3, [0, 0, 0, 1, 1, 1])]:
        keep = drop_short(track, xy, TrajectorySettings(minimum_length=length))
        np.testing.assert_array_equal(keep, np.array(wanted, bool))
    assert drop_short(track[:0], xy[:0], RULES).shape == (0,)


def test_short_static_tracks_are_dropped_on_request():
    track = np.repeat([0, 1, 2], [3, 3, 4])
    xy = np.zeros((10, 2))
    xy[3:6, 0] = [0, 0.02, 0.04]  # moves
    rules = TrajectorySettings(remove_short_static=True)  # up to 3 frames within 0.018
    np.testing.assert_array_equal(np.unique(track[drop_short(track, xy, rules)]), [1, 2])
    assert drop_short(track, xy, RULES).all()


@pytest.mark.parametrize("count", [0, 1])
def test_few_positions(count):
    some = positions([(0, 0.0, 0.0)][:count])
    track = link_positions(some, np.arange(1), None, RULES)
    np.testing.assert_array_equal(track, np.zeros(count))
