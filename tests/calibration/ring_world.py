"""A small world seen by a ring of six cameras, and its rigs with one misplaced camera."""

from dataclasses import replace
from functools import cache

import numpy as np

from catfree.calibration import Calibration
from catfree.synthetic import DetectorModel, World, make_world
from catfree.types import Rig, Scene
from tests.known_calibration import calibration_of


@cache
def ring_of_six() -> World:
    """Simulate eight people for twelve seconds, enough for a quick calibration."""
    detector = DetectorModel(pixel_noise=2.0, embedding_size=0, false_positives=0.3)
    return make_world("ring6", 3, frames=60, people=8, background=1, detector=detector)


def true_ring() -> Calibration:
    """Return the true rig as if from people."""
    return calibration_of(ring_of_six().true_scene)


def moved(calibration: Calibration, camera: int, *step: float) -> Calibration:
    """Move one camera of the rig by (x, y) meters of the world, without refinement."""
    rig = calibration.scene.rig
    t = np.array(rig.t)
    t[camera] -= np.asarray(rig.R)[camera] @ np.array([*step, 0.0])
    beside = Rig(rig.K, rig.R, t, rig.image_size, registered=rig.registered)
    scene = Scene.from_rig(beside, calibration.scene.ground, metric=True)
    return replace(calibration, scene=scene)
