"""Search of missing and misplaced cameras in a correct rig."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.calibration.people import (
    confirm,
    place_late_camera,
    reconsider,
    remove_offsets,
    without_camera,
    without_vague_cameras,
)
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL
from catfree.errors import CalibrationError
from catfree.settings import CalibrationSettings
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Detections
from tests.calibration.ring_world import moved, ring_of_six, true_ring
from tests.known_calibration import calibration_of

pytestmark = pytest.mark.slow

RULES = CalibrationSettings()
CAMERA = 2


@pytest.fixture(scope="module")
def world():
    return ring_of_six()


@pytest.fixture(scope="module")
def calibration():
    return true_ring()


def test_a_missing_camera_is_found(world, calibration) -> None:
    rig = calibration.scene.rig
    missing = without_camera(calibration, CAMERA)
    found = reconsider(missing, world.detections, RULES)
    assert found is not None
    assert found.scene.rig.registered.all()
    distance = np.linalg.norm(np.asarray(found.scene.rig.centers - rig.centers), axis=1)
    assert distance[CAMERA] < 0.6
    assert (np.delete(distance, CAMERA) < 1e-9).all()
    assert found.log_likelihood_ratio[CAMERA] > RULES.minimum_margin


@pytest.mark.parametrize("late", [0, -9])
def test_a_camera_that_is_missing_for_lateness_gets_its_offset(world, calibration, late) -> None:
    missing = without_camera(calibration, CAMERA)
    offset = np.where(np.arange(6) == CAMERA, -late, 0)
    boxes = remove_offsets(world.detections, offset)
    boxes = boxes[boxes.frame >= 0]
    found = place_late_camera(missing, boxes, CAMERA, 12, RULES)
    if late == 0:
        assert found is None
        return
    assert found is not None
    assert found.frame_offset.tolist() == (-offset).tolist()
    assert found.scene.rig.registered.all()
    distance = np.asarray(found.scene.rig.centers) - np.asarray(calibration.scene.rig.centers)
    assert np.linalg.norm(distance[CAMERA]) < 0.6


def test_a_misplaced_camera_is_moved_back(world, calibration) -> None:
    rig = calibration.scene.rig
    beside = moved(calibration, CAMERA, 0.9, -0.9)
    found = reconsider(beside, world.detections, RULES)
    assert found is not None
    distance = np.asarray(found.scene.rig.centers) - np.asarray(rig.centers)
    assert np.linalg.norm(distance[CAMERA]) < 0.6


def test_a_camera_of_another_time_is_neither_found_nor_confirmed(world, calibration) -> None:
    boxes = world.detections
    mine = boxes.camera == CAMERA
    frames = np.unique(boxes.frame)
    shuffled = boxes.frame.copy()
    shuffled[mine] = frames[::-1][np.searchsorted(frames, shuffled[mine])]
    late = Detections(shuffled, boxes.camera, boxes.box)
    checked = confirm(calibration, late, RULES)
    assert not checked.scene.rig.registered[CAMERA]
    assert np.isnan(checked.log_likelihood_ratio[CAMERA])
    assert checked.scene.rig.registered.sum() == 5
    again = reconsider(checked, late, RULES)
    assert again is None or not again.scene.rig.registered[CAMERA]


def test_a_right_rig_is_confirmed_with_evidence(world, calibration) -> None:
    checked = confirm(calibration, world.detections, RULES)
    assert checked.scene.rig.registered.all()
    assert (checked.log_likelihood_ratio > RULES.minimum_margin).all()
    np.testing.assert_allclose(checked.scene.rig.centers, calibration.scene.rig.centers, atol=1e-6)


def test_a_right_camera_that_shares_nobody_with_two_others_is_confirmed(world, calibration) -> None:
    sightings = np.where(np.arange(6) == CAMERA, 0, calibration.sightings)
    checked = confirm(replace(calibration, sightings=sightings), world.detections, RULES)
    assert checked.scene.rig.registered.all()


def test_without_a_camera_the_others_stay(calibration) -> None:
    rest = without_camera(calibration, CAMERA)
    kept = np.arange(6) != CAMERA
    np.testing.assert_array_equal(rest.scene.rig.registered, kept)
    for name in ("camera_residual", "log_likelihood_ratio", "association_rate", "focal_sd"):
        assert np.isnan(getattr(rest, name)[CAMERA])
        before, after = (getattr(one, name)[kept] for one in (calibration, rest))
        np.testing.assert_allclose(after, before, rtol=1e-12)
    np.testing.assert_allclose(
        np.asarray(rest.scene.rig.centers)[kept],
        np.asarray(calibration.scene.rig.centers)[kept],
        atol=1e-9,
    )


@pytest.mark.parametrize(("seed", "camera"), [(3, 1), (5, 5), (10, 3)])
def test_a_place_is_found_whose_votes_are_fewer_than_those_of_chance(seed, camera) -> None:
    poor = DetectorModel(
        box_noise=0.03, pixel_noise=4.0, truncation=0.7, embedding_size=0, false_positives=1.0
    )
    world = make_world("ring6", seed, frames=40, people=8, detector=poor)
    rest = without_camera(calibration_of(world.true_scene), camera)
    found = reconsider(rest, world.detections, RULES)
    assert found is not None
    center = np.asarray(found.scene.rig.centers)[camera]
    assert np.linalg.norm(center - world.true_centres[camera]) < 0.6


def with_focal_deviation(calibration, deviation):
    """State relative deviations of the focal lengths."""
    covariance = calibration.camera_covariance.copy()
    cameras = np.arange(len(covariance))
    covariance[cameras, LOG_FOCAL, cameras, LOG_FOCAL] = np.square(deviation)
    return replace(calibration, camera_covariance=covariance)


def test_a_camera_whose_focal_length_nobody_knows_is_flagged(calibration) -> None:
    deviation = np.full(6, 0.9 * RULES.largest_focal_sd)
    known = with_focal_deviation(calibration, deviation)
    focal = np.asarray(calibration.scene.rig.K)[:, 0, 0]
    np.testing.assert_allclose(known.focal_sd, focal * deviation)
    assert without_vague_cameras(known, RULES) is known
    deviation[CAMERA] = 1.1 * RULES.largest_focal_sd
    found = without_vague_cameras(with_focal_deviation(calibration, deviation), RULES)
    assert found.scene.rig.registered.tolist() == [c != CAMERA for c in range(6)]


def test_a_rig_whose_focal_lengths_nobody_knows_is_refused(calibration) -> None:
    vague = with_focal_deviation(calibration, [0.01, 0.13, 0.2, 0.13, 0.3, 0.13])
    names = ["north", "east", "south", "west", "door", "roof"]
    with pytest.raises(CalibrationError, match="camera 'south' to 20 %"):
        without_vague_cameras(vague, RULES, names)
