"""Frames that arrive one by one are assembled into instants."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Detections
from catfree.errors import InvalidInputError
from catfree.methods.online import InstantAssembler

RATE = 10.0


def boxes(count=1):
    """Make `count` boxes of one frame; the assembler sets camera and frame."""
    return Detections(
        np.zeros(count, int), np.zeros(count, int), np.tile([0.0, 0.0, 10.0, 30.0], (count, 1))
    )


arrivals = st.lists(
    st.tuples(st.integers(0, 3), st.floats(0, 3), st.integers(0, 2)), min_size=1, max_size=40
)


@given(arrivals, st.sampled_from([0.0, 0.25, 1.0]))
def test_every_frame_is_in_one_instant_or_dropped_once(frames, timeout):
    assembler = InstantAssembler(4, RATE, timeout)
    instants = [i for camera, t, n in frames for i in assembler.add(camera, t, boxes(n))]
    instants += assembler.finish()
    dropped = [frame for instant in instants for frame in instant.dropped]
    dropped += assembler.take_dropped()
    assert assembler.take_dropped() == ()
    assert sum(len(i.cameras) for i in instants) + len(dropped) == len(frames)
    numbers = [i.number for i in instants]
    assert numbers == sorted(set(numbers))
    times = [i.time for i in instants]
    assert times == sorted(set(times))
    for instant in instants:
        assert instant.cameras == tuple(sorted(set(instant.cameras)))
        assert set(instant.detections.camera) <= set(instant.cameras)
        assert (instant.detections.frame == instant.number).all()
        assert instant.detections.clock is None


@pytest.mark.slow
@given(
    st.floats(0.0, 1.0),
    st.lists(st.permutations(range(3)), min_size=1, max_size=15),
    st.integers(0, 2**31),
)
def test_cameras_in_step_lose_nothing_and_wait_for_nobody(start, orders, seed):
    jitter = np.random.default_rng(seed).uniform(-0.02, 0.02, (len(orders), 3))
    assembler = InstantAssembler(3, RATE)
    for number, order in enumerate(orders):
        frames = [
            assembler.add(c, start + number / RATE + jitter[number, c], boxes(2)) for c in order
        ]
        assert frames[:2] == [(), ()]
        (instant,) = frames[2]
        assert (instant.number, instant.cameras, instant.dropped) == (number, (0, 1, 2), ())
        assert len(instant.detections) == 6
        np.testing.assert_allclose(instant.time, start + number / RATE + jitter[number].mean())
    assert assembler.finish() == ()


def test_a_newer_instant_ends_the_present_one():
    assembler = InstantAssembler(2, RATE)
    assert assembler.add(0, 5.0, boxes()) == ()
    (instant,) = assembler.add(0, 5.1, boxes())
    assert (instant.time, instant.cameras) == (5.0, (0,))
    assert assembler.add(1, 5.02, boxes()) == ()  # too late
    (following,) = assembler.add(1, 5.12, boxes())
    assert following.cameras == (0, 1)
    assert [tuple(frame) for frame in following.dropped] == [(1, 5.02, "late")]


def test_an_instant_waits_until_the_timeout():
    assembler = InstantAssembler(2, RATE, timeout=0.25)
    assert assembler.add(0, 0.0, boxes()) == ()
    assert assembler.add(0, 0.1, boxes()) == ()
    (first,) = assembler.add(1, 0.0, boxes())  # complete now
    assert (first.number, first.cameras) == (0, (0, 1))
    assert assembler.add(0, 0.2, boxes()) == ()
    assert assembler.add(0, 0.3, boxes()) == ()
    (second,) = assembler.add(0, 0.4, boxes())
    assert (second.number, second.cameras) == (1, (0,))
    # Once a newer instant is complete, older ones are returned before it.
    assert [i.number for i in assembler.add(1, 0.4, boxes())] == [2, 3, 4]


def test_times_go_on_while_instants_wait():
    assembler = InstantAssembler(2, 1.0, timeout=5.0)
    frames = [(0, 0.0), (1, 0.0), (0, 1.4), (0, 2.55), (1, 1.4), (1, 2.8)]
    instants = [i for camera, time in frames for i in assembler.add(camera, time, boxes())]
    assert [i.time for i in instants] == pytest.approx([0.0, 1.4, 2.675])


@pytest.mark.parametrize("timeout", [0.0, 1.0])
@pytest.mark.parametrize("at", [0, 10])
def test_one_wrong_time_ends_no_other_instant(at, timeout):
    assembler = InstantAssembler(3, RATE, timeout)
    times = [(c, k / RATE) for k in range(9) for c in range(3)]
    times.insert(at, (0, 3600.0))
    instants = [i for camera, time in times for i in assembler.add(camera, time, boxes())]
    assert [i.cameras for i in instants] == [(0, 1, 2)] * 9
    assert [tuple(f) for i in instants for f in i.dropped] == [(0, 3600.0, "early")]


def test_after_a_pause_the_first_two_cameras_begin_anew():
    assembler = InstantAssembler(3, RATE)
    times = [(c, t) for t in (0.0, 3600.0, 3600.1) for c in range(3)]
    instants = [i for camera, time in times for i in assembler.add(camera, time, boxes())]
    assert [i.time for i in instants] == pytest.approx([0.0, 3600.0, 3600.1])
    assert all(i.cameras == (0, 1, 2) for i in instants)


@pytest.mark.slow
def test_frames_of_clocks_that_were_set_back_are_named_and_not_kept():
    assembler = InstantAssembler(2, RATE)
    for time in (1000.0, 1000.1):
        for camera in (0, 1):
            assembler.add(camera, time, boxes())
    for k in range(3000):
        assert assembler.add(k % 2, k // 2 / RATE, boxes()) == ()
    dropped = assembler.take_dropped()
    assert 0 < len(dropped) <= 1000
    assert {frame.reason for frame in dropped} == {"late"}
    assert dropped[-1].time == 149.9


def test_an_instant_has_the_columns_that_all_its_frames_have():
    assembler = InstantAssembler(3, RATE)
    scored = replace(boxes(2), score=np.array([0.5, 0.6]))
    assembler.add(0, 0.0, scored)
    assembler.add(1, 0.0, replace(boxes(0), score=np.zeros(0)))
    (instant,) = assembler.add(2, 0.0, scored)
    np.testing.assert_array_equal(instant.detections.score, [0.5, 0.6, 0.5, 0.6])
    assembler.add(0, 0.1, scored)
    assembler.add(1, 0.1, boxes(1))
    (instant,) = assembler.add(2, 0.1, scored)
    assert instant.detections.score is None
    assert len(instant.detections) == 5


def test_the_newest_frame_of_an_instant_counts():
    assembler = InstantAssembler(2, RATE)
    assembler.add(0, 0.0, boxes(1))
    assembler.add(0, 0.03, boxes(2))
    assembler.add(0, 0.01, boxes(3))
    (instant,) = assembler.add(1, 0.0, boxes(0))
    assert len(instant.detections) == 2
    assert [tuple(d) for d in instant.dropped] == [(0, 0.0, "replaced"), (0, 0.01, "replaced")]


@pytest.mark.slow
def test_a_slightly_wrong_rate_loses_almost_nothing():
    assembler = InstantAssembler(2, RATE)
    times = np.arange(1100) * 0.1001  # 0.1 % slower: more than an interval in 110 s
    box = boxes()
    instants = [i for t in times for c in (0, 1) for i in assembler.add(c, t + 0.01 * c, box)]
    assert len(instants) == 1100
    assert all(i.cameras == (0, 1) for i in instants)


def test_an_instant_may_show_nobody():
    assembler = InstantAssembler(1, RATE)
    (instant,) = assembler.add(0, 0.0, boxes(0))
    assert (len(instant.detections), instant.cameras) == (0, (0,))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 1.0), "camera_count is 0; it must be 1 or more"),
        ((-1, 1.0), "camera_count is -1; it must be 1 or more"),
        ((2, 0.0), "frame_rate"),
        ((2, 1.0, -1.0), "timeout"),
        ((2, 1.0, np.nan), "timeout"),
    ],
)
def test_impossible_assemblers_are_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        InstantAssembler(*arguments)


def test_impossible_frames_are_refused():
    assembler = InstantAssembler(2, RATE)
    with pytest.raises(InvalidInputError, match="no camera 2"):
        assembler.add(2, 0.0, boxes())
    with pytest.raises(InvalidInputError, match="time of a frame of camera 1 is nan"):
        assembler.add(1, np.nan, boxes())
