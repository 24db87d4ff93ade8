"""Boxes of any size at any place must not break the positions of real people."""

import numpy as np

import catfree as cf
from catfree.synthetic import make_world


def test_random_boxes_leave_finite_tracks_of_the_same_people():
    world = make_world("ring6", 3, frames=12, people=12)
    boxes = world.detections
    rng = np.random.default_rng(0)
    count = 120
    width, height = world.scene.rig.image_size[0]
    size = np.exp(rng.uniform(np.log(4), np.log(height), (count, 2)))
    corner = rng.uniform(-0.2, 1.0, (count, 2)) * [width, height]
    junk = cf.Detections(
        rng.choice(boxes.frame, count),
        rng.integers(6, size=count),
        np.hstack([corner, corner + size]),
    )
    mixed = cf.Detections(
        np.concatenate([boxes.frame, junk.frame]),
        np.concatenate([boxes.camera, junk.camera]),
        np.concatenate([boxes.box, junk.box]),
    )
    clean = cf.localize(cf.Detections(boxes.frame, boxes.camera, boxes.box), world.scene).tracks
    found = cf.localize(mixed, world.scene).tracks
    assert len(found) >= 0.5 * len(clean) > 0
    for values in (found.position, found.covariance, found.sigma, found.existence):
        assert np.isfinite(values).all()
