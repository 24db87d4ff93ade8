"""Triangulation: laws on drawn rays, the minimum compared with SciPy's, degenerate input."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from catfree import geometry
from catfree.errors import InvalidInputError
from catfree.geometry import Similarity

pytestmark = pytest.mark.slow

DELTA = 0.2

# Compiled once per shape and dtype.
triangulate = jax.jit(geometry.triangulate)
triangulate_once = jax.jit(lambda *case: geometry.triangulate(*case, refit=False))
triangulate_batch = jax.jit(jax.vmap(geometry.triangulate, (0, 0, 0, None)))
least_squares = jax.jit(geometry.triangulate_least_squares)


def position_of(origins, directions, weights):
    return geometry.triangulate(origins, directions, weights, DELTA).position


@jax.jit
def jacobians(*case):
    """Derivatives of the position agree in reverse and forward mode."""
    arguments = (0, 1, 2)
    return jax.jacrev(position_of, arguments)(*case), jax.jacfwd(position_of, arguments)(*case)


@st.composite
def sightings(draw, count=4, noise=0.02):
    """Draw a person and surrounding cameras with noisy rays in general position."""
    person = draw(hnp.arrays(np.float64, 3, elements=st.floats(-5, 5)))
    offsets = draw(hnp.arrays(np.float64, (count, 3), elements=st.floats(-10, 10)))
    errors = draw(hnp.arrays(np.float64, (count, 3), elements=st.floats(-noise, noise)))
    weights = draw(hnp.arrays(np.float64, count, elements=st.floats(0.05, 1)))
    distance = np.linalg.norm(offsets, axis=1)
    assume((distance > 1).all())
    directions = -offsets / distance[:, None] + errors
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    well_posed(directions)
    return person + offsets, directions, weights


def well_posed(directions):
    matrix = len(directions) * np.eye(3) - directions.T @ directions
    assume(np.linalg.eigvalsh(matrix)[0] > 0.05)


def ray_distances(position, origins, directions):
    sight = position - origins
    along = np.sum(sight * directions, axis=1, keepdims=True)
    return np.linalg.norm(sight - along * directions, axis=1)


def huber_loss(position, origins, directions, weights, delta=DELTA):
    distances = ray_distances(position, origins, directions)
    near = np.minimum(distances, delta)
    return np.sum(weights * near * (distances - near / 2))


@given(sightings(noise=0.0))
def test_exact_rays_meet_in_their_point(x64, case):
    origins, directions, _ = case
    found = triangulate(*case, DELTA)
    assert np.max(ray_distances(np.asarray(found.position), origins, directions)) < 1e-9
    assert found.inliers.all()
    np.testing.assert_allclose(least_squares(*case), found.position, atol=1e-9)


@given(sightings(noise=0.3))
def test_no_other_point_has_a_smaller_loss(x64, case):
    found = np.asarray(triangulate_once(*case, DELTA).position)
    best = huber_loss(found, *case)
    other = minimize(huber_loss, found, case, method="Nelder-Mead", options={"xatol": 1e-7})
    assert best <= other.fun + 1e-10
    start = minimize(huber_loss, np.asarray(least_squares(*case)), case, method="BFGS")
    assert best <= start.fun + 1e-8


def robust_residuals(position, case):
    """Return vectors whose squared lengths sum to twice Huber's loss."""

    def of_ray(origin, direction, weight):
        sight = position - origin
        residual = sight - (sight @ direction) * direction
        far = residual @ residual > DELTA**2
        distance = jnp.sqrt(jnp.where(far, residual @ residual, DELTA**2))
        shrink = jnp.where(far, jnp.sqrt(DELTA * (2 * distance - DELTA)) / distance, 1)
        return jnp.sqrt(weight) * shrink * residual

    return jax.vmap(of_ray)(*case)


@jax.jit
def curvature_at(position, case):
    """Return the Hessian of Huber's loss."""

    def half_squares(position):
        return (robust_residuals(position, case) ** 2).sum() / 2

    return jax.hessian(half_squares)(position)


@jax.jit
def by_optimistix(start, *case):
    """Return the minimizer of a dense solver, and its derivatives."""
    solver = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)

    def minimizer(origins, directions, weights):
        case = origins, directions, weights
        # If two far rays have nearly equal weights, the loss is flat and every step short.
        return optx.least_squares(
            robust_residuals, solver, start, case, max_steps=400, throw=False
        ).value

    return minimizer(*case), jax.jacrev(minimizer, (0, 1, 2))(*case)


@jax.jit
def by_kernel(*case):
    def minimizer(origins, directions, weights):
        return geometry.triangulate(origins, directions, weights, DELTA, refit=False).position

    return minimizer(*case), jax.jacrev(minimizer, (0, 1, 2))(*case)


@given(sightings(noise=0.3))
def test_minimizer_and_derivatives_are_those_of_optimistix(x64, case):
    position, slopes = by_kernel(*case)
    dense, dense_slopes = by_optimistix(least_squares(*case), *case)
    best = huber_loss(np.asarray(position), *case)
    assert best <= huber_loss(np.asarray(dense), *case) + 1e-10
    # A curved loss has one minimizer, whose derivative has a kink where a ray is at delta.
    near = ray_distances(np.asarray(position), case[0], case[1])
    curvature = np.linalg.eigvalsh(curvature_at(position, case))[0]
    assume(curvature > 0.02 and (np.abs(near - DELTA) > 1e-3).all())
    np.testing.assert_allclose(dense, position, atol=1e-6)
    for found, expected in zip(slopes, dense_slopes, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-4 * (1 + np.abs(expected).max()))


@given(sightings(noise=0.3))
def test_least_squares_solves_the_normal_equations(x64, case):
    origins, directions, weights = case
    projectors = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    matrix = np.einsum("c,cij->ij", weights, projectors)
    right = np.einsum("c,cij,cj->i", weights, projectors, origins)
    np.testing.assert_allclose(least_squares(*case), np.linalg.solve(matrix, right), atol=1e-8)


@given(sightings(noise=0.3))
def test_refit_is_the_robust_fit_of_the_inliers_alone(x64, case):
    origins, directions, weights = case
    once = triangulate_once(*case, DELTA)
    refitted = triangulate(*case, DELTA)
    inliers = np.asarray(once.inliers)
    np.testing.assert_array_equal(
        inliers, ray_distances(np.asarray(once.position), origins, directions) <= 3 * DELTA
    )
    np.testing.assert_array_equal(refitted.inliers, inliers)
    if inliers.all() or inliers.sum() < 2:
        np.testing.assert_array_equal(refitted.position, once.position)
    else:
        kept = np.where(inliers, weights, 0)
        alone = np.asarray(triangulate_once(origins, directions, kept, DELTA).position)
        found = np.asarray(refitted.position)
        losses = [huber_loss(at, origins, directions, kept) for at in (found, alone)]
        assert losses[0] == pytest.approx(losses[1], abs=1e-9)
        # Where the loss is flat, all points of a line, or between two lines, fit equally well; it
        # becomes flat where a ray is at delta.
        near = ray_distances(found, origins, directions)[kept > 0]
        curvature = curvature_at(refitted.position, (origins, directions, kept))
        if np.linalg.eigvalsh(curvature)[0] > 1e-6 and (np.abs(near - DELTA) > 1e-3).all():
            np.testing.assert_allclose(found, alone, atol=1e-8)


@given(sightings(noise=0.1), st.floats(-3, 3), hnp.arrays(float, 6, elements=st.floats(-3, 3)))
def test_a_similarity_moves_the_result(x64, case, exponent, motion):
    origins, directions, weights = case
    rotation = Rotation.from_rotvec(motion[:3]).as_matrix()
    scale = 10**exponent
    move = Similarity(scale, rotation, 10 * scale * motion[3:])
    expected = triangulate(*case, DELTA)
    found = triangulate(move(origins), directions @ rotation.T, weights, scale * DELTA)
    np.testing.assert_allclose(found.position, move(expected.position), atol=1e-6 * scale)
    np.testing.assert_allclose(found.distances, scale * expected.distances, atol=1e-6 * scale)


@given(sightings(noise=0.1), st.permutations(range(4)))
def test_the_order_of_rays_does_not_matter(x64, case, order):
    expected = triangulate(*case, DELTA)
    found = triangulate(*(array[order] for array in case), DELTA)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-7)
    np.testing.assert_allclose(found.distances, expected.distances[np.array(order)], atol=1e-7)


@given(sightings(noise=0.1), st.floats(0.01, 100))
def test_only_the_ratio_of_weights_matters(x64, case, factor):
    origins, directions, weights = case
    expected = triangulate(*case, DELTA).position
    found = triangulate(origins, directions, factor * weights, DELTA).position
    np.testing.assert_allclose(found, expected, atol=1e-7)


@given(sightings(count=3, noise=0.1))
def test_a_ray_of_weight_zero_is_a_ray_left_out(x64, case):
    padded = [np.concatenate([a, np.full((1, *a.shape[1:]), np.nan)]) for a in case]
    padded[2][-1] = 0
    expected, found = triangulate(*case, DELTA), triangulate(*padded, DELTA)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(found.distances[:3], expected.distances, atol=1e-9)
    assert found.distances[3] == 0
    assert not found.inliers[3]
    origins, directions, weights = case
    inliers = np.where(expected.inliers, weights, 0)
    # Where the loss is flat, as between two lines, the minimizer has no derivative.
    curvature = curvature_at(expected.position, (origins, directions, inliers))
    is_curved = np.linalg.eigvalsh(curvature)[0] > 1e-6
    for mode, padded_mode in zip(jacobians(*case), jacobians(*padded), strict=True):
        for a, b in zip(mode, padded_mode, strict=True):
            if is_curved:
                np.testing.assert_allclose(b[:, :3], a, atol=1e-6)
            assert (np.asarray(b[:, 3]) == 0).all()


@given(sightings(noise=0.1))
def test_a_batch_under_jit_gives_what_single_calls_give(x64, case):
    batch = [np.stack([a, a[::-1]]) for a in case]
    together = triangulate_batch(*batch, DELTA)
    for row in range(2):
        alone = triangulate(*(a[row] for a in batch), DELTA)
        np.testing.assert_allclose(together.position[row], alone.position, atol=1e-8)
        np.testing.assert_array_equal(together.inliers[row], alone.inliers)


def test_large_batches_are_cut_and_packed_without_a_trace():
    # More than one block; an eighth have an absent ray, a third a wrong one.
    count, rng = 16384 + 100, np.random.default_rng(0)
    origins = rng.uniform(-10, 10, (count, 5, 3))
    directions = rng.uniform(-2, 2, (count, 1, 3)) - origins
    directions[::3, 0] = rng.standard_normal((len(directions[::3]), 3))
    directions += rng.normal(scale=0.02, size=directions.shape)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    weights = rng.uniform(0.1, 1, (count, 5))
    origins[::8, 4], weights[::8, 4] = np.nan, 0
    batch = [array.astype(np.float32) for array in (origins, directions, weights)]
    found = triangulate_batch(*batch, DELTA)
    assert np.isfinite(found.position).all()
    # Each is padded, and repacked during convergence, in a different way.
    for first, size in ((0, 64), (64, 500), (564, 3000), (3564, 12920)):
        rows = slice(first, first + size)
        apart = triangulate_batch(*(array[rows] for array in batch), DELTA)
        np.testing.assert_allclose(found.position[rows], apart.position, rtol=1e-5, atol=1e-4)
        assert np.mean(found.inliers[rows] == apart.inliers) > 0.999


@given(sightings(noise=0.04))
def test_derivatives_agree_with_finite_differences_in_both_modes(x64, case):
    reverse, forward = jacobians(*case)
    size = 1e-6
    found = np.asarray(triangulate(*case, DELTA).distances)
    # The loss has a kink in its second derivative at delta.
    assume((np.abs(found - DELTA) > 1e-3).all())
    assume((np.abs(found - 3 * DELTA) > 1e-3).all())
    for argument in range(3):
        np.testing.assert_allclose(forward[argument], reverse[argument], atol=1e-7)
        for index in np.ndindex(case[argument].shape):
            sides = []
            for step in (size, -size):
                moved = [a.copy() for a in case]
                moved[argument][index] += step
                sides.append(np.asarray(triangulate(*moved, DELTA).position))
            slope = (sides[0] - sides[1]) / (2 * size)
            at = (slice(None), *index)
            np.testing.assert_allclose(
                reverse[argument][at], slope, atol=1e-4 * (1 + np.abs(slope).max())
            )


@given(sightings(noise=0.03), st.sampled_from([1e-3, 1.0, 1e3]), st.booleans())
def test_float32_agrees_with_float64_far_away_and_at_any_scale(x64, case, scale, far):
    origins, directions, weights = case
    shift = np.array([1e4, -1e4, 100.0]) if far else np.zeros(3)
    case32 = [np.float32(scale * (origins + shift)), np.float32(directions), np.float32(weights)]
    case64 = [np.float64(a) for a in case32]
    found = triangulate(*case32, np.float32(scale * DELTA))
    expected = triangulate(*case64, scale * DELTA)
    assert found.position.dtype == jnp.float32
    resolution = 2e-3 if far else 2e-4  # two float32 steps at 10 km are 2 mm
    np.testing.assert_allclose(found.position, expected.position, atol=scale * resolution)
    np.testing.assert_allclose(found.distances, expected.distances, atol=scale * 2e-4)


ORIGINS = [[0.0, 0, 3], [8, 0, 3], [0, 8, 3]]
DEGENERATE = {
    "parallel rays": (ORIGINS, [[0.6, 0, -0.8]] * 3, [1, 1, 1]),
    "opposite rays": (ORIGINS, [[1, 0, 0], [-1, 0, 0], [0, 0, 1]], [1, 1, 0]),
    "coincident centres": ([[1.0, 2, 3]] * 3, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [1, 1, 1]),
    "coincident rays": ([[1.0, 2, 3]] * 3, [[1, 0, 0]] * 3, [1, 1, 1]),
    "one ray": (ORIGINS, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [1, 0, 0]),
    "no ray": (ORIGINS, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0]),
    "absent NaN": (
        [*ORIGINS[:2], [np.nan] * 3],
        [[0.8, 0, -0.6], [-0.8, 0, -0.6], [np.nan] * 3],
        [1, 1, 0],
    ),
    "two equal rays far apart": (ORIGINS, [[0, 1, 0], [0, 0, 1], [0, 0, 1]], [1, 1, 0]),
    "NaN weight": (ORIGINS, [[0.8, 0, -0.6], [-0.8, 0, -0.6], [0, 0, 1]], [1, 1, np.nan]),
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_rays_give_finite_values_and_gradients(x64, name, dtype):
    case = [np.asarray(a, dtype) for a in DEGENERATE[name]]
    found = triangulate(*case, dtype(DELTA))
    assert found.position.dtype == dtype
    assert np.isfinite(found.position).all()
    assert np.isfinite(found.distances).all()
    assert np.abs(found.position).max() < 100
    assert np.isfinite(least_squares(*case)).all()
    for jacobian in jax.tree.leaves(jacobians(*case)):
        assert np.isfinite(jacobian).all()


def test_degenerate_answers_by_hand(x64):
    def solve(name):
        case = [np.asarray(a, np.float64) for a in DEGENERATE[name]]
        return np.asarray(triangulate(*case, DELTA).position)

    np.testing.assert_allclose(solve("one ray"), ORIGINS[0])
    np.testing.assert_allclose(solve("no ray"), 0)
    np.testing.assert_allclose(solve("parallel rays"), np.mean(ORIGINS, axis=0), atol=3)
    np.testing.assert_allclose(solve("coincident centres"), [1, 2, 3], atol=1e-9)


def test_one_wrong_ray_among_four_is_rejected_by_hand(x64):
    origins = np.array([[10.0, 0, 0], [-10, 1e-9, 0], [0, 10, 0], [0, 0, 10]])
    directions = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1, 0], [1, 0, 0]])
    found = triangulate(origins, directions, np.ones(4), DELTA)
    np.testing.assert_allclose(found.position, 0, atol=1e-8)
    np.testing.assert_array_equal(found.inliers, [True, True, True, False])
    np.testing.assert_allclose(found.distances, [0, 0, 0, 10], atol=1e-8)


def test_two_far_rays_settle_at_the_balance_of_their_weights(x64):
    # Along the common perpendicular of length 1 the heavier ray pulls w x, the lighter w' delta.
    origins = np.array([[-10.0, 0, 0], [0, -10, 1]])
    directions = np.array([[1.0, 0, 0], [0, 1, 0]])
    for weights in ([1, 0.5], [1, 0.99], [1, 0.2]):
        found = triangulate(origins, directions, np.array(weights, float), DELTA)
        np.testing.assert_allclose(found.position, [0, 0, DELTA * weights[1]], atol=1e-7)
    middle = triangulate(origins, directions, np.ones(2), DELTA).position
    np.testing.assert_allclose(middle, [0, 0, 0.5], atol=1e-9)


def test_what_are_no_rays_of_one_person_is_refused():
    origins = np.array([[-10.0, 0, 0], [0, -10, 1], [0, 0, 9]])
    rays = origins, np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]), np.ones(3)
    long = rays[1] * [[1], [3], [1]]
    absent, largest = np.array([1.0, 0, 1]), float(np.finfo(jnp.result_type(float)).max)
    robust, squares, information = map(  # as without type checks
        inspect.unwrap,
        (geometry.triangulate, geometry.triangulate_least_squares, geometry.information),
    )
    for function in (
        lambda *case: robust(*case, DELTA).position,
        squares,
        lambda *case: information(np.ones(3), *case, 0.1),
    ):
        for any_value in (long, rays[1] * [[1], [largest], [1]]):  # of an absent ray
            np.testing.assert_array_equal(
                function(origins, any_value, absent), function(*rays[:2], absent)
            )
        for case, named in [
            ((origins, long, rays[2]), r"directions\[1\] has length 3"),
            ((origins, rays[1] * [[np.nan], [1], [1]], rays[2]), r"directions\[0\] has length nan"),
            ((*rays[:2], np.ones((3, 1))), "weights must have shape"),
            ((*rays[:2], np.ones(1)), r"origins must have shape \(1, 3\)"),
            ((origins, rays[1][:2], rays[2]), r"directions must have shape \(3, 3\)"),
        ]:
            with pytest.raises(InvalidInputError, match=named):
                function(*case)


def test_an_infinite_huber_scale_is_least_squares(x64):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    case = rng.normal(size=(4, 3)) * 5, directions, np.ones(4)
    found = triangulate(*case, np.inf)
    np.testing.assert_allclose(found.position, least_squares(*case), atol=1e-10)
    assert found.inliers.all()


@pytest.mark.parametrize("delta", [-1.0, np.nan])
def test_a_scale_that_is_no_length_is_refused(delta):
    with pytest.raises(InvalidInputError, match=r"huber_scale is .*; it must be a length"):
        geometry.triangulate(np.zeros((3, 3)), np.eye(3), np.ones(3), delta)


def test_the_factor_of_outliers_is_one_number():
    unchecked = inspect.unwrap(geometry.triangulate)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match=r"outlier_factor must have shape \(\)"):
        unchecked(np.zeros((3, 3)), np.eye(3), np.ones(3), 0.1, outlier_factor=[1.0, 2.0])
