"""Clocks against a known scene: a late camera is named with its offset, and nobody else is."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree._run._clocks import GroundFeet, agreement, find_clock_offsets, stand_on_ground
from catfree.calibration import remove_offsets
from catfree.synthetic import make_world
from catfree.types import Plane, Scene

FRAMES = 120


@cache
def crowd():
    return make_world("ring4", 0, frames=FRAMES, people=14)


def true_scene():
    return Scene.from_rig(crowd().true_rig, Plane([0.0, 0.0, 1.0], 0.0), metric=True)


def late(detections, camera, count, by):
    """The boxes with one camera's numbers too high by some frames, where all cameras overlap."""
    offset = np.zeros(count, np.int64)
    offset[camera] = -by
    moved = remove_offsets(detections, offset)
    return moved[(moved.frame >= max(0, by)) & (moved.frame < FRAMES + min(0, by))]


@pytest.mark.slow
def test_clocks_that_fit_are_left_alone():
    world = crowd()
    np.testing.assert_array_equal(find_clock_offsets(world.detections, world.scene), 0)


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "by"), [(1, -10), (2, 8)])
def test_a_late_camera_is_named_with_its_offset(camera, by):
    world = crowd()
    boxes = late(world.detections, camera, 4, by)
    found = find_clock_offsets(boxes, true_scene())
    assert abs(found[camera] - by) <= 1
    np.testing.assert_array_equal(np.delete(found, camera), 0)
    # Frame numbers may have any step: those of every fifth frame count five times as much.
    sparse = type(boxes)(5 * boxes.frame + 3, boxes.camera, boxes.box, boxes.score)
    np.testing.assert_array_equal(find_clock_offsets(sparse, true_scene()), 5 * found)


@pytest.mark.slow
def test_a_rig_that_is_somewhat_off_tells_it_too():
    world = crowd()
    found = find_clock_offsets(late(world.detections, 1, 4, -10), world.scene)
    assert abs(found[1] + 10) <= 2
    np.testing.assert_array_equal(np.delete(found, 1), 0)


def test_of_two_cameras_one_is_off():
    world = crowd()
    scene = world.scene
    pair = Scene(scene.rig.select([0, 1]), scene.ground, scene.extent, scene.metric)
    boxes = world.detections[world.detections.camera < 2]
    np.testing.assert_array_equal(find_clock_offsets(boxes, pair), 0)
    found = find_clock_offsets(late(boxes, 1, 2, -10), pair)
    assert abs(found[1] - found[0] + 10) <= 1


@pytest.mark.slow
def test_people_who_stand_still_tell_nothing():
    world = crowd()
    first = world.detections[world.detections.frame == 0]
    frame = np.repeat(np.arange(FRAMES), len(first))
    camera, box = np.tile(first.camera, FRAMES), np.tile(first.box, (FRAMES, 1))
    still = type(first)(frame, camera, box)
    np.testing.assert_array_equal(find_clock_offsets(still, world.scene), 0)


def test_too_little_to_say_anything():
    world = crowd()
    for boxes in (world.detections[:0], world.detections[world.detections.frame < 2]):
        np.testing.assert_array_equal(find_clock_offsets(boxes, world.scene), 0)


def test_feet_stand_where_the_people_do():
    world = crowd()
    seen = world.detections
    feet = stand_on_ground(seen, seen.frame, true_scene(), 0)
    assert feet.valid.sum() > 100
    truth = world.walkers.rows(inside_only=False)
    time, slot = np.nonzero(feet.valid)
    nearest = [
        np.linalg.norm(truth[truth[:, 0] == t][:, 2:] - feet.xy[t, n], axis=1).min()
        for t, n in zip(time, slot, strict=True)
    ]
    assert np.median(nearest) < 0.5


@settings(max_examples=20)
@given(shift=st.integers(-4, 4), seed=st.integers(0, 1000))
def test_the_same_walks_agree_fully_at_their_shift_and_nowhere_better(shift, seed):
    walk = np.random.default_rng(seed).normal(size=(30, 2, 2)).cumsum(axis=0)
    shape = walk.shape[:2]
    one = GroundFeet(walk, np.ones((*shape, 3)) * [1.0, 0.0, 1.0], np.ones(shape, bool))
    two = GroundFeet(np.roll(walk, shift, axis=0), one.covariance, one.valid)
    shifts = np.arange(-5, 6)
    score = agreement({0: one, 1: two}, 1, shifts)
    assert score.max() <= 1
    # What the roll brought around the end finds nobody at home, and leaves the footage.
    assert score[shifts == shift][0] == pytest.approx(1)
