"""Rays: pixel to world and back, angles, and ray weights."""

import inspect
import math

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp

from catfree import geometry
from catfree.errors import InvalidInputError

K = np.array([[1400.0, 0, 960], [0, 1350, 540], [0, 0, 1]])

# Compiled once: an eager call would trace its inner loops again for each example.
pixel_to_ray = jax.jit(geometry.pixel_to_ray)
project = jax.jit(geometry.project)
angular_residual = jax.jit(geometry.angular_residual)
angular_residual_gradient = jax.jit(jax.value_and_grad(geometry.angular_residual))

rotation_vectors = hnp.arrays(np.float64, 3, elements=st.floats(-3, 3))
positions = hnp.arrays(np.float64, 3, elements=st.floats(-20, 20))
pixels = st.tuples(st.floats(0, 1919), st.floats(0, 1079)).map(np.array)
lenses = st.tuples(
    st.floats(-0.3, 0.3),
    st.floats(0, 0.1),
    st.floats(-0.005, 0.005),
    st.floats(-0.005, 0.005),
    st.floats(-0.01, 0.01),
).map(np.array)


def rotation(vector: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(vector)[0]


@pytest.mark.slow
@given(rotation_vectors, positions, pixels, lenses, st.floats(0.5, 50))
def test_projecting_a_point_of_the_ray_gives_the_pixel(x64, turn, t, pixel, lens, depth):
    R = rotation(turn)
    origin, direction = pixel_to_ray(K, R, t, pixel, lens)
    found, found_depth = project(K, R, t, origin + depth * direction, lens)
    np.testing.assert_allclose(found, pixel, atol=1e-7)
    assert found_depth > 0
    np.testing.assert_allclose(R @ np.asarray(origin) + t, 0, atol=1e-12 * (1 + np.abs(t).max()))
    np.testing.assert_allclose(np.linalg.norm(direction), 1, atol=1e-14)


@given(hnp.arrays(np.float32, 3, elements=st.floats(-1, 1, width=32)), st.integers(-36, 36))
def test_the_gradient_of_an_angle_is_right_at_any_scale(position, exponent):
    assume(np.linalg.norm(position) > 0.1)
    scale = np.float32(10.0**exponent)
    center, direction = np.zeros(3, np.float32), np.array([0.6, 0.0, 0.8], np.float32)
    angle, gradient = angular_residual_gradient(position, center, direction)
    found, scaled = angular_residual_gradient(scale * position, center, direction)
    np.testing.assert_allclose(found, angle, atol=1e-5)
    np.testing.assert_allclose(scale * scaled, gradient, rtol=1e-3, atol=1e-3)


@given(positions, hnp.arrays(np.float64, 3, elements=st.floats(-1, 1)), st.floats(0, math.pi))
def test_angular_residual_is_the_angle_between_the_directions(x64, origin, direction, angle):
    assume(np.linalg.norm(direction) > 0.1)
    direction = direction / np.linalg.norm(direction)
    sideways = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    sideways /= np.linalg.norm(sideways)
    point = origin + 7 * (math.cos(angle) * direction + math.sin(angle) * sideways)
    found = angular_residual(point, origin, direction)
    np.testing.assert_allclose(found, angle, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [1e-5, 1e-4, 1e-3, 0.02, math.pi - 1e-4])
def test_small_angles_keep_their_digits_in_float32_where_the_arccosine_loses_them(angle):
    direction = np.array([0.6, 0, 0.8], np.float32)
    sideways = np.array([0.8, 0, -0.6])
    point = 12 * (math.cos(angle) * direction.astype(float) + math.sin(angle) * sideways)
    found, gradient = angular_residual_gradient(
        point.astype(np.float32), np.zeros(3, np.float32), direction
    )
    assert abs(float(found) - angle) < 3e-7
    assert np.isfinite(gradient).all()


@pytest.mark.slow
def test_a_position_at_the_camera_centre_is_at_a_right_angle_with_zero_gradient():
    origin, direction = jnp.array([1.0, 2, 3]), jnp.array([0.0, 0, 1])
    assert geometry.angular_residual(origin, origin, direction) == np.float32(math.pi / 2)
    gradients = jax.grad(geometry.angular_residual, (0, 1, 2))(origin, origin, direction)
    assert all((np.asarray(g) == 0).all() for g in gradients)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_position_on_the_line_has_a_finite_gradient(sign):
    direction = jnp.array([0.0, 0, 1])
    position = jnp.array([0.0, 0, sign * 4.0])
    value, gradient = angular_residual_gradient(position, jnp.zeros(3), direction)
    np.testing.assert_allclose(value, 0 if sign > 0 else math.pi, rtol=1e-6)
    assert np.isfinite(gradient).all()


@pytest.mark.slow
def test_ray_weights_by_hand():
    assert geometry.height_weight(50.0, 100.0) == 0.25
    assert geometry.height_weight(200.0, 100.0) == 1
    assert geometry.height_weight(50.0, 0.0) == 1
    assert geometry.height_weight(50.0, math.nan) == 1
    assert geometry.pose_ratio(0.01, 0.02) == 0.25
    assert geometry.pose_ratio(0.02, 0.01) == 1
    for pose, other in ((0.01, 0.0), (math.nan, 0.01), (0.01, math.nan), (0.0, 0.0)):
        assert geometry.pose_ratio(pose, other) == 1
    assert geometry.ray_weight(50.0, 100.0, True, 0.5) == 0.25
    assert geometry.ray_weight(50.0, 100.0, False, 0.5) == 0.125
    assert geometry.ray_weight(0.0, 100.0, False, 0.5) == np.float32(1e-4)


@pytest.mark.slow
@given(st.floats(0, 1e4), st.floats(0, 1e4), st.booleans(), st.floats(0, 1))
def test_ray_weight_lies_between_its_floor_and_one(height, median, confirmed, ratio):
    weight = geometry.ray_weight(height, median, confirmed, ratio)
    assert np.float32(1e-4) <= weight <= 1
    assert weight <= geometry.ray_weight(height, median, True, ratio)


@pytest.mark.slow
def test_gradients_of_ray_weights_are_finite_where_medians_are_missing():
    for median in (0.0, math.nan):
        assert jnp.isfinite(jax.grad(geometry.height_weight)(50.0, median))
        assert jnp.isfinite(jax.grad(geometry.pose_ratio)(0.01, median))
        assert jnp.isfinite(jax.grad(geometry.pose_ratio)(median, 0.01))


@pytest.mark.parametrize("ankles", [None, "yes", 0.5])
def test_ankles_are_confirmed_or_not(ankles):
    with pytest.raises(InvalidInputError, match="ankles_confirmed"):
        inspect.unwrap(geometry.ray_weight)(10.0, 10.0, ankles, 0.5)


def test_a_wrong_shape_is_refused_under_the_import_hook():
    with pytest.raises(Exception, match="Type-check error"):
        geometry.angular_residual(np.zeros(2), np.zeros(3), np.zeros(3))


def test_under_jit_too():
    def wrong(x):
        return geometry.angular_residual(x, x, x)

    with pytest.raises(Exception, match="Type-check error"):
        jax.jit(wrong)(jnp.zeros(4))


@pytest.mark.parametrize("kind", [">f4", ">f8", np.float16])
def test_floats_of_other_widths_and_byte_orders_count_in_a_width_that_jax_has(kind):
    position, origin, direction = np.array([[1, 2, 4], [0, 1, 0], [0, 0.6, 0.8]])
    angle = geometry.angular_residual(position.astype(kind), origin, direction.astype(np.float32))
    assert angle.dtype == jnp.float32
    assert angle == geometry.angular_residual(position, origin, direction)
    plane = geometry.fit_plane(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], kind))
    np.testing.assert_allclose(np.abs(plane.normal), [0, 0, 1], atol=1e-6)
