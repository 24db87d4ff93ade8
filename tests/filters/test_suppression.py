"""Greedy suppression against a loop, and its guarantees."""

import inspect

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError

SIZE = 12
suppress = jax.jit(filters.suppress)
outside = jax.jit(filters.outside)

# On an integer grid, ties and distances equal to the radius are common.
places = st.lists(
    st.tuples(st.integers(0, 8), st.integers(0, 8), st.integers(0, 3), st.integers(0, 3)),
    max_size=SIZE,
)
radii = st.sampled_from([0.0, 1.0, 1.5, 2.0, 5.0])


def arrays(drawn, dtype=np.float32):
    """Draw positions, two-column priority and mask, padded with NaN."""
    values = np.full((SIZE, 4), np.nan, dtype)
    values[: len(drawn)] = np.array(drawn, dtype).reshape(-1, 4)
    return values[:, :2], values[:, 2:], np.arange(SIZE) < len(drawn)


def suppress_by_hand(positions, priority, radius, where):
    keep = np.zeros(len(positions), bool)
    for i in sorted(np.flatnonzero(where), key=lambda i: (*-priority[i], i)):
        distance = np.hypot(*(positions[keep] - positions[i]).T)
        keep[i] = not (distance <= radius).any()
    return keep


@pytest.mark.slow
@given(drawn=places, radius=radii)
def test_suppress_equals_a_loop(drawn, radius):
    positions, priority, where = arrays(drawn)
    np.testing.assert_array_equal(
        suppress(positions, priority, radius, where),
        suppress_by_hand(positions, priority, radius, where),
    )
    np.testing.assert_array_equal(
        suppress(positions, priority[:, 0], radius, where),
        suppress_by_hand(positions, priority[:, :1], radius, where),
    )


@pytest.mark.slow
@given(drawn=places, radius=radii)
def test_kept_are_apart_and_removed_are_near_something_stronger(drawn, radius):
    positions, priority, where = arrays(drawn)
    keep = np.asarray(suppress(positions, priority, radius, where))
    rank = [(*-p, i) for i, p in enumerate(priority)]
    for i in np.flatnonzero(where):
        near = np.hypot(*(positions - positions[i]).T) <= radius
        others = np.flatnonzero(near & keep & (np.arange(SIZE) != i))
        if keep[i]:
            assert len(others) == 0
        else:
            assert any(rank[j] < rank[i] for j in others)


@given(
    drawn=st.lists(
        st.tuples(
            st.integers(0, 8), st.integers(0, 8), st.integers(0, 3), st.floats(0, 1, width=32)
        ),
        max_size=SIZE,
        unique_by=lambda row: row[3],
    ),
    radius=radii,
    data=st.data(),
)
def test_order_unit_and_direction_do_not_matter(drawn, radius, data):
    positions, priority, where = arrays(drawn)
    keep = np.asarray(suppress(positions, priority, radius, where))
    order = np.array(data.draw(st.permutations(range(SIZE))))
    np.testing.assert_array_equal(
        suppress(positions[order], priority[order], radius, where[order]), keep[order]
    )
    turned = positions[:, ::-1] * np.array([-4, 4], np.float32) + np.float32(64)
    np.testing.assert_array_equal(suppress(turned, priority, radius * 4, where), keep)


@given(drawn=places, radius=radii)
def test_suppressing_twice_changes_nothing(drawn, radius):
    positions, priority, where = arrays(drawn)
    keep = suppress(positions, priority, radius, where)
    np.testing.assert_array_equal(suppress(positions, priority, radius, keep), keep)
    assert not np.any(outside(positions, keep, radius, where))


@pytest.mark.slow
def test_a_chain_by_hand(dtype):
    # In a chain, each reaches only the next: the strongest end keeps every second one.
    positions = np.stack([np.arange(6), np.zeros(6)], -1).astype(dtype)
    falling = np.arange(6, 0, -1).astype(dtype)
    assert suppress(positions, falling, 1.0).tolist() == [True, False] * 3
    middle = np.array([0, 1, 9, 8, 7, 0], dtype)
    assert suppress(positions, middle, 1.0).tolist() == [1, 0, 1, 0, 1, 0]


@pytest.mark.slow
def test_later_columns_break_ties(dtype):
    positions = np.zeros((3, 2), dtype)
    priority = np.array([[2, 0], [2, 1], [1, 9]], dtype)
    assert filters.suppress(positions, priority, 1.0).tolist() == [False, True, False]


@pytest.mark.slow
def test_degenerate_sizes(dtype):
    assert filters.suppress(np.zeros((0, 2), dtype), np.zeros(0, dtype), 1.0).shape == (0,)
    assert filters.suppress(np.zeros((1, 2), dtype), np.zeros(1, dtype), 1.0).tolist() == [True]
    nowhere = filters.suppress(np.zeros((3, 2)), np.zeros(3), 1.0, np.zeros(3, bool))
    assert not nowhere.any()
    same = filters.suppress(np.zeros((3, 2)), np.zeros(3), 0.0)
    assert same.tolist() == [True, False, False]


@pytest.mark.slow
def test_vmap_equals_a_loop(dtype):
    random = np.random.default_rng(0)
    positions = random.random((4, 30, 2)).astype(dtype)
    priority = random.random((4, 30)).astype(dtype)
    where = random.random((4, 30)) < 0.8
    together = jax.jit(jax.vmap(filters.suppress, (0, 0, None, 0)))
    batched = together(positions, priority, 0.2, where)
    for row in range(4):
        expected = suppress_by_hand(positions[row], priority[row][:, None], 0.2, where[row])
        np.testing.assert_array_equal(batched[row], expected)


@given(drawn=places, radius=radii, data=st.data())
def test_outside_equals_a_loop(drawn, radius, data):
    positions, _, where = arrays(drawn)
    accepted = where & np.array(data.draw(st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)))
    expected = [
        where[i]
        and not accepted[i]
        and not (np.hypot(*(positions[accepted] - positions[i]).T) <= radius).any()
        for i in range(SIZE)
    ]
    np.testing.assert_array_equal(outside(positions, accepted, radius, where), expected)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.5, np.float32(0.5), np.asarray(0.5)])
def test_any_kind_of_number_is_a_radius(radius):
    positions = np.array([[0, 0], [0.4, 0], [3, 0]], np.float32)
    accepted = np.array([True, False, False])
    assert filters.suppress(positions, np.arange(3), radius).tolist() == [False, True, True]
    assert filters.outside(positions, accepted, radius).tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("positions", "priority"),
    [
        ((3, 2), (2,)),
        ((3, 3), (3,)),
        ((0, 2), (1,)),
        ((3, 2), (3, 0)),
        ((3, 2), (3, 1, 1)),
        ((3, 2), ()),
        ((), (3,)),
    ],
)
def test_the_shapes_that_do_not_fit_are_named(positions, priority):
    unchecked = inspect.unwrap(filters.suppress)  # bypass the tests' shape checks
    with pytest.raises(InvalidInputError, match="one priority each"):
        unchecked(np.zeros(positions), np.zeros(priority), 1.0)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        (np.array([0, 2, 1]), r"where\[1\] is neither true nor false"),
        (np.array([True]), r"where must have shape \(3\), got \(1,\)"),
        (np.full(3, "no"), "where must hold true and false"),
    ],
)
def test_a_mask_that_is_none_is_named(where, message):
    positions = np.zeros((3, 2))
    with pytest.raises(InvalidInputError, match=message):
        inspect.unwrap(filters.suppress)(positions, np.arange(3), 1.0, where)
    with pytest.raises(InvalidInputError, match=message):
        inspect.unwrap(filters.outside)(positions, np.zeros(3, bool), 1.0, where)


@pytest.mark.parametrize("radius", [-1.0, np.nan, -np.inf])
@pytest.mark.parametrize("function", [filters.suppress, filters.outside])
def test_a_radius_is_0_or_more(function, radius):
    with pytest.raises(InvalidInputError, match=r"^radius is .*; it must be one number, 0 or more"):
        function(
            np.zeros((3, 2)), np.ones(3, bool if function is filters.outside else float), radius
        )


def test_an_infinite_radius_keeps_one():
    assert filters.suppress(np.eye(3)[:, :2], np.ones(3), np.inf).sum() == 1
