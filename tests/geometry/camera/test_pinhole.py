"""The pinhole camera and its lens: OpenCV, inverse, derivatives, degenerate input."""

import inspect

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp

from catfree import geometry
from catfree.errors import InvalidInputError
from catfree.geometry import camera
from catfree.types import Plane

K = np.array([[1400.0, 0, 960], [0, 1350, 540], [0, 0, 1]])
WIDE_LENS = np.array([-0.30, 0.11, 0.001, -0.0008, -0.015])
RATIONAL_LENS = np.array([0.5, 0.1, 0.001, -0.0008, 0.01, 0.8, 0.2, 0.03])

# Compiled once: an eager call would trace its inner loops again for each example.
project = jax.jit(geometry.project)
back_project = jax.jit(geometry.back_project)
undistort = jax.jit(geometry.undistort)
undistort_jacobian = jax.jit(jax.jacrev(geometry.undistort))
project_jacobian = jax.jit(jax.jacrev(geometry.project, 3))
back_project_jacobian = jax.jit(jax.jacrev(geometry.back_project, 1))
distort_jacobian = jax.jit(jax.jacfwd(geometry.distort))
pinhole_ray = jax.jit(camera.pinhole_ray)
pinhole_pixel = jax.jit(camera.pinhole_pixel)
project_slopes = jax.jit(jax.jacfwd(lambda *of: geometry.project(*of)[0], 3))
pixel_jacobian = jax.jit(jax.jacrev(lambda *of: camera.pinhole_pixel(*of)[0], 1))

rotation_vectors = hnp.arrays(np.float64, 3, elements=st.floats(-3, 3))
positions = hnp.arrays(np.float64, 3, elements=st.floats(-20, 20))
pixels = st.tuples(st.floats(0, 1919), st.floats(0, 1079)).map(np.array)
five = (
    st.floats(-0.3, 0.3),
    st.floats(0, 0.1),
    st.floats(-0.005, 0.005),
    st.floats(-0.005, 0.005),
    st.floats(-0.01, 0.01),
)
lenses = st.tuples(*five).map(np.array)
rational = st.tuples(*five, st.floats(0, 0.3), st.floats(0, 0.1), st.floats(0, 0.02)).map(np.array)


def rotation(vector: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(vector)[0]


@pytest.mark.slow
@given(pixels, lenses | rational)
def test_the_ray_of_a_pixel_meets_it_again(x64, pixel, lens):
    ray = pinhole_ray(K, pixel, lens)
    np.testing.assert_allclose(np.linalg.norm(ray), 1, atol=1e-14)
    again, imaged = pinhole_pixel(K, 3 * ray, lens)
    assert imaged
    np.testing.assert_allclose(again, pixel, atol=1e-7)


@pytest.mark.slow
@given(st.floats(0, 2 * np.pi), st.floats(0.02, 0.99), st.floats(-0.4, -0.05))
def test_points_beyond_the_fold_of_a_lens_are_not_imaged(x64, around, share, k1):
    # The image radius r (1 + k1 r²) is largest at r² = -1 / (3 k1).
    lens = np.array([k1, 0, 0, 0, 0])
    fold = np.sqrt(-1 / (3 * k1))
    sideways = np.array([np.cos(around), np.sin(around)])
    for radius, expected in ((share * fold, True), (fold / share, False)):
        assert pinhole_pixel(K, np.append(radius * sideways, 1), lens)[1] == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    "lens", [None, WIDE_LENS, RATIONAL_LENS, np.array([0, 0, 0, 0, 0, -1.0, 0, 0])]
)
@pytest.mark.parametrize("point", [[0, 0, 0], [0, 0, -2.0], [1e-20, 0, 0], [5, 1, 0], [1, 0, 1]])
def test_pixels_of_degenerate_points_are_finite_with_finite_gradient(lens, point):
    k, point = K.astype(np.float32), np.array(point, np.float32)
    lens = None if lens is None else lens.astype(np.float32)
    pixel, imaged = pinhole_pixel(k, point, lens)
    assert np.isfinite(pixel).all()
    assert not imaged or point[2] > 0
    assert np.isfinite(pixel_jacobian(k, point, lens)).all()


@pytest.mark.slow
@given(rotation_vectors, positions, positions, lenses | rational)
def test_projection_agrees_with_opencv(x64, turn, t, point, lens):
    R = rotation(turn)
    in_camera = R @ point + t
    assume(in_camera[2] > 0.3 * np.linalg.norm(in_camera) + 0.1)
    expected = cv2.projectPoints(point[None], turn, t, K, lens)[0].reshape(2)
    found, depth = project(K, R, t, point, lens)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(depth, in_camera[2])


@pytest.mark.slow
@pytest.mark.parametrize("lens", [WIDE_LENS, RATIONAL_LENS])
@given(pixel=pixels)
def test_undistortion_agrees_with_opencv(x64, lens, pixel):
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    # OpenCV 5 merged the iterative function into the plain one.
    opencv = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    expected = opencv(
        pixel.reshape(1, 1, 2), K, lens, R=np.eye(3), P=np.eye(3), criteria=criteria
    ).reshape(2)
    np.testing.assert_allclose(back_project(K, pixel, lens), expected, atol=1e-9)


@pytest.mark.slow
@given(pixels)
def test_undistortion_differentiates_as_the_inverse(x64, pixel):
    jacobian = np.asarray(back_project_jacobian(K, pixel, WIDE_LENS))
    ideal = back_project(K, pixel, WIDE_LENS)
    forward = K[:2, :2] @ np.asarray(distort_jacobian(ideal, WIDE_LENS))
    np.testing.assert_allclose(jacobian @ forward, np.eye(2), atol=1e-8)


@pytest.mark.slow
@given(hnp.arrays(np.float64, 2, elements=st.floats(-50, 50)), lenses | rational)
def test_undistortion_stays_finite_far_outside_the_image(point, lens):
    point, lens = point.astype(np.float32), lens.astype(np.float32)
    value = undistort(point, lens)
    gradient = undistort_jacobian(point, lens)
    assert np.isfinite(value).all()
    assert np.isfinite(gradient).all()


@pytest.mark.slow
@pytest.mark.parametrize("point", [[0, 0, 0], [0, 0, -2.0], [1e-20, 0, 0], [5, 1, 0], [1, 0, 1e-9]])
def test_points_beside_and_behind_a_camera_project_to_something_finite(point):
    point = jnp.asarray(point, jnp.float32)
    k, lens = K.astype(np.float32), WIDE_LENS.astype(np.float32)
    one, zero = np.eye(3, dtype=np.float32), np.zeros(3, np.float32)
    pixel, depth = project(k, one, zero, point, lens)
    assert np.isfinite(pixel).all()
    assert depth == point[2]
    jacobian, _ = project_jacobian(k, one, zero, point, lens)
    assert np.isfinite(jacobian).all()


@given(st.floats(-6, 0), st.floats(-3.2, 3.2), st.floats(0.1, 100))
def test_points_beside_a_camera_are_outside_its_image_with_finite_slopes(exponent, turn, distance):
    """Half a sphere of points, in which most are near the plane of the camera."""
    depth = 10**exponent
    beside = np.sqrt(1 - depth**2) * np.array([np.cos(turn), np.sin(turn)])
    point = (distance * np.array([*beside, depth])).astype(np.float32)
    one, zero = np.eye(3, dtype=np.float32), np.zeros(3, np.float32)
    (x, y), _ = project(one, one, zero, point)
    assert np.hypot(x, y) >= (1 - 1e-3) * min(np.hypot(*beside) / depth, 99)
    kinect = np.array([8.5, 3.2, 0, 0, 0.1, 8.9, 6.1, 0.9], np.float32)
    assert np.isfinite(project_slopes(one, one, zero, point, kinect)).all()


@pytest.mark.parametrize("count", [4, 6, 12])
def test_a_lens_with_another_number_of_coefficients_is_refused(count):
    unchecked = inspect.unwrap(camera.distort)  # as without type checks
    with pytest.raises(InvalidInputError, match="k1, k2, p1, p2, k3"):
        unchecked(np.array([0.3, 0.2]), np.zeros(count))


def test_undistortion_reads_lists_and_either_byte_order():
    point, lens = np.array([0.1, 0.2], np.float32), WIDE_LENS.astype(np.float32)
    wanted = geometry.undistort(point, lens)
    assert (geometry.undistort(point.astype(">f4"), lens.astype(">f4")) == wanted).all()
    plain = inspect.unwrap(geometry.undistort)  # bypass the tests' type checks
    np.testing.assert_allclose(plain(point.tolist(), lens.tolist()), wanted, rtol=1e-6)


def test_several_cameras_at_once_are_refused():
    point, pixel, many = np.ones(3), np.ones(2), np.tile(np.eye(3), (2, 1, 1))
    for name, arguments, matrix in (
        ("back_project", (many, pixel), "K"),
        ("project", (many, np.eye(3), point, point), "K"),
        ("project", (np.eye(3), many, point, point), "R"),
        ("pixel_to_ray", (np.eye(3), many, point, pixel), "R"),
    ):
        unchecked = inspect.unwrap(getattr(geometry, name))
        with pytest.raises(InvalidInputError, match=rf"{matrix} must have shape \(3, 3\)"):
            unchecked(*arguments)
    for name, arguments in (
        ("nearest_rotation", (many,)),
        ("ground_sigma", (many, Plane(np.array([0.0, 0, 1]), 0.0))),
    ):
        with pytest.raises(InvalidInputError, match=r"must have shape .*, got \(2, 3, 3\)"):
            inspect.unwrap(getattr(geometry, name))(*arguments)
