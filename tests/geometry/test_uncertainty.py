"""Sigma: laws, closed forms, Monte Carlo, and the public WildTrack calibration."""

import inspect
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp

from catfree import Plane, geometry
from catfree.errors import InvalidInputError

pytestmark = pytest.mark.slow

SIGMA_THETA = 0.0206
FLOOR = Plane(np.array([0.0, 0, 1]), 0.0)


@st.composite
def sightings(draw, count=4):
    """Draw a position and exact rays of cameras above it, some of them absent."""
    position = draw(hnp.arrays(np.float64, 3, elements=st.floats(-5, 5)))
    offsets = draw(hnp.arrays(np.float64, (count, 3), elements=st.floats(-10, 10)))
    weights = draw(hnp.arrays(np.float64, count, elements=st.floats(0.05, 1)))
    distance = np.linalg.norm(offsets, axis=1)
    assume((distance > 1).all())
    directions = -offsets / distance[:, None]
    # Otherwise sigma is infinite, which other tests cover.
    assume(np.linalg.eigvalsh(len(offsets) * np.eye(3) - directions.T @ directions)[0] > 1e-3)
    return position, position + offsets, directions, weights


# Compiled once per shape and dtype.
information = jax.jit(geometry.information)
ground_sigma = jax.jit(geometry.ground_sigma)
ground_covariance = jax.jit(geometry.ground_covariance)


@jax.jit
def traced_sigma(position, origins, directions, weights):
    matrix = geometry.information(position, origins, directions, weights, SIGMA_THETA)
    return geometry.ground_sigma(matrix, FLOOR)


value_and_gradient = jax.jit(jax.value_and_grad(traced_sigma, (0, 1, 2, 3)))
gradient_reverse = jax.jit(jax.jacrev(traced_sigma, (0, 1, 3)))
gradient_forward = jax.jit(jax.jacfwd(traced_sigma, (0, 1, 3)))


def sigma(*case):
    return float(traced_sigma(*case))


@given(sightings())
def test_information_is_the_printed_sum(x64, case):
    position, origins, directions, weights = case
    expected = sum(
        w / (SIGMA_THETA * np.linalg.norm(position - o)) ** 2 * (np.eye(3) - np.outer(d, d))
        for o, d, w in zip(origins, directions, weights, strict=True)
    )
    found = information(position, origins, directions, weights, SIGMA_THETA)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    inverse = np.linalg.inv(expected)[:2, :2]
    covariance = ground_covariance(found, FLOOR)
    np.testing.assert_allclose(covariance, inverse, rtol=1e-8, atol=1e-10 * np.abs(inverse).max())
    np.testing.assert_allclose(ground_sigma(found, FLOOR) ** 2, np.trace(inverse) / 2, rtol=1e-9)


@given(sightings(count=4))
def test_another_ray_never_raises_sigma(x64, case):
    position, origins, directions, weights = case
    fewer = weights.copy()
    fewer[3] = 0
    assert sigma(position, origins, directions, weights) <= sigma(
        position, origins, directions, fewer
    ) * (1 + 1e-9)


@given(sightings(), st.floats(-3, 3))
def test_sigma_scales_with_the_scene(x64, case, exponent):
    position, origins, directions, weights = case
    scale = 10**exponent
    np.testing.assert_allclose(
        sigma(scale * position, scale * origins, directions, weights),
        scale * sigma(position, origins, directions, weights),
        rtol=1e-9,
    )


@given(sightings(), st.floats(0, 7))
def test_sigma_does_not_depend_on_the_basis_of_the_plane(x64, case, angle):
    position, origins, directions, weights = case
    cosine, sine = math.cos(angle), math.sin(angle)

    class Turned(Plane):
        @property
        def basis(self):
            return FLOOR.basis @ np.array([[cosine, -sine], [sine, cosine]])

    turned = Turned(FLOOR.normal, FLOOR.offset)
    matrix = information(position, origins, directions, weights, SIGMA_THETA)
    np.testing.assert_allclose(
        geometry.ground_sigma(matrix, turned), ground_sigma(matrix, FLOOR), rtol=1e-9
    )


@given(sightings(count=3), st.permutations(range(3)))
def test_order_of_rays_and_absent_rays_do_not_matter(x64, case, order):
    position, origins, directions, weights = case
    nan = np.full((1, 3), np.nan)
    expected = sigma(position, origins, directions, weights)
    found = sigma(
        position,
        np.concatenate([origins[order], nan]),
        np.concatenate([directions[order], nan]),
        np.concatenate([weights[order], [0.0]]),
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_two_perpendicular_rays_by_hand(x64):
    # Rays along x and y from 10 m: the first fixes y and z, the second x and z.
    origins = np.array([[-10.0, 0, 0], [0, -10, 0]])
    directions = np.array([[1.0, 0, 0], [0, 1, 0]])
    matrix = geometry.information(np.zeros(3), origins, directions, np.ones(2), 0.02)
    np.testing.assert_allclose(matrix, np.diag([25, 25, 50]))
    np.testing.assert_allclose(geometry.ground_sigma(matrix, FLOOR), 0.2)
    np.testing.assert_allclose(
        geometry.ground_covariance(matrix, FLOOR), 0.04 * np.eye(2), atol=1e-15
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("directions", "weights"),
    [
        ([[1, 0, 0], [0.6, 0, 0.8]], [1, 0]),
        ([[1, 0, 0], [0.6, 0, 0.8]], [0, 0]),
        ([[0.6, 0, 0.8], [0.6, 0, 0.8]], [1, 1]),
        ([[0.6, 0, 0.8], [-0.6, 0, -0.8]], [1, 0.3]),
        ([[0.36, 0.48, 0.8], [0.36, 0.48, 0.8]], [1, 0.3]),
    ],
)
def test_one_ray_or_parallel_rays_give_infinite_sigma_and_finite_gradients(
    x64, directions, weights, dtype
):
    origins = jnp.asarray([[-3, 1, 2], [4, -2, 5]], dtype)
    directions, weights = jnp.asarray(directions, dtype), jnp.asarray(weights, dtype)
    arguments = (jnp.zeros(3, dtype), origins, directions, weights)
    value, gradients = value_and_gradient(*arguments)
    assert value == jnp.inf
    for gradient in gradients:
        assert np.isfinite(gradient).all()
    covariance = np.asarray(ground_covariance(information(*arguments, SIGMA_THETA), FLOOR))
    assert (covariance == np.diag([np.inf, np.inf])).all()


def test_a_position_at_a_camera_centre_is_finite():
    origins = jnp.array([[0.0, 0, 0], [5, 0, 1], [0, 5, 1]])
    directions = jnp.array([[1.0, 0, 0], [-1, 0, 0], [0, -1, 0]])
    found, gradients = value_and_gradient(jnp.zeros(3), origins, directions, jnp.ones(3))
    assert np.isfinite(found)
    assert np.isfinite(gradients[0]).all()


@given(sightings())
def test_gradient_agrees_with_finite_differences_in_both_modes(x64, case):
    reverse, forward = gradient_reverse(*case), gradient_forward(*case)
    for argument, a, b in zip((0, 1, 3), reverse, forward, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
        size = 1e-5
        for index in np.ndindex(case[argument].shape):
            ahead, behind = (list(case) for _ in range(2))
            for moved, step in ((ahead, size), (behind, -size)):
                moved[argument] = case[argument].copy()
                moved[argument][index] += step
            slope = (sigma(*ahead) - sigma(*behind)) / (2 * size)
            np.testing.assert_allclose(a[index], slope, rtol=1e-5, atol=1e-6 * sigma(*case))


@given(sightings(), st.sampled_from([1e-3, 1.0, 1e3]))
def test_float32_agrees_with_float64_far_from_the_origin(x64, case, scale):
    position, origins, directions, weights = case
    far = np.array([1e4, -1e4, 0]) * scale
    case32 = [
        np.float32(scale * position + far),
        np.float32(scale * origins + far),
        np.float32(directions),
        np.float32(weights),
    ]
    case64 = [np.float64(a) for a in case32]
    matrix = information(*case32, np.float32(SIGMA_THETA))
    assert matrix.dtype == jnp.float32
    plane = Plane(np.array([0, 0, 1], np.float32), np.float32(0))
    found = ground_sigma(matrix, plane)
    np.testing.assert_allclose(found, sigma(*case64), rtol=1e-3)


def test_sigma_predicts_the_error_of_noisy_rays():
    """Draw isotropic angular noise, weighted by the inverse squared distance."""
    rng = np.random.default_rng(5)
    rigs, trials, cameras, noise = 40, 4000, 4, 0.005
    sigma_of, error_of = [], []

    def trial(position, origins, directions, weights, key):
        roll = jax.random.normal(key, directions.shape) * noise
        across = roll - jnp.sum(roll * directions, axis=1, keepdims=True) * directions
        turned = directions + across
        turned = turned / jnp.linalg.norm(turned, axis=1, keepdims=True)
        found = geometry.triangulate_least_squares(origins, turned, weights)
        return jnp.sum((found - position)[:2] ** 2) / 2

    run = jax.jit(jax.vmap(trial, (None, None, None, None, 0)))
    for rig in range(rigs):
        origins = rng.uniform([-12, -12, 2], [12, 12, 5], (cameras, 3)).astype(np.float32)
        position = rng.uniform([-5, -5, 0], [5, 5, 0]).astype(np.float32)
        sight = position - origins
        distance = np.linalg.norm(sight, axis=1)
        directions = (sight / distance[:, None]).astype(np.float32)
        keys = jax.random.split(jax.random.key(rig), trials)
        squared = run(position, origins, directions, (1 / distance**2).astype(np.float32), keys)
        error_of.append(np.sqrt(np.mean(squared)))
        matrix = information(position, origins, directions, np.ones(cameras, np.float32), noise)
        sigma_of.append(float(ground_sigma(matrix, FLOOR)))
    ratio = np.array(error_of) / np.array(sigma_of)
    assert (ratio > 0.95).all()
    assert (ratio < 1.05).all()


def test_what_is_no_position_or_no_deviation_is_named():
    unchecked = inspect.unwrap(geometry.information)  # bypass the tests' shape checks
    rays = np.zeros((3, 3)), np.eye(3), np.ones(3)
    for position, deviation, message in (
        (np.ones(1), 0.01, r"position must have shape \(3,\), got \(1,\)"),
        (None, 0.01, "position: Expected numbers, got NoneType"),
        (np.ones(3), np.full(3, 0.01), r"sigma_theta must have shape \(\), got \(3,\)"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            unchecked(position, *rays, deviation)


def test_wildtrack_sigma_by_number_of_cameras(shared):
    """Compute medians over people in the area, seen by the first k cameras that can see them."""
    record = json.loads((shared / "data/real/wildtrack_0_715.json").read_text())
    K, R, t = (np.array([c[k] for c in record["cameras"]], np.float32) for k in "KRt")
    origins = -np.einsum("cji,cj->ci", R, t)
    rng = np.random.default_rng(0)
    people = np.zeros((20_000, 3), np.float32)
    people[:, :2] = rng.uniform([-3, 0], [9, 14], (len(people), 2))

    def sigma_of(person, count):
        def pixel(point):
            return jax.vmap(geometry.project, (0, 0, 0, None))(K, R, t, point)

        foot, depth = pixel(person)
        head, _ = pixel(person + jnp.array([0, 0, 1.75]))
        inside = (foot[:, 0] >= 0) & (foot[:, 0] < 1920)
        visible = inside & (head[:, 1] < 1080) & (foot[:, 1] >= 0) & (depth > 0)
        used = visible & (jnp.arange(len(K)) < count)
        sight = person[None, :] - origins
        directions = sight / jnp.linalg.norm(sight, axis=1, keepdims=True)
        matrix = geometry.information(
            person, origins, directions, used.astype(jnp.float32), SIGMA_THETA
        )
        return geometry.ground_sigma(matrix, FLOOR)

    run = jax.jit(jax.vmap(sigma_of, (0, None)))

    def median(count):
        values = np.asarray(run(people, count))
        return 100 * np.median(values[np.isfinite(values)])

    found = [median(count) for count in range(2, 8)]
    np.testing.assert_allclose(found, [76.6, 31.9, 29.2, 21.0, 19.1, 15.3], atol=1.0)
