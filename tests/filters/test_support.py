"""Support recount against a loop over rays with arctan2 in float64."""

import inspect

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError

CAMERAS, RAYS = 3, 4
RADIUS = 0.0206
support = jax.jit(filters.support)


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def residual(position, origin, direction):
    offset = position - origin
    return np.arctan2(np.linalg.norm(np.cross(direction, offset)), direction @ offset)


@st.composite
def views(draw):
    """Draw a position and rays of each camera that miss it by chosen angles, some absent."""
    coordinate = st.floats(-20, 20, width=32)
    position = np.array(draw(st.tuples(coordinate, coordinate, coordinate)))
    origins, directions = np.zeros((CAMERAS, 3)), np.full((CAMERAS, RAYS, 3), np.nan)
    weights = np.zeros((CAMERAS, RAYS))
    for c in range(CAMERAS):
        azimuth, elevation = draw(st.floats(0, 6.28)), draw(st.floats(-1.2, 1.2))
        towards = np.array(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        origins[c] = position - towards * draw(st.floats(0.5, 40))
        side = unit(np.cross(towards, [-np.sin(azimuth), np.cos(azimuth), 0.3]))
        # All angles differ and none is at the radius, where rounding would decide; ties are below.
        steps = draw(st.lists(st.integers(-28, 28), max_size=RAYS, unique_by=abs))
        for d, step in enumerate(steps):
            angle = step / 9.5 * RADIUS
            directions[c, d] = np.cos(angle) * towards + np.sin(angle) * side
            weights[c, d] = draw(st.sampled_from([0, 0.25, 0.5, 1]))
    return position, origins, directions, weights


def support_by_hand(position, origins, directions, weights):
    chosen = []
    for c in range(len(origins)):
        inside = [
            (-weights[c, d], angle, d)
            for d in range(directions.shape[1])
            if weights[c, d] > 0
            and (angle := residual(position, origins[c], directions[c, d])) <= RADIUS
        ]
        chosen.append(min(inside)[2] if inside else -1)
    return chosen


@given(view=views())
def test_support_equals_a_loop_over_rays(x64, view):
    np.testing.assert_array_equal(support(*view, RADIUS), support_by_hand(*view))


@pytest.mark.slow
@given(view=views(), factor=st.sampled_from([1e-3, 1.0, 1e3]))
def test_float32_decides_as_float64(x64, view, factor):
    position, origins, directions, weights = view
    centre = origins.mean(0)
    arrays = ((position - centre) * factor, (origins - centre) * factor, directions, weights)
    low = support(*(a.astype(np.float32) for a in arrays), np.float32(RADIUS))
    np.testing.assert_array_equal(low, support(*arrays, RADIUS))
    assert low.dtype == np.int32


@pytest.mark.slow
@given(view=views(), data=st.data())
def test_order_of_cameras_does_not_matter(view, data):
    position, origins, directions, weights = view
    order = np.array(data.draw(st.permutations(range(CAMERAS))))
    arrays = [a.astype(np.float32) for a in (position, origins, directions, weights)]
    plain = np.asarray(support(*arrays, RADIUS))
    shuffled = support(arrays[0], *(a[order] for a in arrays[1:]), RADIUS)
    np.testing.assert_array_equal(shuffled, plain[order])


def looking_at(*angles):
    """Make rays in the x-y plane from the origin, by angle to the x axis."""
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], -1)[None]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("angles", "weights", "expected"),
    [
        ([0.0, 0.01], [0.5, 0.9], 1),  # the more reliable ray, though not the nearest
        ([0.01, 0.005], [0.5, 0.5], 1),  # equal weights: the nearest
        ([0.01, -0.01], [0.5, 0.5], 0),  # equal in everything: the first
        ([0.03, 0.0], [0.9, 0.1], 1),  # outside of the radius
        ([0.03, 0.05], [1, 1], -1),
        ([0.0, 0.0], [0, 0], -1),  # absent
        ([np.pi, np.pi + 0.01], [1, 1], -1),  # looking away
    ],
)
def test_support_by_hand(dtype, angles, weights, expected):
    arrays = (np.array([9, 0, 0]), np.zeros((1, 3)), looking_at(*angles), np.array([weights]))
    index = filters.support(*(a.astype(dtype) for a in arrays), RADIUS)
    assert index.tolist() == [expected]


def test_arrays_that_would_broadcast_are_named():
    unchecked = inspect.unwrap(filters.support)  # bypass the tests' shape checks
    origins, directions, weights = np.zeros((2, 3)), np.zeros((2, 4, 3)), np.zeros((2, 4))
    for arguments, message in (
        ((np.zeros(2), origins, directions, weights), "position must have shape"),
        ((np.zeros(3), origins[:1], directions, weights), "origins must have shape"),
        ((np.zeros(3), origins, directions[:, :1], weights), "directions must have shape"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            unchecked(*arguments, 0.1)


def test_no_rays_at_all():
    index = filters.support(np.zeros(3), np.ones((2, 3)), np.zeros((2, 0, 3)), np.zeros((2, 0)), 1)
    assert index.tolist() == [-1, -1]
    assert filters.weighted_support(index, np.zeros((2, 0))) == 0


@pytest.mark.slow
def test_a_position_at_a_camera_is_not_seen_by_it():
    index = filters.support(
        np.zeros(3), np.zeros((1, 3)), looking_at(0.0).astype(np.float32), np.ones((1, 1)), RADIUS
    )
    assert index.tolist() == [-1]


def test_weighted_support_sums_the_chosen_rays(dtype):
    weights = np.array([[0.5, 0.25], [1, np.nan], [0.125, 0.75]], dtype)
    total = filters.weighted_support(np.array([1, -1, 1]), weights)
    assert total == 1.0
    assert total.dtype == dtype
    assert filters.weighted_support(np.array([1, -1, 1], ">i4"), weights) == total
    for index in ([0, 0, 2], [-2, 0, 0]):
        with pytest.raises(InvalidInputError, match=r"index is \[.*; of 2 rays per camera"):
            filters.weighted_support(np.array(index), weights)
    with pytest.raises(InvalidInputError, match=r"weights must have shape \(n, n\), got \(3,\)"):
        inspect.unwrap(filters.weighted_support)(np.zeros(3, int), np.ones(3))
    jitted = jax.jit(filters.weighted_support)
    assert jitted(np.array([1, -1, 1]), weights) == total


@pytest.mark.slow
def test_vmap_equals_a_loop(dtype):
    random = np.random.default_rng(0)
    origins = random.normal(size=(5, 10, 3)).astype(dtype) * 10
    position = random.normal(size=(20, 3)).astype(dtype)
    directions = unit(position[0] - origins[0][:, None] + random.normal(size=(10, 6, 3)) * 0.2)
    directions = directions.astype(dtype)
    weights = random.random((10, 6)).astype(dtype)
    together = jax.jit(jax.vmap(filters.support, (0, None, None, None, None)))
    batched = together(position, origins[0], directions, weights, 0.1)
    looped = [support(p, origins[0], directions, weights, 0.1) for p in position]
    np.testing.assert_array_equal(batched, looped)
    assert (np.asarray(batched) >= 0).any()


@pytest.mark.parametrize("radius", [-0.1, np.nan])
def test_a_radius_that_is_no_angle_is_refused(radius):
    rays = np.zeros((2, 1, 3)), np.zeros((2, 1))
    with pytest.raises(InvalidInputError, match="radius is"):
        filters.support(np.zeros(3), np.ones((2, 3)), *rays, radius)
