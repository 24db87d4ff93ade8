"""Extension of tracks: direction, length, and all stopping rules."""

import numpy as np
import pytest

from catfree import Origin
from catfree.methods.paper.trajectories import Positions, extend_tracks
from catfree.methods.paper.trajectories._extend import appearance_threshold, track_appearance
from catfree.settings import TrajectorySettings

RULES = TrajectorySettings()
RADIUS = 0.018


def tracks(*rows, member=None) -> Positions:
    """Make positions from rows (frame, track, x, y), sorted by frame; observations are rows."""
    frame, track, x, y = np.array(sorted(rows), float).reshape(-1, 4).T
    count = len(frame)
    return Positions(
        frame.astype(int),
        np.column_stack([x, y]),
        np.tile(np.arange(count)[:, None], (1, 2)) if member is None else np.array(member),
        track.astype(int),
        np.full(count, int(Origin.DETECTED)),
    )


def everywhere(frame, xy):
    """Let two cameras support every place, each with the detection numbered like the frame."""
    return np.tile(frame[:, None], (1, 2)), np.ones(len(frame))


def only(*places, weight=1.0):
    """Let two cameras support only these (frame, x, y)."""

    def recount(frame, xy):
        seen = np.zeros(len(frame), bool)
        for f, x, y in places:
            seen |= (frame == f) & (np.hypot(*(xy - [x, y]).T) < 1e-9)
        return np.where(seen[:, None], [[0, 0]], -1), np.where(seen, weight, 0.0)

    return recount


def extend(positions, recount=everywhere, time: int | list[int] = 10, looks=None, rules=RULES):
    steps = np.arange(time) if isinstance(time, int) else np.array(time)
    appearance = None if looks is None else np.array(looks, np.float32)
    return extend_tracks(positions, steps, appearance, recount, rules, occupied_radius=RADIUS)


def added(positions) -> list[tuple]:
    new = positions.origin == Origin.EXTENDED
    rows = zip(positions.frame_index, positions.track, positions.ground_xy, strict=True)
    return [
        (int(f), int(t), *np.round(xy, 9).tolist())
        for (f, t, xy), is_new in zip(rows, new, strict=True)
        if is_new
    ]


@pytest.mark.slow
def test_both_ends_are_continued_by_two_frames():
    longer, threshold = extend(tracks((4, 0, 0.1, 0), (5, 0, 0.13, 0.01)))
    assert threshold is None
    assert added(longer) == [
        (2, 0, 0.04, -0.02),
        (3, 0, 0.07, -0.01),
        (6, 0, 0.16, 0.02),
        (7, 0, 0.19, 0.03),
    ]
    assert (np.diff(longer.frame_index) > 0).all()


@pytest.mark.slow
def test_nothing_lies_beyond_the_sequence():
    longer, _ = extend(tracks((0, 0, 0.1, 0), (1, 0, 0.13, 0)), time=3)
    assert [row[0] for row in added(longer)] == [2]


@pytest.mark.slow
def test_the_velocity_is_the_mean_of_the_last_three_steps():
    xs = [0.5, 0.0, 0.01, 0.03, 0.06]
    longer, _ = extend(tracks(*[(f, 0, x, 0) for f, x in enumerate(xs)]))
    assert added(longer) == [(5, 0, 0.08, 0), (6, 0, 0.1, 0)]
    longer, _ = extend(
        tracks(*[(f, 0, x, 0) for f, x in enumerate(xs)]),
        rules=TrajectorySettings(velocity_steps=1),
    )
    assert added(longer) == [(5, 0, 0.09, 0), (6, 0, 0.12, 0)]


@pytest.mark.slow
def test_the_velocity_is_by_time_not_by_frame_number():
    longer, _ = extend(tracks((1, 0, 0, 0), (2, 0, 0.04, 0)), time=[0, 3, 5, 6, 8])
    assert added(longer) == [(3, 0, 0.06, 0)]  # time step 6; step 7 is not a frame, so it stops


def test_the_first_failure_stops():
    start = tracks((0, 0, 0, 0), (1, 0, 0.03, 0))
    longer, _ = extend(start, only((3, 0.09, 0)))
    assert added(longer) == []
    longer, _ = extend(start, only((2, 0.06, 0)))
    assert added(longer) == [(2, 0, 0.06, 0)]


def test_two_cameras_must_see_it():
    def one_camera(frame, xy):
        return np.tile([[0, -1]], (len(frame), 1)), np.ones(len(frame))

    start = tracks((0, 0, 0, 0), (1, 0, 0.03, 0))
    assert added(extend(start, one_camera)[0]) == []
    rules = TrajectorySettings(extension_cameras=1)
    assert len(added(extend(start, one_camera, rules=rules)[0])) == 2


def test_the_place_of_another_track_is_taken():
    rows = [(0, 0, 0, 0), (1, 0, 0.03, 0)]
    for distance, wanted in [(0.017, 0), (0.019, 1)]:
        other = [(2, 1, 0.06, distance), (3, 1, 0.06, 0.5), (4, 1, 0.06, 0.9)]
        longer, _ = extend(tracks(*rows, *other))
        assert sum(row[1] == 0 for row in added(longer) if row[0] == 2) == wanted


def test_the_better_supported_of_two_meeting_tracks_has_the_place():
    start = tracks((0, 0, 0, 0), (1, 0, 0.02, 0), (0, 1, 0.08, 0), (1, 1, 0.06, 0))

    def recount(frame, xy):
        support = np.where(xy[:, 0] > 0.0401, 2.0, 1.0)
        return np.zeros((len(frame), 2), int), support

    # Both predict x = 0.04; the one from the right goes slightly beyond, and has more support.
    start.ground_xy[start.track == 1] += [0.001, 0]
    longer, _ = extend(start, recount)
    assert [row[1] for row in added(longer) if row[0] == 2] == [1]


@pytest.mark.slow
def test_a_supporting_detection_must_look_like_the_track():
    rows = [(f, t, 0.02 * f, 0.5 * t) for f in range(4) for t in range(2)]
    member = [[t, t] for _ in range(4) for t in range(2)]
    red, blue, grey = [1.0, 0], [0, 1.0], [0.75, 0.66]
    start = tracks(*rows, member=member)

    def seen_as(detection):
        return lambda frame, xy: (np.full((len(frame), 2), detection), np.ones(len(frame)))

    looks = [red, blue, grey]
    for detection, wanted in [(0, {0}), (1, {1})]:
        longer, threshold = extend(start, seen_as(detection), looks=looks)
        assert threshold is not None
        assert 0 < threshold < 1
        assert {row[1] for row in added(longer)} == wanted
    rules = TrajectorySettings(appearance_in_extension=False)
    longer, threshold = extend(start, seen_as(0), looks=looks, rules=rules)
    assert threshold is None
    assert {row[1] for row in added(longer)} == {0, 1}


@pytest.mark.slow
def test_one_of_several_supporting_detections_is_enough():
    rows = [(f, t, 0.02 * f, 0.5 * t) for f in range(4) for t in range(2)]
    member = [[t, t] for _ in range(4) for t in range(2)]

    def mixed(frame, xy):
        return np.tile([[0, 1]], (len(frame), 1)), np.ones(len(frame))

    longer, _ = extend(tracks(*rows, member=member), mixed, looks=[[1.0, 0], [0, 1.0]])
    assert {row[1] for row in added(longer)} == {0, 1}


@pytest.mark.slow
def test_the_appearance_threshold_lies_between_own_and_other():
    rows = [(f, t, 0.1 * t, 0) for f in range(3) for t in range(2)]
    member = [[2 * f + t, -1] for f in range(3) for t in range(2)]
    looks = np.array([[1, 0.1], [0.1, 1], [1, 0.2], [0.2, 1], [1, 0], [0, 1]], np.float32)
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    start = tracks(*rows, member=member)
    tracks_look = track_appearance(start, looks)
    own, other = [], []
    for (row, _), track in zip(start.member, start.track, strict=True):
        for number, look in enumerate(tracks_look):
            (own if number == track else other).append(1 - float(looks[row] @ look))
    threshold = appearance_threshold(tracks_look, start, looks)
    assert max(own) < threshold < min(other)


@pytest.mark.parametrize("frames", [0, 1, 3])
def test_no_more_than_the_allowed_frames(frames):
    rules = TrajectorySettings(extension_frames=frames)
    longer, _ = extend(tracks((4, 0, 0, 0), (5, 0, 0.01, 0)), rules=rules)
    assert len(added(longer)) == 2 * frames


def test_a_single_position_has_no_velocity():
    longer, _ = extend(tracks((4, 0, 0, 0)))
    assert added(longer) == []


def test_no_tracks_stay_no_tracks():
    longer, threshold = extend(tracks(), looks=np.zeros((0, 2)))
    assert len(longer.track) == 0
    assert threshold is None
