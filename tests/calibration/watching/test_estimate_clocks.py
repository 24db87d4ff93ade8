"""Clocks of simulated cameras with known offsets, rates and jumps."""

import numpy as np
import pytest

from catfree.calibration import ClockJump, Clocks, estimate_clocks
from catfree.synthetic import make_world
from catfree.types import Detections
from tests.calibration.watching.bumped import on_clock, renumber

FRAMES = 150


@pytest.fixture(scope="module")
def world():
    return make_world("ring5", seed=4, frames=FRAMES, people=6)


@pytest.mark.slow
def test_right_clocks_are_found_right(world):
    clocks = estimate_clocks(world.true_scene, on_clock(world.detections, 5.0))
    assert clocks.jumps == ()
    assert np.abs(clocks.offset).max() < 0.2
    assert (np.abs(clocks.rate) <= 3 * clocks.rate_sd + 1e-9).all()


@pytest.mark.slow
def test_offset_rate_and_jump(world):
    boxes = on_clock(world.detections, 5.0)
    boxes = renumber(boxes, 1, lambda frame: 12.0 + 0 * frame)
    boxes = renumber(boxes, 2, lambda frame: 0.01 * (frame - 75.0))
    boxes = renumber(boxes, 3, lambda frame: 3.0 * (frame >= 90))
    clocks = estimate_clocks(world.true_scene, boxes)
    zero = clocks.offset[clocks.reference]
    assert zero == 0
    base = 0.5 * (clocks.offset[0] + clocks.offset[4])
    assert abs(clocks.offset[1] - base - 12) < 0.2
    assert abs(clocks.rate[2] - clocks.rate[0] - 0.01) < 0.004
    assert [jump.camera for jump in clocks.jumps] == [3]
    assert abs(clocks.jumps[0].frames - 3) < 0.4
    assert abs(clocks.jumps[0].frame - 90) <= 3
    right = clocks.correct(boxes)
    again = estimate_clocks(world.true_scene, right)
    assert np.abs(again.offset).max() < 0.5
    assert again.jumps == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_three_people_tell_of_a_camera_that_is_late_by_many_frames(seed):
    world = make_world("ring5", seed, frames=300, people=3)
    boxes = renumber(on_clock(world.detections, 5.0), 1, lambda frame: 20.0 + 0 * frame)
    boxes = boxes[boxes.frame < 300]
    clocks = estimate_clocks(world.true_scene, boxes)
    assert clocks.jumps == ()
    expected = np.array([0.0, 20.0, 0.0, 0.0, 0.0])
    expected -= expected[clocks.reference]
    assert np.abs(clocks.offset - expected).max() < 0.4
    assert (np.abs(clocks.offset - expected) <= 4 * clocks.offset_sd + 1e-9).all()


def test_a_lag_is_corrected_if_it_is_certainly_more_than_half_a_step():
    offset = np.array([0.0, 7.4, -13.0, 40.0, np.nan, 2.8, -3.0])
    offset_sd = np.array([0.1, 0.1, 0.1, 10.0, np.nan, 0.1, 0.1])
    rate = np.zeros(7)
    clocks = Clocks(offset, offset_sd, rate, rate, (), 0.0, 0)
    np.testing.assert_array_equal(clocks.whole_offsets(5), [0, 5, -15, 0, 0, 0, -5])
    # A jump takes effect at its frame.
    jumps = tuple(ClockJump(1, frame, 1.0, 20.0, 0.5) for frame in (99, 101))
    jumped = Clocks(offset, offset_sd, rate, rate, jumps, 100.0, 0)
    np.testing.assert_array_equal(jumped.whole_offsets(5), [0, 25, -15, 0, 0, 0, -5])
    unsure = (ClockJump(1, 99, 1.0, 20.0, 7.0),)
    unsure = Clocks(offset, offset_sd, rate, rate, unsure, 100.0, 0)
    np.testing.assert_array_equal(unsure.whole_offsets(5), [0, 0, -15, 0, 0, 0, -5])


def test_corrected_numbers_are_those_of_the_reference():
    clocks = Clocks(
        np.array([0.0, 4.0, np.nan]), np.zeros(3), np.array([0.0, 0.01, np.nan]), np.zeros(3),
        (ClockJump(0, 50, 1.0, 2.0, 0.1),), 100.0, 0,
    )  # fmt: skip
    frame = np.repeat(np.arange(0, 200), 3)
    camera = np.tile([0, 1, 2], 200)
    boxes = Detections(frame, camera, np.tile([0.0, 0.0, 5.0, 9.0], (600, 1)))
    right = clocks.correct(boxes)
    for one, true in ((0, lambda f: f - 2 * (f >= 50)), (2, lambda f: f)):
        kept = right.frame[right.camera == one]
        assert len(np.unique(kept)) == len(kept)
        assert set(kept) == set(true(np.arange(200)))
    lag = clocks.lag(np.array([100]))[0]
    assert np.allclose(lag[:2], [2.0, 4.0])
    second = right.frame[right.camera == 1]
    assert len(np.unique(second)) == len(second)
    # Where a clock loses one frame in a hundred, one number in a hundred is lost.
    assert len(second) in (197, 198, 199)
