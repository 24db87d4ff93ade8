"""What the result folder holds, and what it no longer holds."""

from functools import cache

import numpy as np
from hypothesis import given, strategies as st

from catfree._run._result_folder import numbers_of_files, write_results
from catfree._run._run import run_boxes
from catfree.adapters import read_mot
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Detections

NAMES = ("north", "east", "south")


@given(
    st.sets(st.integers(0, 60), min_size=1),
    st.integers(1, 5),
    st.integers(-9, 9) | st.integers(0, 10**12),
)
def test_numbers_in_files_are_proportional_to_those_of_the_frames(seen, step, start):
    frames = start + step * np.array(sorted(seen))
    for from_one in (False, True):
        numbers = numbers_of_files(frames, from_one=from_one)
        written = np.array([numbers.index(int(frame)) for frame in frames]) + 1
        assert written.min() >= 1
        np.testing.assert_array_equal(np.diff(written) * numbers.step, np.diff(frames))
        if from_one and numbers.step == 1 and frames[0] >= 1:
            np.testing.assert_array_equal(written, frames)
        if not from_one:
            assert written[0] == 1


@cache
def boxes_with_a_gap():
    world = make_world(ring(3, image_size=(640, 360), people=3), frames=12, people=3)
    seen = world.detections
    frame = seen.frame + np.where(seen.frame < 4, 3, 12)  # 3 to 6, and 16 on
    boxes = CameraBoxes(Detections(**(vars(seen) | {"frame": frame})), NAMES)
    return boxes, world.scene


def test_boxes_are_written_with_the_numbers_they_had(tmp_path):
    boxes, scene = boxes_with_a_gap()
    outcome = run_boxes(boxes, scene)
    write_results(tmp_path, outcome, pictures=False)
    for camera, name in enumerate(NAMES):
        own = boxes.detections.frame[boxes.detections.camera == camera]
        written = read_mot(tmp_path / "boxes" / f"{name}.txt").frame
        np.testing.assert_array_equal(np.sort(written), np.sort(own))
    tracks = read_mot(tmp_path / "tracks_mot.txt").frame
    np.testing.assert_array_equal(np.sort(tracks), np.sort(outcome.localization.tracks.frame))
