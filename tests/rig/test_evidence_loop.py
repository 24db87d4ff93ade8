"""Cameras beside their places are found and moved, and no longer keep others out."""

from dataclasses import replace

import numpy as np
import pytest
from ring_world import moved, ring_of_six

from catfree.rig.evidence_loop import EvidenceLoop
from catfree.rig.pedestrians import calibrate, without_camera
from catfree.settings import Settings

SETTINGS = Settings()
WRONG, MISSING = 2, 5


@pytest.fixture(scope="module")
def world():
    return ring_of_six()


@pytest.fixture(scope="module")
def loop(world):
    return EvidenceLoop(world.detections, SETTINGS, lambda *_: None)


@pytest.fixture(scope="module")
def right(world, loop):
    found = loop.refine(calibrate(world.detections, world.true_rig.image_size))
    assert found.scene.rig.registered.all()
    return found


def furthest(found, right):
    """Largest distance of a camera from where it belongs, in metres; NaN ones left out."""
    away = np.asarray(found.scene.rig.centers) - np.asarray(right.scene.rig.centers)
    return np.nanmax(np.linalg.norm(away, axis=1))


def test_a_rig_in_order_stays_as_it_is(loop, right):
    assert loop.replace_strained(right) is right
    assert loop.replace_blocking(right) is None


@pytest.mark.parametrize("step", [(1.5, -1.0), (2.5, -1.7), (-2.0, 2.0)])
def test_a_camera_beside_its_place_is_taken_to_it(loop, right, step):
    found = loop.settle(moved(right, WRONG, *step))
    assert found.scene.rig.registered.all()
    assert furthest(found, right) < 0.3


def test_a_camera_without_people_is_strained_and_placed_anew(loop, right):
    away = loop.refine(moved(right, WRONG, 2.5, -1.7))
    assert furthest(away, right) > 1.0
    found = loop.replace_strained(away)
    assert found.sightings.sum() > away.sightings.sum()
    assert furthest(found, right) < 0.3


def test_a_rig_that_lacks_a_camera_and_has_another_beside_its_place(loop, right):
    lacking = without_camera(moved(right, WRONG, 1.5, -1.0), MISSING, SETTINGS.calibration)
    found = loop.settle(lacking)
    assert found.scene.rig.registered.all()
    assert furthest(found, right) < 0.3


def test_three_cameras_do_not_tell_which_of_them_is_wrong(loop, right):
    few = moved(right, WRONG, 1.5, -1.0)
    for camera in (0, 1, MISSING):
        few = without_camera(few, camera, SETTINGS.calibration)
    assert loop.replace_blocking(few) is None
    assert loop.replace_strained(few) is few


def test_a_camera_that_fits_nowhere_is_flagged_in_the_end(world, loop, right):
    assert loop.without_strained(right) is right
    beside = moved(right, WRONG, 2.5, -1.7)
    residual = right.camera_residual.copy()
    residual[WRONG] *= 1.1 * SETTINGS.calibration.strained_residual
    found = loop.without_strained(replace(beside, camera_residual=residual))
    assert found.scene.rig.registered.tolist() == [camera != WRONG for camera in range(6)]
    assert furthest(found, right) < 0.3


def test_where_nobody_is_sure_nothing_moves(world, right):
    empty = world.detections[:0]
    loop = EvidenceLoop(empty, SETTINGS, lambda *_: None)
    assert loop.refine_once(right) is None
    assert loop.refine(right) is right


@pytest.mark.parametrize(
    ("residuals", "chosen", "done"),
    [
        ([9.0, 3.0, 2.0, 2.5], 2.0, 4),  # the given rig's own residual is no measure
        ([3.0, 2.99, 1.0], 2.99, 2),  # less than a percent: it has stopped falling
        ([3.0, 3.01, 1.0], 3.01, 2),  # and the later round counts
        ([3.0, None], 3.0, 2),
        ([5.0, 4.0, 3.0, 2.0, 1.5, 1.0], 1.5, 5),
    ],
)
def test_rounds_go_on_while_the_residual_falls(world, right, residuals, chosen, done):
    left = list(residuals)

    class Scripted(EvidenceLoop):
        def refine_once(self, calibration):
            residual = left.pop(0)
            return None if residual is None else replace(right, residual=residual)

    found = Scripted(world.detections, SETTINGS, lambda *_: None).refine(right)
    assert found.residual == chosen
    assert len(residuals) - len(left) == done
