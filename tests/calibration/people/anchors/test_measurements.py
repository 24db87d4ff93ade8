"""What anchors measure: values by OpenCV, derivatives by finite differences."""

import cv2
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
)
from catfree.calibration.people.cameras._camera_model import to_matrices

pytestmark = pytest.mark.slow

FRAME = np.array([0.2, 0.7, 12.0, -3.0])


def drawn(seed):
    """A camera above the ground that looks down, and two pixels below its horizon."""
    rng = np.random.default_rng(seed)
    camera = np.concatenate([[7.0, 0.5], rng.uniform(-0.2, 0.2, 1), rng.uniform(-3, 3, 3), [4.0]])
    return camera, rng.uniform([-500, -100], [500, 350], (2, 2))


def measured(kind, pixels):
    size = {POSITION: 3, ROTATION: 3, POINT: 2}.get(kind, 1)
    return Measurement(None, kind, 0, pixels, np.zeros(size), 1.0, 1.0)


@given(st.integers(0, 10**6))
def test_points_of_the_ground_project_to_their_pixels(seed):
    camera, pixels = drawn(seed)
    moved, _ = map_cameras(camera[None], FRAME)
    K, R, t = to_matrices(moved, np.ones((1, 2), int))
    rows = [measured(POINT, pixels), measured(POINT, pixels[::-1]), measured(DISTANCE, pixels)]
    found = -linearize(rows, camera[None], FRAME)[2]
    points = np.column_stack([found[:4].reshape(2, 2), np.zeros(2)])
    again, _ = cv2.projectPoints(points, cv2.Rodrigues(R[0])[0], t[0], K[0], None)
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-6)
    apart = np.linalg.norm(points[0] - points[1])
    np.testing.assert_allclose(np.exp(found[4]), apart, rtol=1e-9)


@settings(max_examples=5)
@given(st.integers(0, 10**6), st.integers(0, len(QUANTITIES) - 1))
def test_derivatives_are_finite_differences(seed, kind):
    camera, pixels = drawn(seed)
    slopes, (noise,), _ = linearize([measured(kind, pixels)], camera[None], FRAME)

    def value(change):
        rows = [measured(kind, pixels + change[11:].reshape(2, 2))]
        return -linearize(rows, (camera + change[:7])[None], FRAME + change[7:11])[2]

    exact = np.stack([(value(d) - value(-d)) / 2e-5 for d in 1e-5 * np.eye(15)], -1)
    np.testing.assert_allclose(slopes, exact[:, :11], atol=1e-5, rtol=1e-5)
    by_pixel = exact[:, 11:]
    expected = np.eye(len(noise)) + by_pixel @ by_pixel.T
    np.testing.assert_allclose(noise, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", range(len(QUANTITIES)))
def test_values_and_derivatives_are_finite_above_the_horizon(kind):
    camera, _ = drawn(0)
    rows = [measured(kind, pixels) for pixels in (np.full((2, 2), -1e4), np.zeros((2, 2)))]
    slopes, noise, off = linearize(rows, camera[None], FRAME)
    for array in (slopes, *noise, off):
        assert np.isfinite(array).all()
