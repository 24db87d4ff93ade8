"""Which people refine a rig, and how much new information they give."""

import numpy as np
import pytest

from catfree.calibration._confident_people import confident_people
from catfree.settings import EvidenceSettings
from catfree.types import Detections
from tests.calibration.ring_world import ring_of_six

pytestmark = pytest.mark.slow


def test_confident_people_are_right_correspondences():
    world = ring_of_six()
    people = confident_people(world.detections, world.true_scene, EvidenceSettings())
    assert len(people.member) > 50
    for member in people.member:
        rows = member[member >= 0]
        assert len(np.unique(world.detections.frame[rows])) == 1
        assert len(np.unique(world.identities[rows])) == 1
    grouped = people.member[people.member >= 0]
    assert np.isfinite(people.box_sd[grouped]).any(1).all()
    assert np.isnan(np.delete(people.box_sd, grouped, axis=0)).all()


def test_somebody_who_stays_says_nothing_new():
    """People who walk are at a new place in nearly every frame; standing people are at one."""
    world, settings = ring_of_six(), EvidenceSettings()
    walking = confident_people(world.detections, world.true_scene, settings)
    assert 1 <= walking.stays < 2
    assert walking.repeats > 5

    frames, now = 30, world.detections[world.detections.frame == 20]
    shake = np.random.default_rng(0).normal(scale=0.5, size=(frames, len(now), 4))
    boxes = Detections(
        np.repeat(np.arange(frames), len(now)),
        np.tile(now.camera, frames),
        (now.box + shake).reshape(-1, 4),
    )
    standing = confident_people(boxes, world.true_scene, settings)
    assert standing.stays > 0.5 * frames
    assert standing.repeats == pytest.approx(frames, rel=0.3)
