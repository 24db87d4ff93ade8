"""Boxes of any size at any place must not break the positions of real people."""

import numpy as np
import pytest

import catfree as cf
from catfree.evaluation import align_centres, crop, detection_metrics
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow


def with_random_boxes(world, count, seed=0):
    """Return the world's boxes without embeddings, plus as many random ones."""
    boxes, rig = world.detections, world.scene.rig
    rng = np.random.default_rng(seed)
    width, height = rig.image_size[0]
    size = np.exp(rng.uniform(np.log(4), np.log(height), (count, 2)))
    corner = rng.uniform(-0.2, 1.0, (count, 2)) * [width, height]
    return cf.Detections(
        np.concatenate([boxes.frame, rng.choice(boxes.frame, count)]),
        np.concatenate([boxes.camera, rng.integers(rig.camera_count, size=count)]),
        np.concatenate([boxes.box, np.hstack([corner, corner + size])]),
    )


def test_random_boxes_leave_finite_tracks_of_the_same_people():
    world = make_world("ring6", 3, frames=12, people=12)
    clean = cf.localize(with_random_boxes(world, 0), world.scene).tracks
    found = cf.localize(with_random_boxes(world, 120), world.scene).tracks
    assert len(found) >= 0.5 * len(clean) > 0
    for values in (found.position, found.covariance, found.sigma, found.existence):
        assert np.isfinite(values).all()


def moda(world, boxes, settings):
    tracks = cf.localize(boxes, world.scene, settings).tracks
    align = align_centres(np.asarray(world.scene.rig.centers), world.true_centres)
    rows = crop(tracks.to_rows(np.asarray(align(tracks.position))[:, :2]), world.area)
    return detection_metrics(world.ground_truth, rows, frames=np.arange(12)).moda


def test_four_wrong_cameras_and_random_boxes_lose_nobody():
    # With so few boxes and so wrong a rig, the usual start of self-calibration joins no three
    # cameras, so nothing was learned and all people passed for clutter. One of six people makes 17
    # points, with or without random boxes, so only the mean is meaningful.
    found, usual, paper = [], [], []
    for seed in range(3, 15):
        world = make_world("ring4", seed, frames=12, people=6)
        junk = with_random_boxes(world, 60, seed)
        found.append(moda(world, junk, cf.Settings()))
        usual.append(moda(world, with_random_boxes(world, 0), cf.Settings()))
        paper.append(moda(world, junk, cf.Settings.paper()))
    assert np.mean(found) > np.mean(usual) - 3
    assert np.mean(found) > np.mean(paper)
