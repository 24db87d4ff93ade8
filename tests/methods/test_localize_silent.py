"""Cameras without a picture: missing detections are not evidence."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree.errors import InvalidInputError
from catfree.synthetic import make_world
from tests.methods.evidence.evidence_worlds import walk

TRUTH, DETECTIONS, SCENE = walk(people=4, frames=10, recall=1.0, clutter=0.1)
CAMERAS = SCENE.rig.camera_count


def without(camera, first, last):
    """Remove a camera's pictures of some frames from the detections; also return these pictures."""
    frames = np.arange(first, last)
    gone = (DETECTIONS.camera == camera) & np.isin(DETECTIONS.frame, frames)
    return DETECTIONS[~gone], np.column_stack([frames, np.full(len(frames), camera)])


def existence(localization):
    """Map frame and place, to the decimeter, to existence."""
    tracks = localization.tracks
    place = np.round(tracks.ground_xy, 1)
    return {
        (int(f), *xy): e
        for f, xy, e in zip(tracks.frame, place.tolist(), tracks.existence, strict=True)
    }


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(st.integers(0, CAMERAS - 1), st.integers(0, 5), st.integers(2, 5))
def test_nobody_whom_others_see_vanishes(camera, first, count):
    less, silent = without(camera, first, first + count)
    found = cf.localize(less, SCENE, silent=silent).tracks
    for frame in np.unique(TRUTH[:, 0]):
        away = np.linalg.norm(
            TRUTH[TRUTH[:, 0] == frame][:, None, 2:] - found.ground_xy[found.frame == frame],
            axis=-1,
        )
        assert (away.min(1) < 0.4).all()


@pytest.mark.slow
def test_the_order_and_repetition_of_pictures_change_nothing():
    less, silent = without(1, 2, 6)
    one = cf.localize(less, SCENE, silent=silent)
    other = cf.localize(less, SCENE, silent=np.concatenate([silent[::-1], silent]))
    assert existence(one) == existence(other)


@pytest.mark.slow
def test_pictures_of_frames_without_boxes_change_nothing():
    far = [[1000, 0], [-5, 2]]
    assert existence(cf.localize(DETECTIONS, SCENE, silent=far)) == existence(
        cf.localize(DETECTIONS, SCENE)
    )


def test_a_box_in_a_missing_picture_is_refused():
    with pytest.raises(InvalidInputError, match="camera 0 has no picture of frame 3"):
        cf.localize(DETECTIONS, SCENE, silent=[[3, 0]])


@pytest.mark.parametrize("rows", [[[0, CAMERAS]], [[0, -1]], [0, 1], [[0.5, 0]]])
def test_impossible_pictures_are_refused(rows):
    with pytest.raises(InvalidInputError):
        cf.localize(DETECTIONS, SCENE, silent=rows)


@pytest.mark.slow
@pytest.mark.parametrize("camera", [0, 3])
def test_one_dead_camera_of_four_hides_nobody_and_is_named(camera):
    world = make_world("ring4", frames=30, people=6, seed=1)
    boxes = world.detections
    less = boxes[boxes.camera != camera]
    untold = cf.localize(less, world.true_scene)
    silent = [[frame, camera] for frame in range(30)]
    told = cf.localize(less, world.true_scene, silent=silent)
    assert len(untold.tracks) >= 0.9 * len(told.tracks) > 0
    assert any(f"Camera {camera} has 0 of the" in warning for warning in untold.warnings)
    assert not any("in its view" in warning for warning in told.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_a_camera_that_is_silent_in_all_frames_counts_as_absent(seed):
    world = make_world("ring5", frames=20, people=8, seed=seed)
    scene, boxes = world.true_scene, world.detections
    less = boxes[boxes.camera != 2]
    silent = [[frame, 2] for frame in range(20)]
    told = cf.localize(less, scene, silent=silent).tracks
    registered = np.arange(5) != 2
    without = replace(scene, rig=replace(scene.rig, registered=registered))
    absent = cf.localize(less, without).tracks
    assert len(told) == len(absent) > 0
    np.testing.assert_array_equal(told.frame, absent.frame)
    np.testing.assert_allclose(told.position, absent.position, atol=1e-9)
    np.testing.assert_array_equal(told.whole_views, absent.whole_views)


def test_a_camera_with_few_false_boxes_alone_is_named():
    world = make_world("ring4", frames=60, people=6, seed=1)
    boxes = world.detections
    kept = boxes.camera != 2
    kept[np.flatnonzero(~kept)[:3]] = True
    few = boxes[kept]
    named = [w for w in cf.localize(few, world.true_scene).warnings if "in its view" in w]
    assert len(named) == 1
    assert named[0].startswith("Camera 2 has 3 of the")
    assert not any("in its view" in w for w in cf.localize(boxes, world.true_scene).warnings)
