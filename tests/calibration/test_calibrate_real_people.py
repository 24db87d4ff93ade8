"""Rigs of real scenes from real detector boxes: properties that hold for any boxes.

The gate measures the accuracy of the rigs (`benchmarks/gate.py`).
"""

import dataclasses

import numpy as np
import pytest

from catfree.adapters import MultiViewSequence, read_uniform_json
from catfree.calibration import Calibration, KnownCamera, anchored, calibrate
from catfree.geometry import fit_similarity
from tests.known_sequences import real_path

pytestmark = pytest.mark.slow

DISTURBED = 1  # the camera whose frames are shifted in time


def aligned_centers(
    calibration: Calibration, truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return registered cameras, their aligned centers, and the estimated scale."""
    rig = calibration.scene.rig
    registered = np.flatnonzero(rig.registered)
    similarity = fit_similarity(np.asarray(rig.centers)[registered], truth[registered])
    centers = np.asarray(similarity(np.asarray(rig.centers)[registered]))
    return registered, centers, 1 / float(similarity.scale)


def shifted(sequence: MultiViewSequence, camera: int, times: np.ndarray):
    """Shift the frames of one camera in time."""
    boxes = sequence.detections
    frame = boxes.frame.copy()
    rows = boxes.camera == camera
    frame[rows] = times[np.searchsorted(np.unique(boxes.frame), frame[rows])]
    return dataclasses.replace(boxes, frame=frame)


@pytest.fixture(scope="module")
def room(shared) -> MultiViewSequence:
    """Select half a minute, which takes half the time of the whole to calibrate."""
    sequence = read_uniform_json(real_path(shared / "data", "cmc1"))
    return sequence.select_frames(sequence.frames[:130])


@pytest.fixture(scope="module")
def calibrated(room):
    return calibrate(room.detections, room.rig.image_size)


@pytest.fixture(scope="module")
def without(room):
    """Calibrate only the other cameras."""
    boxes = room.detections
    calibration = calibrate(boxes[boxes.camera != DISTURBED], room.rig.image_size)
    return aligned_centers(calibration, np.asarray(room.rig.centers))


def test_a_real_room_is_registered_whole_and_states_its_scale(room, calibrated):
    registered, _, scale = aligned_centers(calibrated, np.asarray(room.rig.centers))
    assert registered.tolist() == list(range(room.rig.camera_count))
    assert abs(scale - 1) < 2 * calibrated.scale_sd


@pytest.mark.parametrize("kind", ["late", "shuffled"])
def test_a_camera_of_other_times_is_flagged_and_the_others_stay(room, without, kind):
    """With the same few people in a room, matches that are 5 s late beat every other delay."""
    frames = np.unique(room.detections.frame)
    late, shuffled = np.roll(frames, -20), np.random.default_rng(0).permutation(frames)
    disturbed = shifted(room, DISTURBED, late if kind == "late" else shuffled)
    truth = np.asarray(room.rig.centers)
    calibration = calibrate(disturbed, room.rig.image_size)
    registered, centers, _ = aligned_centers(calibration, truth)
    others, alone, _ = without
    assert others.tolist() == [c for c in range(len(truth)) if c != DISTURBED]
    assert registered.tolist() == others.tolist()
    np.testing.assert_allclose(centers, alone, atol=0.05)


def test_known_positions_make_the_scale_of_a_real_room_sure(room, calibrated):
    calibration = calibrated
    truth = np.asarray(room.rig.centers)
    known = [
        KnownCamera(int(c), position=tuple(truth[c].tolist()), position_sd=0.02)
        for c in np.flatnonzero(calibration.scene.rig.registered)
    ]
    found = anchored(calibration, known)
    assert found.contradictions == ()
    assert found.scale_sd < 0.01 < calibration.scale_sd
    _, centers, scale = aligned_centers(found, truth)
    assert abs(np.log(scale)) < 2 * found.scale_sd
    _, before, _ = aligned_centers(calibration, truth)
    assert np.linalg.norm(centers - truth, axis=1).mean() < 0.5 * (
        np.linalg.norm(before - truth, axis=1).mean()
    )
