"""Rigs of real scenes from real detector boxes: what must hold whatever the boxes.

How accurate the rigs are is measured by the gate (`benchmarks/gate.py`).
"""

import dataclasses

import numpy as np
import pytest

from catfree.adapters import MultiViewSequence, read_uniform_json
from catfree.calibration import Calibration, calibrate
from catfree.geometry import fit_similarity
from tests.known_sequences import real_path


def first_frames(sequence: MultiViewSequence) -> MultiViewSequence:
    """Half a minute, of which a rig is calibrated in half the time of all."""
    return sequence.select_frames(sequence.frames[:130])


def aligned_centers(
    calibration: Calibration, truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Registered cameras, their centers after a similarity alignment, and the estimated scale."""
    rig = calibration.scene.rig
    registered = np.flatnonzero(rig.registered)
    similarity = fit_similarity(np.asarray(rig.centers)[registered], truth[registered])
    centers = np.asarray(similarity(np.asarray(rig.centers)[registered]))
    return registered, centers, 1 / float(similarity.scale)


def shifted(sequence: MultiViewSequence, camera: int, times: np.ndarray):
    """The boxes, with the frames of one camera at other times."""
    boxes = sequence.detections
    frame = boxes.frame.copy()
    rows = boxes.camera == camera
    frame[rows] = times[np.searchsorted(np.unique(boxes.frame), frame[rows])]
    return dataclasses.replace(boxes, frame=frame)


def assert_flagged_alone(sequence: MultiViewSequence, camera: int, times: np.ndarray) -> None:
    """A camera of other times is not registered; the others stand as they do without it."""
    truth = np.asarray(sequence.rig.centers)
    disturbed = calibrate(shifted(sequence, camera, times), sequence.rig.image_size)
    registered, centers, _ = aligned_centers(disturbed, truth)
    others = [c for c in range(len(truth)) if c != camera]
    assert registered.tolist() == others
    boxes = sequence.detections
    without = calibrate(boxes[boxes.camera != camera], sequence.rig.image_size)
    assert np.flatnonzero(without.scene.rig.registered).tolist() == others
    _, alone, _ = aligned_centers(without, truth)
    np.testing.assert_allclose(centers, alone, atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cmc1", "cmc3"])
def test_a_real_room_is_registered_whole_and_states_its_scale(shared, name):
    sequence = first_frames(read_uniform_json(real_path(shared / "data", name)))
    calibration = calibrate(sequence.detections, sequence.rig.image_size)
    registered, _, scale = aligned_centers(calibration, np.asarray(sequence.rig.centers))
    assert registered.tolist() == list(range(sequence.rig.camera_count))
    assert abs(scale - 1) < 2 * calibration.scale_sd


@pytest.mark.slow
@pytest.mark.parametrize(("views", "camera"), [("views", 0), ("views_fairmot", 3)])
def test_a_camera_that_is_late_is_flagged_though_people_walk_to_and_fro(shared, views, camera):
    """Of the same few people in the same room, its matches 5 s late beat every other lateness."""
    sequence = read_uniform_json(real_path(shared / "data", "cmc1"), views=views)
    assert_flagged_alone(sequence, camera, np.roll(np.unique(sequence.detections.frame), -20))


@pytest.mark.slow
def test_a_camera_with_shuffled_frames_is_flagged(shared):
    sequence = first_frames(read_uniform_json(real_path(shared / "data", "cmc1")))
    frames = np.unique(sequence.detections.frame)
    assert_flagged_alone(sequence, 1, np.random.default_rng(0).permutation(frames))
