"""Clock offsets are whole frames, one per camera."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration import calibrate, remove_offsets
from catfree.errors import InvalidInputError
from catfree.evaluation import align_centres
from catfree.synthetic import make_world
from catfree.types import Detections

whole = st.integers(-1000, 1000)


@given(st.lists(st.tuples(st.integers(0, 3), whole), max_size=9), st.lists(whole, min_size=4))
def test_each_frame_number_loses_the_offset_of_its_camera(rows, offset):
    camera, frame = np.array(rows, int).reshape(-1, 2).T
    boxes = Detections(frame, camera, np.tile([0.0, 0, 9, 20], (len(rows), 1)))
    moved = remove_offsets(boxes, offset)
    assert moved.frame.tolist() == [frame - offset[camera] for camera, frame in rows]
    back = remove_offsets(moved, [-float(one) for one in offset])
    np.testing.assert_array_equal(back.frame, boxes.frame)


@pytest.mark.parametrize(
    ("offset", "sentence"),
    [
        ([0, 2.9], r"frame_offset\[1\] is 2.9; it must be a whole number"),
        ([0, np.nan], r"frame_offset\[1\] is nan"),
        ([0], "frame_offset has 1 entries, but there are boxes of 2 cameras"),
        ([[0, 1]], "frame_offset must have shape"),
    ],
)
def test_what_is_not_one_offset_per_camera_is_refused(offset, sentence):
    boxes = Detections([5, 5], [0, 1], [[0, 0, 9, 20.0]] * 2)
    with pytest.raises(InvalidInputError, match=sentence):
        remove_offsets(boxes, offset)


@pytest.mark.slow
@pytest.mark.parametrize("late", [2, 3])
def test_the_offset_is_found_of_a_camera_that_was_placed_elsewhere_or_nowhere(late):
    # Late by 3, it is first placed where it matches other people; late by 2, it is not placed.
    world = make_world("ring4", 3, frames=60, people=8)
    boxes = world.detections
    frame = np.where(boxes.camera == 1, boxes.frame + late, boxes.frame)
    size = world.scene.rig.image_size
    stages = []
    found = calibrate(
        replace(boxes, frame=frame), size, maximum_offset=8, progress=lambda *s: stages.append(s)
    )
    searched = [(done, total) for stage, done, total in stages if stage == "offsets"]
    assert searched == [(done, searched[0][1]) for done in range(searched[0][1] + 1)]
    assert found.scene.rig.registered.all()
    assert found.frame_offset.tolist() == [0, late, 0, 0]


@pytest.mark.slow
def test_a_late_camera_without_an_offset_does_not_stay_where_it_matches_others_by_chance():
    # Among the first cameras, its pose is wrong; the others are right once none relies on it.
    world = make_world("ring4", 3, frames=60, people=7)
    boxes = world.detections
    frame = np.where(boxes.camera == 2, boxes.frame + 6, boxes.frame)
    late = Detections(frame, boxes.camera, boxes.box)
    rig = calibrate(late, world.scene.rig.image_size, maximum_offset=8).scene.rig
    assert rig.registered.sum() >= 3
    alignment = align_centres(
        np.asarray(rig.centers), world.true_centres, registered=rig.registered
    )
    error = np.linalg.norm(np.asarray(alignment(rig.centers)) - world.true_centres, axis=1)
    assert np.nanmax(error) < 0.5
