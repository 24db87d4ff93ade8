"""Boxes as angles: consistent with the library's camera model, with correct derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.calibration.watching._sights import (
    FOOT_AHEAD,
    linear,
    predict_angles,
    predicted,
    sights,
)
from catfree.geometry.camera import pixels_of_points
from catfree.methods import localize
from catfree.settings import Settings
from catfree.synthetic import make_world
from catfree.types import Detections

PLACE = np.concatenate(
    [Rotation.from_euler("x", 110, degrees=True).as_matrix(), [[0.3], [1.2], [6.0]]], axis=1
)
finite = st.floats(-2, 2)
_SHIFTED = jax.jit(
    jax.vmap(
        lambda shift, state, velocity: predict_angles(
            shift[:8], state + shift[8:], velocity, jnp.asarray(PLACE)
        ),
        (0, None, None),
    )
)


@pytest.mark.slow
@given(finite, finite, st.floats(0.5, 2.2), finite, finite)
def test_derivatives_are_those_of_finite_differences(x, y, height, vx, vy):
    state, velocity = np.array([[x, y, height]]), np.array([[vx, vy]])
    value, slope = linear(state, velocity, PLACE[None])
    assert np.allclose(value, predicted(state, velocity, PLACE[None]), atol=1e-12)
    shifts = 1e-6 * np.concatenate([np.eye(11), -np.eye(11)])
    with jax.enable_x64(True):
        ends = np.asarray(_SHIFTED(*map(jnp.asarray, (shifts, state[0], velocity[0]))))
    assert np.allclose((ends[:11] - ends[11:]).T / 2e-6, slope[0], atol=1e-6)


@pytest.mark.parametrize("state", [[0.0, 0.0, 0.0], [-0.3, 6.0, 1.7]])
def test_degenerate_people_have_finite_predictions_and_derivatives(state):
    camera_at_person = np.concatenate([np.eye(3), np.zeros((3, 1))], 1)
    for place in (camera_at_person, PLACE):
        value, slope = linear(np.array([state]), np.zeros((1, 2)), place[None])
        assert np.isfinite(value).all()
        assert np.isfinite(slope).all()


@pytest.mark.slow
def test_angles_are_those_of_the_pixels_of_a_person():
    world = make_world("ring4", 3, frames=2, people=2)
    scene = world.true_scene
    person, height = np.array([1.0, -2.0]), 1.75
    center = np.asarray(scene.rig.centers)[1]
    away = (person - center[:2]) / np.linalg.norm(person - center[:2])
    points = np.array([[*person, height], [*(person - FOOT_AHEAD * height * away), 0.0]])
    pixel, imaged = pixels_of_points(scene.rig, 1, points)
    assert imaged.all()
    middle = pixel[:, 0].mean()
    box = [[middle - 20, pixel[0, 1], middle + 20, pixel[1, 1]]]
    detections = Detections([7], [1], box)
    seen = sights(scene, detections, localize(detections, scene), Settings())
    state = np.array([[*person, height]])
    expected = predicted(state, np.zeros((1, 2)), seen.place[1:2])
    # The center of the box is a mean of pixels, that of the prediction is a mean of angles.
    assert np.allclose(seen.boxes.angle, expected, atol=2e-4)
    assert seen.imaged(np.ones(len(state), int), state).all()


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-0.1, 0.1))
def test_the_origin_does_not_matter_to_a_camera_with_a_longer_lens(east, north, zoom):
    depth = np.diag([1.0, 1.0, np.exp(-zoom)])
    state, velocity = np.array([[1.0, 2.0, 1.7]]), np.array([[0.3, -0.2]])
    here = depth @ PLACE
    there = here.copy()
    there[:, 3] -= here[:, :2] @ [east, north]
    moved = state + np.array([[east, north, 0]])
    found = predicted(moved, velocity, there[None])
    np.testing.assert_allclose(found, predicted(state, velocity, here[None]), atol=1e-7)
