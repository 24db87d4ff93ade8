"""Cameras of an adjustment: from a rig and back, steps and their inverses, pixels."""

import numpy as np
from hypothesis import given, settings, strategies as st

from catfree.calibration._adjusted_cameras import Cameras
from catfree.synthetic import make_layout
from tests.calibration.partial_scene import without_camera

seeds = st.integers(0, 2**31 - 1)


def test_a_rig_comes_back():
    scene, known = without_camera(make_layout("ring5", 0).scene, 2)
    rig = scene.rig
    again = Cameras.of(rig).rig(rig)
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(again, name), getattr(rig, name), atol=1e-9)
    np.testing.assert_array_equal(again.registered, known)


@given(seed=seeds)
@settings(max_examples=10)
def test_a_step_is_the_way_from_the_start(seed):
    step = 0.1 * np.random.default_rng(seed).standard_normal((4, 7))
    start = Cameras.of(make_layout("ring4", 0).rig)
    np.testing.assert_allclose(start.moved(step).away_from(start), step, atol=1e-9)


def test_pixels_are_those_of_the_pinhole():
    rig = make_layout("ring4", 0).rig
    cameras = Cameras.of(rig).moved(np.tile([0, 0, 0, 0, 0, 0, np.log(1.1)], (4, 1)))
    feet = np.random.default_rng(0).uniform([-3, -3, 0], [3, 3, 0.1], (6, 3))
    found = cameras.project_directions(feet[:, None] - cameras.center)
    moved = cameras.rig(rig)
    local = np.einsum("cij,pj->pci", moved.R, feet) + moved.t
    image = np.einsum("cij,pcj->pci", moved.K, local)
    np.testing.assert_allclose(found, image[..., :2] / image[..., 2:], rtol=1e-9)
    np.testing.assert_allclose(moved.K[:, 0, 0], 1.1 * np.asarray(rig.K)[:, 0, 0])
