"""Clock offsets are whole frames, one per camera."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration import remove_offsets
from catfree.errors import InvalidInputError
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
