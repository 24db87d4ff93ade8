"""The fisheye lens: OpenCV, inverse beyond 180 degrees, degenerate input."""

import cv2
import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.geometry import camera

pytestmark = pytest.mark.slow

K = np.array([[420.0, 0, 960], [0, 400, 540], [0, 0, 1]])
LENS = np.array([-0.02, 0.003, -0.001, 0.0002])

fisheye_ray = jax.jit(camera.fisheye_ray)
fisheye_pixel = jax.jit(camera.fisheye_pixel)
ray_jacobian = jax.jit(jax.jacrev(camera.fisheye_ray, 1))
pixel_jacobian = jax.jit(jax.jacrev(lambda *of: camera.fisheye_pixel(*of)[0], 1))

lenses = st.tuples(
    st.floats(-0.03, 0.05), st.floats(-0.005, 0.005), st.floats(-0.001, 0.001), st.just(0.0)
).map(np.array)
around = st.floats(0, 2 * np.pi)


def direction(angle: float, around: float) -> np.ndarray:
    aside = np.sin(angle)
    return np.array([aside * np.cos(around), aside * np.sin(around), np.cos(angle)])


@given(lenses, st.floats(0.01, 1.5), around, st.floats(0.1, 30))
def test_pixels_agree_with_opencv(x64, lens, angle, turn, distance):
    point = distance * direction(angle, turn)
    zero = np.zeros(3)
    expected = cv2.fisheye.projectPoints(point[None, None], zero, zero, K, lens)[0].reshape(2)
    pixel, imaged = fisheye_pixel(K, point, lens)
    assert imaged
    np.testing.assert_allclose(pixel, expected, atol=1e-7)


@given(lenses, st.floats(0, 1.3), around)
def test_rays_agree_with_opencv(x64, lens, angle, turn):
    pixel = np.asarray(fisheye_pixel(K, direction(angle, turn), lens)[0])
    ideal = cv2.fisheye.undistortPoints(pixel[None, None], K, lens).reshape(2)
    ray = fisheye_ray(K, pixel, lens)
    # OpenCV stops iterating at an angle of 1e-8.
    np.testing.assert_allclose(np.cross(ray, np.append(ideal, 1)), 0, atol=1e-6)


@given(lenses, st.floats(0, 1.9), around)
def test_rays_beyond_180_degrees_meet_their_pixels(x64, lens, angle, turn):
    point = direction(angle, turn)
    pixel, imaged = fisheye_pixel(K, point, lens)
    assert imaged
    np.testing.assert_allclose(fisheye_ray(K, pixel, lens), point, atol=1e-9)
    jacobian = np.asarray(pixel_jacobian(K, point, lens)) @ np.asarray(ray_jacobian(K, pixel, lens))
    np.testing.assert_allclose(jacobian, np.eye(2), atol=1e-6)


@given(around, st.floats(0.02, 0.98), st.floats(-0.3, -0.05))
def test_points_beyond_the_fold_are_not_imaged(x64, turn, share, k1):
    # The image radius a (1 + k1 a²) is largest at a² = -1 / (3 k1).
    fold = np.sqrt(-1 / (3 * k1))
    lens = np.array([k1, 0, 0, 0])
    assert fisheye_pixel(K, direction(min(share * fold, 3.1), turn), lens)[1]
    if fold / share < 3.1:
        assert not fisheye_pixel(K, direction(fold / share, turn), lens)[1]


@pytest.mark.parametrize("point", [[0, 0, 0], [0, 0, -2.0], [0, 0, 3], [1e-20, 0, 1], [5, 1, 0]])
def test_degenerate_points_have_finite_pixels_and_gradients(point):
    k, lens, point = (np.asarray(a, np.float32) for a in (K, LENS, point))
    pixel, imaged = fisheye_pixel(k, point, lens)
    assert np.isfinite(pixel).all()
    assert imaged == (point[2] > 0 or abs(point[0]) > 0)
    assert np.isfinite(pixel_jacobian(k, point, lens)).all()
    for far in (pixel, np.array([-4e3, 9e3], np.float32)):
        assert np.isfinite(fisheye_ray(k, far, lens)).all()
        assert np.isfinite(ray_jacobian(k, far, lens)).all()
