"""Which people refine a rig, and how much of what they say is new."""

import numpy as np
import pytest

from catfree.calibration._confident_people import confident_people
from catfree.settings import EvidenceSettings
from catfree.types import Detections
from tests.calibration.ring_world import ring_of_six

pytestmark = pytest.mark.slow


def test_somebody_who_stays_says_nothing_new():
    """People who walk are at a new place in nearly every frame; who stands is at one."""
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
