"""Cameras after an adjustment step, and their pixels."""

import numpy as np

from catfree.calibration._adjusted_cameras import moved_rig
from catfree.calibration._bundle_adjustment import project_directions
from catfree.synthetic import make_layout
from tests.calibration.partial_scene import without_camera


def test_a_rig_that_takes_no_step_stays():
    scene, known = without_camera(make_layout("ring5", 0).scene, 2)
    rig = scene.rig
    again = moved_rig(rig, np.zeros((5, 7)))
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(again, name), getattr(rig, name), atol=1e-9)
    np.testing.assert_array_equal(again.registered, known)


def test_a_step_turns_shifts_and_zooms():
    rig = make_layout("ring4", 0).rig
    step = np.zeros((4, 7))
    step[1] = [0, 0, np.pi / 2, 1, 2, 3, np.log(1.1)]
    moved = moved_rig(rig, step)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(moved.R[1], turn @ rig.R[1], atol=1e-12)
    np.testing.assert_allclose(moved.centers - rig.centers, step[:, 3:6], atol=1e-9)
    np.testing.assert_allclose(np.asarray(moved.K)[:, 0, 0], rig.K[:, 0, 0] * [1, 1.1, 1, 1])


def test_pixels_are_those_of_the_pinhole():
    rig = make_layout("ring4", 0).rig
    feet = np.random.default_rng(0).uniform([-3, -3, 0], [3, 3, 0.1], (6, 3))
    found = project_directions(rig, feet[:, None] - rig.centers)
    local = np.einsum("cij,pj->pci", rig.R, feet) + rig.t
    image = np.einsum("cij,pcj->pci", rig.K, local)
    np.testing.assert_allclose(found, image[..., :2] / image[..., 2:], rtol=1e-9)
