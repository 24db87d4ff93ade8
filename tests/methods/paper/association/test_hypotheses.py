"""Positions of groups, their support, their uncertainty; each baseline; the paper's weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree import Rays
from catfree.methods.paper.association import (
    Support,
    exclusive_support,
    find_support,
    measure_support,
    measured_pose_ratio,
    ray_weights,
    triangulate_groups,
)
from catfree.methods.paper.association._hypotheses import RayTable
from catfree.methods.paper.association._on_ground import (
    ground_point,
    least_squares_on_ground,
    triangulate_on_ground,
)
from catfree.settings import RaySettings, TriangulationSettings

CENTERS = np.array([[1.0, 0, 0.3], [0, 1, 0.3], [-1, 0, 0.3], [0, -1, 0.3]])
SIGMA_THETA = 0.02

on_ground = jax.jit(least_squares_on_ground)
robust_on_ground = jax.jit(triangulate_on_ground, static_argnames="refit")


def rays_to(targets, noise: float | np.ndarray = 0.0, weight: np.ndarray | None = None) -> Rays:
    """Make one ray per camera to each target, in order of targets."""
    targets = np.repeat(np.asarray(targets, float), 4, axis=0)
    origin = np.tile(CENTERS, (len(targets) // 4, 1))
    direction = targets - origin + noise
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(origin, direction, np.ones(len(targets)) if weight is None else weight)


@pytest.mark.slow
def test_exact_rays_meet_where_they_should(x64):
    target = np.array([[0.1, 0.2, 0.05], [-0.2, 0.3, 0.0]])
    groups = np.array([[0, 1, 2, 3], [-1, 5, -1, 7]])
    position, residual = triangulate_groups(
        rays_to(target), groups, TriangulationSettings(), sigma_theta=SIGMA_THETA
    )
    np.testing.assert_allclose(position, target, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(residual), groups < 0)
    np.testing.assert_allclose(residual[groups >= 0], 0, atol=1e-7)


@pytest.mark.slow
def test_the_best_pair_is_the_one_with_the_smallest_sigma(x64):
    noise = np.random.default_rng(0).normal(scale=0.01, size=(4, 3))
    rays = rays_to([[0.5, 0.4, 0]], noise)
    group = np.arange(4)[None]
    position, residual = triangulate_groups(
        rays, group, TriangulationSettings(estimator="best_pair"), sigma_theta=SIGMA_THETA
    )
    sigma = {}
    for pair in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]:
        member = np.full((1, 4), -1)
        member[0, list(pair)] = pair
        place, _ = triangulate_groups(
            rays, member, TriangulationSettings(), sigma_theta=SIGMA_THETA
        )
        support = measure_support(rays, member, place, sigma_theta=SIGMA_THETA)
        sigma[pair] = (float(support.sigma[0]), place)
    best = min(sigma, key=lambda pair: sigma[pair][0])
    assert tuple(np.flatnonzero(np.isfinite(residual[0]))) == best
    np.testing.assert_allclose(position, sigma[best][1], atol=1e-9)


@pytest.mark.slow
def test_the_single_ray_is_the_most_reliable_one_cut_with_the_ground(x64):
    weight = np.array([0.2, 0.9, 0.4, 0.1])
    rays = rays_to([[0.1, 0.2, 0.0]], np.random.default_rng(1).normal(scale=0.05, size=(4, 3)))
    rays = Rays(rays.origin, rays.direction, weight)
    position, residual = triangulate_groups(
        rays,
        np.arange(4)[None],
        TriangulationSettings(estimator="single_ray"),
        sigma_theta=SIGMA_THETA,
    )
    step = -rays.origin[1, 2] / rays.direction[1, 2]
    np.testing.assert_allclose(position[0], rays.origin[1] + step * rays.direction[1], atol=1e-12)
    assert np.flatnonzero(np.isfinite(residual[0])).tolist() == [1]


@pytest.mark.slow
def test_constrained_positions_are_on_the_ground(x64):
    rays = rays_to([[0.1, 0.2, 0.1]])
    settings = TriangulationSettings(constrain_to_ground=True)
    position, _ = triangulate_groups(rays, np.arange(4)[None], settings, sigma_theta=SIGMA_THETA)
    assert position[0, 2] == 0


PLACE = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8))


@pytest.mark.slow
@given(PLACE, st.lists(st.floats(-0.02, 0.02), min_size=12, max_size=12))
def test_least_squares_on_the_ground_is_a_minimum(x64, place, noise):
    rays = rays_to([[*place, 0.0]], np.reshape(noise, (4, 3)))
    weight = np.array([1.0, 0.5, 0.2, 0.8])
    drawn = [jnp.asarray(array) for array in (rays.origin, rays.direction, weight)]
    found = on_ground(*drawn)
    across = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
    scaled = np.sqrt(weight)[:, None, None] * across
    right = np.einsum("cij,cj->ci", scaled, rays.origin).ravel()
    wanted = np.linalg.lstsq(scaled[:, :, :2].reshape(-1, 2), right, rcond=None)[0]
    np.testing.assert_allclose(found, [*wanted, 0], atol=1e-8)
    robust = robust_on_ground(*drawn, 10.0, refit=True)
    np.testing.assert_allclose(robust, found, atol=1e-8)


def test_a_ray_that_does_not_descend_meets_the_ground_far_ahead(x64):
    origin = jnp.array([0.0, 0, 1])
    level = ground_point(origin, jnp.array([1.0, 0, 0]))
    np.testing.assert_allclose(level, [1000, 0, 0])
    np.testing.assert_allclose(ground_point(origin, jnp.array([0.6, 0, -0.8])), [0.75, 0, 0])


@st.composite
def tables(draw):
    number = st.floats(-0.05, 0.05)
    counts = draw(st.lists(st.integers(0, 3), min_size=8, max_size=8))
    shift = draw(st.lists(st.tuples(number, number), min_size=sum(counts), max_size=sum(counts)))
    weight = draw(
        st.lists(st.sampled_from([0.1, 0.5, 1.0]), min_size=sum(counts), max_size=sum(counts))
    )
    return np.array(counts), np.array(shift).reshape(-1, 2), np.array(weight)


@pytest.mark.slow
@settings(max_examples=50)
@given(tables())
def test_support_is_the_most_reliable_ray_within_the_radius(x64, drawn):
    counts, shift, weight = drawn
    cell = np.repeat(np.arange(8), counts)
    start = np.cumsum(counts) - counts
    target = np.column_stack([shift, np.zeros(len(shift))])
    direction = target - CENTERS[cell % 4]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    place = np.arange(len(cell)) - start[cell]
    table_direction, table_weight = np.zeros((8, 16, 3)), np.zeros((8, 16))
    table_direction[cell, place], table_weight[cell, place] = direction, weight
    table = RayTable(
        CENTERS,
        table_direction.reshape(2, 4, 16, 3),
        table_weight.reshape(2, 4, 16),
        start.reshape(2, 4),
    )
    member = find_support(table, np.array([0, 1]), np.zeros((2, 3)), radius=SIGMA_THETA)
    sight = -CENTERS[cell % 4]
    cosine = (direction * sight).sum(1) / np.linalg.norm(sight, axis=1)
    angle = np.arccos(np.clip(cosine, -1, 1))
    for frame in range(2):
        for camera in range(4):
            inside = np.flatnonzero((cell == 4 * frame + camera) & (angle <= SIGMA_THETA))
            chosen = member[frame, camera]
            if len(inside) == 0:
                assert chosen == -1
            else:
                assert chosen in inside
                assert weight[chosen] == weight[inside].max()


@pytest.mark.slow
def test_sigma_needs_two_cameras_and_follows_the_definition(x64):
    rays = rays_to([[0.1, 0.2, 0]], weight=np.array([1.0, 0.5, 0.25, 1.0]))
    member = np.array([[0, 1, 2, 3], [-1, 1, -1, -1], [-1, -1, -1, -1]])
    position = np.tile([0.1, 0.2, 0.0], (3, 1))
    support = measure_support(rays, member, position, sigma_theta=SIGMA_THETA)
    assert np.isinf(support.sigma).tolist() == [False, True, True]
    assert np.isinf(support.covariance[1:]).all()
    np.testing.assert_allclose(support.weight, [2.75, 0.5, 0])
    np.testing.assert_array_equal(support.cameras, [4, 1, 0])
    distance = np.linalg.norm(position[0] - CENTERS, axis=1)
    across = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
    precision = np.einsum("c,cij->ij", rays.weight / (distance * SIGMA_THETA) ** 2, across)
    covariance = np.linalg.inv(precision)[:2, :2]
    np.testing.assert_allclose(support.covariance[0], covariance, rtol=1e-6)
    np.testing.assert_allclose(support.sigma[0], np.sqrt(np.trace(covariance) / 2), rtol=1e-6)


def test_exclusive_support_leaves_a_ray_to_its_nearest_position():
    member = np.array([[0, 1], [0, 2], [-1, 1]])
    residual = np.array([[0.01, 0.02], [0.005, 0.01], [np.nan, 0.01]])
    numbers = np.zeros(3)
    support = Support(member, residual, numbers, np.zeros((3, 2, 2)), numbers)
    np.testing.assert_array_equal(exclusive_support(support), [[-1, -1], [0, 2], [-1, 1]])


@pytest.mark.slow
def test_no_groups_give_no_positions():
    none = np.zeros((0, 4), np.int64)
    position, residual = triangulate_groups(
        rays_to([[0, 0, 0]]), none, TriangulationSettings(), sigma_theta=SIGMA_THETA
    )
    assert position.shape == (0, 3)
    assert residual.shape == (0, 4)


def test_the_pose_ratio_compares_medians():
    residual = np.array([0.01, 0.02, 0.03, 0.02, 0.04, np.nan])
    ankles = np.array([True, True, True, False, False, True])
    assert measured_pose_ratio(residual, ankles) == pytest.approx((0.02 / 0.03) ** 2)
    assert measured_pose_ratio(residual, ~ankles) == 1
    assert measured_pose_ratio(residual, np.ones(6, bool)) == 1
    assert measured_pose_ratio(np.full(6, np.nan), ankles) == 1
    assert measured_pose_ratio(np.zeros(6), ankles) == 1


@pytest.mark.parametrize(
    ("rules", "wanted"),
    [
        ({}, [1.0, 0.25, 0.4, 0.1]),
        ({"use_ankles": False}, [1.0, 0.25, 1.0, 0.25]),
        ({"use_box_height": False}, [1.0, 1.0, 0.4, 0.4]),
        ({"minimum_weight": 0.3}, [1.0, 0.3, 0.4, 0.3]),
    ],
)
def test_weights_by_ankles_and_height(rules, wanted):
    height = np.array([120.0, 50, 120, 50])
    ankles = np.array([True, True, False, False])
    weight = ray_weights(height, ankles, 0.4, 100.0, RaySettings(**rules))
    np.testing.assert_allclose(weight, wanted)
    alone = ray_weights(height, None, 0.4, 100.0, RaySettings(**rules))
    np.testing.assert_array_equal(
        alone, ray_weights(height, ankles | True, 1.0, 100.0, RaySettings(**rules))
    )
