"""Rigs from people seen through unknown lens distortion."""

import dataclasses

import numpy as np
import pytest

# `benchmarks` is not an installed package, so import it from the checkout's root.
from benchmarks.robustness import bent
from catfree.calibration import calibrate
from catfree.geometry import fit_similarity
from catfree.settings import CalibrationSettings
from tests.calibration.ring_world import ring_of_six

pytestmark = pytest.mark.slow

K1 = -0.3
CAMERAS = range(4)  # of the ring; calibrating four takes half the time of all six


@pytest.fixture(scope="module")
def truth():
    return ring_of_six().true_rig.select(CAMERAS)


@pytest.fixture(scope="module")
def boxes():
    seen = ring_of_six().detections
    return seen[np.isin(seen.camera, CAMERAS)]


def test_the_distortion_of_bent_lenses_is_found(boxes, truth):
    box = bent(np.asarray(boxes.box), np.asarray(truth.K)[boxes.camera], K1)
    found = calibrate(dataclasses.replace(boxes, box=box), truth.image_size)
    rig = found.scene.rig
    assert rig.registered.all()
    assert rig.distortion is not None
    k1 = np.asarray(rig.distortion)[:, 0]
    assert (np.abs(k1 - K1) < 3 * found.distortion_sd).all()
    prior_sd = CalibrationSettings().distortion_sd
    assert (found.distortion_sd < min(0.5 * prior_sd, 0.1)).all()
    centers = np.asarray(truth.centers)
    similarity = fit_similarity(np.asarray(rig.centers), centers)
    moved = np.asarray(similarity(np.asarray(rig.centers))) - centers
    variance = np.trace(found.center_covariance, axis1=1, axis2=2) * float(similarity.scale) ** 2
    assert (np.linalg.norm(moved, axis=1) < np.minimum(3 * np.sqrt(variance), 0.5)).all()


def test_straight_lenses_have_no_distortion(boxes, truth):
    straight = calibrate(boxes, truth.image_size)
    assert straight.scene.rig.is_ideal
    np.testing.assert_array_equal(straight.distortion_sd, 0)
