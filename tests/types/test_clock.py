"""`Clock`: seconds of frames, and everything with frames keeps its clock."""

import copy
import pickle

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree._run._cache import content_hash, from_arrays, to_arrays
from catfree.calibration import remove_offsets
from catfree.errors import InvalidInputError
from catfree.types import Clock, Detections, Tracks
from catfree.types._archive import save_arrays

CLOCK = Clock(25.0, 1.7e9 + 1 / 3, utc=True)
rates = st.floats(1e-3, 1e4)


def boxes(clock=CLOCK):
    return Detections([3, 5, 9], [0, 1, 0], [[0, 0, 9, 9.0]] * 3, clock=clock)


def tracks(clock=CLOCK):
    return Tracks(
        frame=np.array([3, 5, 9]),
        track_id=np.array([1, 0, 1]),
        position=np.zeros((3, 3)),
        ground_xy=np.zeros((3, 2)),
        sigma=np.ones(3),
        covariance=np.zeros((3, 2, 2)),
        supporting_cameras=np.full(3, 2),
        origin=np.zeros(3, np.int64),
        clock=clock,
    )


@given(rates, st.floats(-1e9, 1e9), st.integers(-(2**31), 2**31))
def test_a_frame_is_the_one_nearest_to_its_own_time(rate, start, frame):
    clock = Clock(rate, start)
    near = int(clock.frame_at(clock.seconds(frame)))
    # Floats far from zero have gaps between them, and time has been rounded three times.
    apart = float(np.spacing(abs(start) + abs(frame) / rate))
    assert abs(near - frame) <= 3 * apart * rate


@given(rates, st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_no_other_frame_is_nearer(rate, start, time):
    clock = Clock(rate, start)
    near = clock.frame_at(time)
    distance = np.abs(clock.seconds(near + np.array([-1, 0, 1])) - time)
    assert distance[1] <= distance[[0, 2]].min() + 1e-9


def test_seconds_are_start_plus_frames_over_rate_in_any_shape():
    frames = np.array([[0, 1], [50, -25]])
    seconds = Clock(25, 10).seconds(frames)
    assert seconds.dtype == np.float64
    np.testing.assert_array_equal(seconds, [[10, 10.04], [12, 9]])
    np.testing.assert_array_equal(Clock(25, 10).frame_at(seconds), frames)
    assert Clock(25, 10).frame_at(seconds).dtype == np.int64
    assert Clock(2).frame_at(0.25) == 1  # half-way cases round up


def test_it_names_its_zero():
    assert Clock(5).describe() == "start of recording"
    assert Clock(5, 0.5, utc=True).describe() == "1970-01-01T00:00:00.500000Z"
    assert Clock(5, 1e300, utc=True).describe() == "1e+300 s after 1970-01-01T00:00:00Z"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0,), "frame_rate is 0; it must be a positive number"),
        ((-5.0,), "frame_rate is -5"),
        ((np.inf,), "frame_rate is inf; it must be a positive number"),
        ((5, np.nan), "start is nan; it must be a finite number"),
        (([5, 5],), r"frame_rate is \[5, 5\]; it must be a positive number"),
        (("fast",), "frame_rate is 'fast'; it must be a positive number"),
        ((5, 0, "yes"), "utc is 'yes'; it must be true or false"),
    ],
)
def test_what_is_not_a_clock(values, message):
    with pytest.raises(InvalidInputError, match=message):
        Clock(*values)


def test_times_too_far_away():
    with pytest.raises(InvalidInputError, match=r"too far from the start.* not milliseconds"):
        Clock(1e6).frame_at([1.0, 1.78e12])
    with pytest.raises(InvalidInputError, match="too far from the start"):
        Clock(30).frame_at([1.0, 1e300])
    with pytest.raises(InvalidInputError, match=r"seconds\[1\] is not finite"):
        Clock(30).frame_at([1.0, np.nan])
    with pytest.raises(InvalidInputError, match="clock must be a Clock or None, got float"):
        boxes(25.0)


def test_it_is_a_plain_value():
    assert Clock(np.float32(25), np.int64(2), utc=np.True_) == Clock(25.0, 2.0, utc=True)
    assert hash(Clock(25)) == hash(Clock(25.0))
    assert pickle.loads(pickle.dumps(CLOCK)) == CLOCK


@pytest.mark.parametrize("make", [boxes, tracks])
@pytest.mark.parametrize("clock", [CLOCK, Clock(29.97), None])
def test_what_has_frames_keeps_its_clock(make, clock, tmp_path):
    one = make(clock)
    one.save(tmp_path / "a.npz")
    same = [
        one[1:],
        one[[]],
        pickle.loads(pickle.dumps(one)),
        copy.deepcopy(one),
        eqx.tree_at(lambda o: o.frame, one, one.frame + 1),
        jax.tree.map(lambda leaf: leaf, one),
        from_arrays(type(one), to_arrays(one)),
        type(one).load(tmp_path / "a.npz"),
    ]
    if isinstance(one, Tracks):
        same.append(one.renumbered())
    else:
        same.append(remove_offsets(one, [1, 0]))
    assert [other.clock for other in same] == [clock] * len(same)


@pytest.mark.parametrize("make", [boxes, tracks])
def test_files_without_a_clock_load(make, tmp_path):
    one = make(None)
    columns = {name: value for name, value in vars(one).items() if name != "clock"}
    save_arrays(tmp_path / "a.npz", type(one).__name__, columns)
    assert type(one).load(tmp_path / "a.npz").clock is None
    save_arrays(tmp_path / "b.npz", type(one).__name__, columns | {"clock": [25.0, 0.0]})
    with pytest.raises(InvalidInputError, match=r"b\.npz: clock is .*not rate, start and kind"):
        type(one).load(tmp_path / "b.npz")
    save_arrays(tmp_path / "c.npz", type(one).__name__, columns | {"clock": [0.0, 0.0, 0.0]})
    with pytest.raises(InvalidInputError, match=r"c\.npz: frame_rate is 0"):
        type(one).load(tmp_path / "c.npz")


def test_tracks_know_their_time():
    assert tracks(None).time is None
    np.testing.assert_array_equal(tracks(Clock(5, 2)).time, [2.6, 3.0, 3.8])
    assert tracks(Clock(5))[[]].time.dtype == np.float64


def test_another_clock_is_another_content():
    assert content_hash(boxes()) != content_hash(boxes(None))
    assert content_hash(boxes()) != content_hash(boxes(Clock(25)))
