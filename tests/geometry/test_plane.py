"""Planes: distances, intersections, least-squares fits and RANSAC."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from catfree import Plane, geometry
from catfree.errors import DegenerateGeometryError, InsufficientDataError, InvalidInputError
from catfree.geometry import Similarity

points3 = hnp.arrays(np.float64, 3, elements=st.floats(-10, 10))
units = hnp.arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(
    lambda v: np.linalg.norm(v) > 0.1
)

intersect = jax.jit(geometry.intersect_ray)
intersect_jacobian = jax.jit(jax.jacrev(geometry.intersect_ray, 2, has_aux=True))
fit = jax.jit(geometry.fit_plane)


def normal_and_offset(points, weights):
    plane = geometry.fit_plane(points, weights, toward=jnp.array([0.0, 0, 50]))
    return jnp.concatenate([plane.normal, plane.offset[None]])


fit_reverse = jax.jit(jax.jacrev(normal_and_offset, (0, 1)))
fit_forward = jax.jit(jax.jacfwd(normal_and_offset, (0, 1)))
fit_value = jax.jit(normal_and_offset)


@given(units, st.floats(-5, 5), points3)
def test_distance_is_that_to_the_projection(x64, normal, offset, point):
    plane = Plane(normal, offset)
    found = geometry.plane_distance(plane, point)
    np.testing.assert_allclose(found, np.linalg.norm(point - plane.project(point)), atol=1e-12)
    assert found >= 0


@given(units, st.floats(-5, 5), points3, units)
def test_a_valid_intersection_lies_on_plane_and_ray(x64, normal, offset, origin, direction):
    plane = Plane(normal, offset)
    direction = direction / np.linalg.norm(direction)
    slope = plane.normal @ direction
    assume(abs(slope) > 1e-3)
    position, valid = intersect(plane, origin, direction)
    assert valid == (-plane.signed_distance(origin) / slope >= 0)
    np.testing.assert_allclose(plane.signed_distance(np.asarray(position)), 0, atol=1e-9)
    if valid:
        np.testing.assert_allclose(np.cross(position - origin, direction), 0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [[1.0, 0, 0], [0.0, 0, 1], [1, 0, 1e-30]])
def test_rays_that_miss_the_plane_are_finite_and_invalid(direction):
    floor = Plane(np.array([0, 0, 1], np.float32), np.float32(0))
    origin = jnp.array([1.0, 2, 3])
    position, valid = intersect(floor, origin, jnp.asarray(direction))
    assert not valid
    np.testing.assert_array_equal(position, [1, 2, 0])
    jacobian, _ = intersect_jacobian(floor, origin, jnp.asarray(direction))
    assert np.isfinite(jacobian).all()


@st.composite
def clouds(draw, count=8):
    """Draw points near a floor-like plane, thin in only one direction."""
    flat = draw(hnp.arrays(np.float64, (count, 2), elements=st.floats(-5, 5)))
    height = draw(hnp.arrays(np.float64, count, elements=st.floats(-0.3, 0.3)))
    weights = draw(hnp.arrays(np.float64, count, elements=st.floats(0.1, 1)))
    points = np.column_stack([flat, height])
    offsets = points - weights @ points / weights.sum()
    values = np.linalg.eigvalsh(offsets.T @ (weights[:, None] * offsets))
    assume(values[1] > 3 * values[0] + 0.5)
    assume(values[0] > 1e-6)
    return points, weights


@pytest.mark.slow
@given(clouds())
def test_fit_is_the_smallest_principal_axis(x64, cloud):
    points, weights = cloud
    plane = fit(points, weights)
    mean = weights @ points / weights.sum()
    offsets = points - mean
    values, vectors = np.linalg.eigh(offsets.T @ (weights[:, None] * offsets))
    np.testing.assert_allclose(abs(plane.normal @ vectors[:, 0]), 1, atol=1e-10)
    np.testing.assert_allclose(plane.signed_distance(mean), 0, atol=1e-10)
    residual = weights @ np.asarray(plane.signed_distance(points)) ** 2
    np.testing.assert_allclose(residual, values[0], rtol=1e-6, atol=1e-12)


@pytest.mark.slow
@given(clouds(count=5))
def test_fit_differentiates(x64, cloud):
    reverse, forward = fit_reverse(*cloud), fit_forward(*cloud)
    size = 1e-6
    for argument in range(2):
        np.testing.assert_allclose(forward[argument], reverse[argument], atol=1e-9)
        for index in np.ndindex(cloud[argument].shape):
            sides = []
            for step in (size, -size):
                moved = [a.copy() for a in cloud]
                moved[argument][index] += step
                sides.append(np.asarray(fit_value(*moved)))
            slope = (sides[0] - sides[1]) / (2 * size)
            at = (slice(None), *index)
            np.testing.assert_allclose(
                reverse[argument][at], slope, atol=1e-5 * (1 + np.abs(slope).max())
            )


@pytest.mark.slow
@given(clouds())
def test_absent_points_do_not_count(x64, cloud):
    points, weights = cloud
    padded = np.concatenate([points, np.full((1, 3), np.nan)])
    more = np.append(weights, 0.0)
    np.testing.assert_allclose(fit_value(padded, more), fit_value(points, weights), atol=1e-12)
    assert (np.asarray(fit_reverse(padded, more)[0][:, -1]) == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "points",
    [np.zeros((4, 3)), np.outer(np.arange(4.0), [1, 2, 3]), np.eye(4, 3), np.full((4, 3), 1e4)],
)
def test_points_without_a_plane_give_finite_values_and_gradients(points):
    points = points.astype(np.float32)
    assert np.isfinite(fit_value(points, np.ones(4, np.float32))).all()
    assert np.isfinite(fit_value(points, np.zeros(4, np.float32))).all()
    for jacobian in fit_reverse(points, np.ones(4, np.float32)):
        assert np.isfinite(jacobian).all()


def scene_cloud(rng, floor=300, clutter=200):
    """Draw a floor with 2 cm of noise, and clutter up to 3 m above it."""
    ground = np.column_stack([rng.uniform(-8, 8, (floor, 2)), rng.normal(0, 0.02, floor)])
    above = rng.uniform([-8, -8, 0.3], [8, 8, 3], (clutter, 3))
    return np.concatenate([ground, above])


@pytest.mark.slow
@given(
    st.integers(0, 20),
    hnp.arrays(np.float64, 6, elements=st.floats(-3, 3)),
    st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_ransac_finds_the_floor_wherever_the_scene_is_moved(x64, seed, motion, scale):
    cloud = scene_cloud(np.random.default_rng(seed))
    rotation = Rotation.from_rotvec(motion[:3]).as_matrix()
    move = Similarity(scale, rotation, 10 * scale * motion[3:])
    key = jax.random.key(seed)
    found = geometry.fit_plane_ransac(cloud, key)
    moved = geometry.fit_plane_ransac(move(cloud), key)
    # Points are above the floor, so the normal points up.
    assert found.plane.normal[2] > np.cos(np.radians(0.3))
    assert abs(found.plane.offset) < 0.03
    assert found.inliers[:300].mean() > 0.95
    np.testing.assert_allclose(moved.plane.normal, rotation @ found.plane.normal, atol=1e-8)
    np.testing.assert_array_equal(moved.inliers, found.inliers)
    expected = geometry.transform_plane(move, found.plane)
    np.testing.assert_allclose(moved.plane.offset, expected.offset, atol=1e-7 * scale)


@pytest.mark.slow
def test_ransac_prefers_the_floor_to_clutter_with_a_given_threshold_and_orientation(x64):
    cloud = scene_cloud(np.random.default_rng(0), floor=60, clutter=300)
    found = geometry.fit_plane_ransac(
        cloud, jax.random.key(1), threshold=0.06, iterations=2000, toward=np.array([0, 0, -9.0])
    )
    assert found.plane.normal[2] < -np.cos(np.radians(1))
    distances = np.abs(np.asarray(found.plane.signed_distance(cloud)))
    np.testing.assert_array_equal(found.inliers, distances <= 0.06)


@pytest.mark.slow
def test_ransac_ignores_points_that_are_masked_out():
    cloud = scene_cloud(np.random.default_rng(0)).astype(np.float32)
    mask = np.ones(len(cloud), bool)
    mask[::3] = False
    cloud[~mask] = np.nan
    found = geometry.fit_plane_ransac(cloud, jax.random.key(0), where=mask)
    assert found.plane.normal[2] > 0.9999
    assert found.plane.normal.dtype == jnp.float32
    assert not found.inliers[~mask].any()


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_traced_ransac_of_too_few_points_is_finite(count):
    points = np.arange(12, dtype=np.float32).reshape(4, 3) ** 2
    found = jax.jit(geometry.fit_plane_ransac)(
        points, jax.random.key(0), where=np.arange(4) < count
    )
    assert np.isfinite(found.plane.normal).all()
    assert np.isfinite(found.plane.offset)
    assert found.inliers.sum() <= count


@pytest.mark.slow
def test_ransac_leaves_out_points_that_are_not_finite():
    rng = np.random.default_rng(0)
    ground = np.c_[rng.uniform(-5, 5, (50, 2)), np.zeros(50)]
    holes = ground[:6].copy()
    holes[:3, 0], holes[3:, 2] = np.nan, np.inf
    found = geometry.fit_plane_ransac(np.r_[ground, holes], jax.random.key(0))
    np.testing.assert_allclose(np.abs(found.plane.normal), [0, 0, 1], atol=1e-6)
    np.testing.assert_array_equal(found.inliers, np.arange(56) < 50)


def test_lists_of_points_are_points():
    floor, key = [[0, 0, 2], [5, 0, 2], [0, 5, 2], [5, 5, 2]], jax.random.key(0)
    # Bypass the tests' type checks.
    fit, ransac = (inspect.unwrap(f) for f in (geometry.fit_plane, geometry.fit_plane_ransac))
    for plane in (fit(floor), fit(floor, [1, 1, 1, 0]), ransac(floor, key).plane):
        np.testing.assert_allclose(np.abs(plane.normal), [0, 0, 1], atol=1e-6)
        assert float(plane.signed_distance(np.array([0.0, 0, 2]))) == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (geometry.plane_distance, (None, np.zeros(3))),
        (geometry.intersect_ray, (None, np.zeros(3), np.ones(3))),
        (geometry.ground_covariance, (np.eye(3), None)),
        (geometry.ground_sigma, (np.eye(3), None)),
    ],
)
def test_what_is_not_a_plane_is_told_so(function, arguments):
    unchecked = inspect.unwrap(function)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match="plane must be a Plane, got NoneType"):
        unchecked(*arguments)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_ransac_of_fewer_than_three_points_is_one_error(count):
    cloud = np.random.default_rng(0).normal(size=(9, 3))
    holes = np.where((np.arange(9) < count)[:, None], cloud, np.nan)
    for points, where in ((cloud[: count + 1], np.arange(count + 1) > 0), (holes, None)):
        with pytest.raises(InsufficientDataError, match=f"needs 3 points, but {count} of them"):
            geometry.fit_plane_ransac(points, jax.random.key(0), where=where)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@given(
    hnp.arrays(np.float64, (2, 3), elements=st.floats(-1e3, 1e3)),
    hnp.arrays(np.float64, st.integers(3, 40), elements=st.floats(-9, 9)),
)
def test_ransac_of_points_on_a_line_is_one_error(dtype, line, along):
    points = (line[0] + along[:, None] * line[1]).astype(dtype)
    with pytest.raises(DegenerateGeometryError, match=f"The {len(along)} points leave the plane"):
        geometry.fit_plane_ransac(points, jax.random.key(0))


def test_ransac_without_points_is_one_error():
    with pytest.raises(InsufficientDataError, match="3 points"):
        geometry.fit_plane_ransac(np.zeros((0, 3)), jax.random.key(0))


def test_arguments_of_a_fit_that_would_broadcast_or_fit_nothing_are_refused():
    cloud, key = np.random.default_rng(0).normal(size=(9, 3)), jax.random.key(0)
    fit, ransac = (inspect.unwrap(f) for f in (geometry.fit_plane, geometry.fit_plane_ransac))
    for use, message in (
        (lambda: fit(cloud[:, :2]), "points must have shape"),
        (lambda: fit(cloud, np.ones(1)), "weights must have shape"),
        (lambda: fit(cloud, toward=cloud), "toward must have shape"),
        (lambda: ransac(cloud, key, where=np.ones(1, bool)), "where must have shape"),
        (lambda: ransac(cloud, key, iterations=0), "iterations is 0; it must be 1 or more"),
        (lambda: ransac(cloud, key, threshold=-1.0), "threshold is -1.0; it must be a length"),
        (lambda: ransac(cloud, key, threshold=np.zeros(2)), "threshold must have shape"),
        (lambda: ransac(cloud, 3), "key is 3; it must be a key of JAX"),
        (lambda: ransac(cloud, key, where=[[True], []]), "lists of different lengths"),
        (lambda: fit(None), "points: Expected numbers, got NoneType"),
        (lambda: ransac(cloud, np.zeros(2)), "it must be a key of JAX"),
        (lambda: ransac(cloud, key, threshold=np.nan), "threshold is nan; it must be a length"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            use()
