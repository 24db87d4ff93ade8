"""Measurements of anchors: values against OpenCV, derivatives against finite differences."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people.anchors._measurements import (
    DISTANCE,
    POINT,
    POSITION,
    QUANTITIES,
    ROTATION,
    Measurement,
    linearize,
    map_cameras,
    stack,
)
from catfree.calibration.people.cameras._camera_model import to_matrices

pytestmark = pytest.mark.slow

FRAME = np.array([0.2, 0.7, 12.0, -3.0])


def drawn(seed):
    """Draw a camera above the ground that looks down, and two pixels below its horizon."""
    rng = np.random.default_rng(seed)
    camera = np.concatenate([[7.0, 0.5], rng.uniform(-0.2, 0.2, 1), rng.uniform(-3, 3, 3), [4.0]])
    return camera, rng.uniform([-500, -100], [500, 350], (2, 2))


def compared(rows, camera, frame):
    """Return derivatives, noise and differences of the stated numbers."""
    with jax.enable_x64(True):
        found = linearize(stack(rows), jnp.asarray(camera[None]), jnp.asarray(frame))
    sizes = [len(m.value) for m in rows]
    return tuple(
        [array[i, :size] for i, size in enumerate(sizes)] for array in map(np.asarray, found)
    )


def predicted(rows, camera, frame):
    return -np.concatenate(compared(rows, camera, frame)[2])


def measured(kind, pixels):
    size = {POSITION: 3, ROTATION: 3, POINT: 2}.get(kind, 1)
    return Measurement(None, kind, 0, pixels, np.zeros(size), 1.0, 1.0)


@given(st.integers(0, 10**6))
def test_points_of_the_ground_project_to_their_pixels(seed):
    camera, pixels = drawn(seed)
    moved, _ = map_cameras(camera[None], FRAME)
    K, R, t = to_matrices(moved, np.ones((1, 2), int))
    rows = [measured(POINT, pixels), measured(POINT, pixels[::-1]), measured(DISTANCE, pixels)]
    found = predicted(rows, camera, FRAME)
    points = np.column_stack([found[:4].reshape(2, 2), np.zeros(2)])
    again, _ = cv2.projectPoints(points, cv2.Rodrigues(R[0])[0], t[0], K[0], None)
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-6)
    apart = np.linalg.norm(points[0] - points[1])
    np.testing.assert_allclose(np.exp(found[4]), apart, rtol=1e-9)


@settings(max_examples=5)
@given(st.integers(0, 10**6), st.integers(0, len(QUANTITIES) - 1))
def test_derivatives_are_finite_differences(seed, kind):
    camera, pixels = drawn(seed)
    (slopes,), (noise,), _ = compared([measured(kind, pixels)], camera, FRAME)
    size = len(slopes)
    noise = noise[:, :size]

    def value(change):
        rows = [measured(kind, pixels + change[11:].reshape(2, 2))]
        return predicted(rows, camera + change[:7], FRAME + change[7:11])

    exact = np.stack([(value(d) - value(-d)) / 2e-5 for d in 1e-5 * np.eye(15)], -1)
    np.testing.assert_allclose(slopes, exact[:, :11], atol=1e-5, rtol=1e-5)
    by_pixel = exact[:, 11:]
    expected = np.eye(len(noise)) + by_pixel @ by_pixel.T
    np.testing.assert_allclose(noise, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", range(len(QUANTITIES)))
def test_values_and_derivatives_are_finite_above_the_horizon(kind):
    camera, _ = drawn(0)
    rows = [measured(kind, pixels) for pixels in (np.full((2, 2), -1e4), np.zeros((2, 2)))]
    for arrays in compared(rows, camera, FRAME):
        for array in arrays:
            assert np.isfinite(array).all()


def test_absent_rows_and_numbers_are_zero():
    camera, pixels = drawn(0)
    with jax.enable_x64(True):
        stated = stack([measured(POINT, pixels)])
        found = linearize(stated, jnp.asarray(camera[None]), jnp.asarray(FRAME))
    assert np.asarray(stated.present).sum() == 2
    for array in map(np.asarray, found):
        assert array[0, :2].any()
        assert not array[0, 2].any()
        assert not array[1:].any()
