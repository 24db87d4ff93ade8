"""Worse input makes worse results, but gradually, and never worse than the paper's method."""

import numpy as np
import pytest

import catfree as cf
from catfree.evaluation import align_centres, crop, detection_metrics
from catfree.evidence import locate
from catfree.synthetic import DetectorModel, make_world

FRAMES = 8


def world(**detector):
    return make_world("ring6", 8, frames=FRAMES, detector=DetectorModel(**detector))


def moda(world, detections, method):
    result = method(detections, world.scene)
    alignment = align_centres(np.asarray(world.scene.rig.centers), world.true_centres)
    position = np.asarray(alignment(np.asarray(result.tracks.position)))
    rows = crop(result.tracks.to_rows(position[:, :2]), world.area)
    return detection_metrics(world.ground_truth, rows, frames=np.arange(FRAMES)).moda


def paper(detections, scene):
    return cf.localize(detections, scene, cf.Settings.paper())


@pytest.mark.parametrize(
    ("detector", "least"),
    [
        ({"detection_rate": 0.5}, 75),  # half of all people missed in every image
        ({"false_positives": 4.0}, 85),  # a third of all boxes show nobody
    ],
)
def test_a_bad_detector_costs_little(detector, least):
    bad = world(**detector)
    found = moda(bad, bad.detections, locate)
    assert found > least
    assert found >= moda(bad, bad.detections, paper)


def test_a_camera_that_drops_frames_costs_nothing():
    good = world()
    dropped = (good.detections.camera == 1) & (good.detections.frame % 6 == 3)
    before = moda(good, good.detections, locate)
    assert moda(good, good.detections[~dropped], locate) > before - 2
