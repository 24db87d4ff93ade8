"""`on_common_clock` and the search for the nearest frame, against brute force."""

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from catfree import Clock, Detections
from catfree.adapters import on_common_clock
from catfree.adapters.video._common_clock import REACH, nearest_frame, rate_of, ticks_of_frames
from catfree.errors import InsufficientDataError, InvalidInputError


@st.composite
def timelines(draw, most=40):
    """Draw increasing times: even, jittered, of varying rate, with dropped frames, with a delay."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    count = draw(st.integers(2, most))
    step = np.full(count, draw(st.sampled_from([0.04, 0.1, 1 / 30])))
    kind = draw(st.sampled_from(["even", "jitter", "varying", "dropped"]))
    if kind == "varying":
        step *= rng.uniform(0.3, 3, count)
    times = draw(st.floats(0, 5)) + np.cumsum(step)
    if kind == "jitter":
        times += rng.uniform(-0.3, 0.3, count) * step
    if kind == "dropped":
        times = times[np.sort(rng.permutation(count)[: max(2, count // 2)])]
    return times


def boxes(frame, camera):
    return Detections(frame, camera, np.tile([0.0, 0, 9, 9], (len(frame), 1)))


@given(timelines(), st.lists(st.floats(-10, 20), min_size=1))
def test_the_nearest_frame_is_that_of_brute_force(times, seconds):
    seconds = np.array(seconds)
    found = nearest_frame(times, seconds)
    away = np.abs(times[None, :] - seconds[:, None])
    np.testing.assert_array_equal(away[np.arange(len(seconds)), found], away.min(1))


def test_half_way_cases_round_up():
    assert nearest_frame(np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.5])).tolist() == [1, 2]
    assert nearest_frame(np.array([3.0]), np.array([0.5, 9.0])).tolist() == [0, 0]


@given(timelines(), st.floats(0.2, 1), st.floats(0, 3))
def test_ticks_are_distinct_near_and_not_wasted(times, slower, early):
    start, rate = times[0] - early, slower * rate_of(times)
    tick = ticks_of_frames(times, start, rate)
    place = (times - start) * rate
    kept = tick >= 0
    assert (np.diff(tick[kept]) > 0).all()  # in order, and no tick twice
    assert (np.abs(place - tick)[kept] <= REACH + 1e-9).all()
    # A tick with a nearest frame is never left empty.
    assert set(np.floor(place + 0.5).astype(int)) <= set(tick[kept])
    # An omitted frame is not the nearest frame of its tick.
    for frame in np.flatnonzero(~kept):
        rival = tick == np.floor(place[frame] + 0.5)
        assert np.abs(place[rival] - tick[rival]).min() <= np.abs(place[frame] - tick[rival]).min()


@given(st.integers(2, 60), st.floats(0, 100), st.sampled_from([5.0, 25.0, 29.97]))
def test_an_even_clock_keeps_its_frame_numbers(count, start, rate):
    times = start + np.arange(count) / rate
    frames = np.arange(count)
    found = on_common_clock(boxes(frames, np.zeros(count, int)), [times])
    np.testing.assert_array_equal(found.frame, frames)
    assert found.clock is not None
    assert found.clock.frame_rate == pytest.approx(rate)
    assert found.clock.start == start
    np.testing.assert_allclose(found.clock.seconds(found.frame), times, rtol=1e-9)


@given(st.integers(1, 40), st.floats(0.05, 0.95), st.integers(0, 2**32))
@example(5, 0.5, 1)  # the blocking frame must move, too
def test_jitter_costs_no_frame_wherever_frames_lie_between_ticks(count, phase, seed):
    jitter = np.random.default_rng(seed).uniform(-0.04, 0.04, count)
    times = (np.arange(count) + phase + jitter) / 25
    assert (ticks_of_frames(times, 0.0, 25.0) >= 0).all()


@given(timelines(), timelines())
def test_equal_frames_are_equal_times(one, two):
    frame = np.concatenate([np.arange(len(one)), np.arange(len(two))])
    camera = np.repeat([0, 1], [len(one), len(two)])
    found = on_common_clock(boxes(frame, camera), [one, two])
    clock = found.clock
    assert clock is not None
    for camera, times in enumerate((one, two)):
        own = found.frame[found.camera == camera]
        away = np.abs(times[:, None] - clock.seconds(own)).min(0)
        assert (away <= (REACH + 1e-6) / clock.frame_rate).all()


def test_a_late_camera_and_a_faster_one():
    slow, fast = 10 + np.arange(5) / 5, 10.4 + np.arange(10) / 10
    found = on_common_clock(boxes([*range(5), *range(10)], [0] * 5 + [1] * 10), [slow, fast])
    assert found.clock == Clock(rate_of(slow), 10.0)
    assert found.frame[found.camera == 0].tolist() == [0, 1, 2, 3, 4]
    assert found.frame[found.camera == 1].tolist() == [2, 3, 4, 5, 6, 7]
    assert found.clock.utc is False


def test_absolute_times_are_utc_and_need_all_cameras():
    now = 1.7e9 + np.arange(3) / 5
    found = on_common_clock(boxes([0, 1, 2], [0, 1, 1]), [now, now + 0.2])
    assert found.clock is not None
    assert found.clock.utc
    with pytest.raises(InvalidInputError, match=r"Camera '1' has absolute .*camera '0' does not"):
        on_common_clock(boxes([0], [0]), [now - 1.7e9, now])
    with pytest.raises(InvalidInputError, match=r"Camera '1' has absolute .*camera '2' does not"):
        on_common_clock(boxes([0], [1]), [[], now, now - 1.7e9])


def test_gaps_and_rounding_leave_the_rate_alone():
    times = np.round(np.delete(np.arange(1000) / 30, slice(200, 400)), 3)
    assert rate_of(times) == pytest.approx(30, rel=1e-5)


@given(st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=30), st.integers(1, 5))
@example([0.1, 0.9], 10)  # pairs of frames: no interval is near the median
def test_any_increasing_times_have_a_rate_whatever_the_order_of_cameras(steps, repeats):
    times = np.cumsum([0.0, *steps * repeats])
    assert 1 / np.max(steps) <= rate_of(times) * (1 + 1e-6)
    assert rate_of(times) <= (1 + 1e-6) / np.min(steps)
    steady = np.arange(50) / 5
    clocks = [
        on_common_clock(boxes([0], [0]), cameras).clock
        for cameras in ([times, steady], [steady, times])
    ]
    assert clocks[0] == clocks[1] == Clock(min(rate_of(times), rate_of(steady)))


@pytest.mark.parametrize(
    ("frame", "timestamps", "rate", "message"),
    [
        ([0], [[0.0, 1, 1]], None, r"timestamps\[0\]\[2\] is 1.000000, not after 1.000000"),
        ([0], [[0.0, np.nan]], None, r"timestamps\[0\]\[1\] is not finite"),
        ([3], [[0.0, 1, 2]], None, r"frame\[0\] is 3, but camera 0 has 3 timestamps"),
        ([-1], [[0.0, 1, 2]], None, r"frame\[0\] is -1"),
        ([0], [[0.0, 1, 2]], 1.5, "frame_rate is 1.5, but camera '0' has only 1 frames"),
        ([0], [[0.0, 1, 2]], -1, "frame_rate is -1; it must be a positive number"),
        ([0], [[[0.0, 1, 2]]], None, r"timestamps\[0\] must have shape"),
    ],
)
def test_what_is_refused(frame, timestamps, rate, message):
    with pytest.raises(InvalidInputError, match=message):
        on_common_clock(boxes(frame, [0]), timestamps, rate)


def test_a_camera_without_timestamps_and_no_rate():
    with pytest.raises(InvalidInputError, match="camera 1 has 0 timestamps"):
        on_common_clock(boxes([0], [1]), [[0.0, 1]])
    with pytest.raises(InsufficientDataError, match="Pass frame_rate"):
        on_common_clock(boxes([0], [0]), [[0.0]])
    assert on_common_clock(boxes([0], [0]), [[0.0]], 5).clock == Clock(5)
