"""Cameras beside their places are found and moved, and no longer keep others out."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.rig.evidence_loop import EvidenceLoop
from catfree.rig.pedestrians import calibrate, refine_with_correspondences, without_camera
from catfree.rig.strain import most_strained
from catfree.rig.sure_people import sure_people
from catfree.settings import Settings
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Rig, Scene

SETTINGS = Settings()
WRONG, MISSING = 2, 5


@pytest.fixture(scope="module")
def world():
    detector = DetectorModel(pixel_noise=2.0, embedding_size=0, false_positives=0.3)
    return make_world("ring6", 3, frames=60, people=8, background=1, detector=detector)


@pytest.fixture(scope="module")
def loop(world):
    return EvidenceLoop(world.detections, SETTINGS, lambda *_: None)


@pytest.fixture(scope="module")
def right(world, loop):
    found = loop.refine(calibrate(world.detections, world.true_rig.image_size))
    assert found.scene.rig.registered.all()
    return found


@pytest.fixture(scope="module")
def beside(world, right):
    """One camera 1.8 m from its place, and what that does to the residuals of the right groups."""
    rig = right.scene.rig
    t = np.array(rig.t)
    t[WRONG] -= np.asarray(rig.R)[WRONG] @ np.array([1.5, -1.0, 0.0])
    moved = Rig(rig.K, rig.R, t, rig.image_size, registered=rig.registered)
    scene = Scene.from_rig(moved, right.scene.ground, metric=True)
    people = sure_people(world.detections, right.scene, SETTINGS.evidence)
    return refine_with_correspondences(
        replace(right, scene=scene),
        world.detections,
        people.member,
        box_sd=people.box_sd,
        iterations=0,
    )


def furthest(found, right):
    """Largest distance of a camera from where it belongs, in metres; NaN ones left out."""
    away = np.asarray(found.scene.rig.centers) - np.asarray(right.scene.rig.centers)
    return np.nanmax(np.linalg.norm(away, axis=1))


def test_a_rig_in_order_stays_as_it_is(loop, right):
    assert most_strained(right.camera_residual) is None
    assert loop.relieve(right) is right
    assert loop.free(right) is None


def test_a_camera_beside_its_place_is_taken_to_it(loop, right, beside):
    assert most_strained(beside.camera_residual) == WRONG
    assert furthest(beside, right) > 1.0
    found = loop.relieve(beside)
    assert most_strained(found.camera_residual) is None
    assert found.residual < beside.residual
    assert furthest(found, right) < 0.3


def test_a_camera_that_keeps_another_out_is_moved(loop, right, beside):
    knotted = without_camera(beside, MISSING, SETTINGS.calibration)
    found = loop.free(knotted)
    assert found is not None
    assert found.residual < knotted.residual
    assert found.scene.rig.registered.tolist() == [c != MISSING for c in range(6)]
    assert furthest(found, right) < 0.3


def test_three_cameras_do_not_tell_which_of_them_is_wrong(loop, beside):
    few = beside
    for camera in (0, 1, MISSING):
        few = without_camera(few, camera, SETTINGS.calibration)
    assert loop.free(few) is None
    assert loop.relieve(few) is few


def test_where_nobody_is_sure_nothing_moves(world, right):
    empty = world.detections[:0]
    loop = EvidenceLoop(empty, SETTINGS, lambda *_: None)
    assert loop.turn(right) is None
    assert loop.refine(right) is right
