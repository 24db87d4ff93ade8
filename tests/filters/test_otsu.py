"""Otsu's threshold against exact rational arithmetic, and the laws it must obey."""

import inspect
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError
from catfree.filters._sample_arrays import as_sample, as_selection

pytestmark = pytest.mark.slow

SIZE = 12  # one shape, which compiles once

whole_numbers = st.lists(st.integers(-20, 20), min_size=1, max_size=SIZE)
positive_numbers = st.lists(st.integers(1, 40), min_size=1, max_size=SIZE)
positive_floats = st.lists(
    st.floats(2.0**-60, 2.0**60, allow_subnormal=False, width=32), min_size=1, max_size=SIZE
)


def padded(sample, dtype, filler=np.nan):
    """Put the sample in a fixed-size array; also return the mask of its entries."""
    values = np.full(SIZE, filler, dtype)
    values[: len(sample)] = sample
    return values, np.arange(SIZE) < len(sample)


def exact_splits(sample):
    """Return (criterion, lower, upper) of all splits between distinct neighbors, as fractions."""
    ordered = sorted(Fraction(v) for v in sample)
    splits = []
    for k in range(1, len(ordered)):
        low, high = ordered[:k], ordered[k:]
        if low[-1] < high[0]:
            difference = sum(high) / len(high) - sum(low) / len(low)
            splits.append((len(low) * len(high) * difference**2, low[-1], high[0]))
    return splits


def exact_otsu(sample):
    splits = exact_splits(sample)
    if not splits:
        return Fraction(min(sample))
    best = max(criterion for criterion, _, _ in splits)
    lower, upper = next(split[1:] for split in splits if split[0] == best)
    return (lower + upper) / 2


@settings(max_examples=300)
@given(sample=whole_numbers)
def test_otsu_equals_exact_arithmetic(x64, sample):
    assert filters.otsu(*padded(sample, np.float64)) == float(exact_otsu(sample))


@given(sample=st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=SIZE))
def test_otsu_attains_the_largest_criterion(dtype, sample):
    threshold = float(filters.otsu(*padded(sample, dtype)))
    splits = exact_splits(sample)
    if not splits:
        assert threshold == sample[0]
        return
    attained = [float(c) for c, lower, upper in splits if float(lower) <= threshold < float(upper)]
    assert len(attained) == 1, "the threshold lies between two distinct neighbours"
    best = max(float(criterion) for criterion, _, _ in splits)
    assert attained[0] >= best * (1 - 40 * np.finfo(dtype).eps)


@given(sample=whole_numbers, shift=st.integers(-50, 50), factor=st.sampled_from([1e-3, 0.7, 900.0]))
def test_otsu_follows_shift_and_scale(dtype, sample, shift, factor):
    values, member = padded(sample, dtype)
    threshold = filters.otsu(values, member)
    moved = filters.otsu(((values + shift) * factor).astype(dtype), member)
    expected = (float(threshold) + shift) * factor
    np.testing.assert_allclose(moved, expected, rtol=1e-5, atol=1e-5 * factor)


@given(sample=positive_numbers, factor=st.sampled_from([1e-6, 0.3, 7.0, 1e9]))
def test_log_otsu_follows_scale(dtype, sample, factor):
    values, member = padded(sample, dtype)
    threshold = filters.log_otsu(values, member)
    scaled = filters.log_otsu(values * dtype.type(factor), member)
    np.testing.assert_allclose(scaled, threshold * dtype.type(factor), rtol=4 * np.finfo(dtype).eps)


@given(sample=positive_floats)
def test_log_otsu_is_otsu_of_the_logarithms(x64, sample):
    values, member = padded(sample, np.float64)
    expected = jnp.exp(filters.otsu(np.log(values), member))
    np.testing.assert_allclose(filters.log_otsu(values, member), expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["otsu", "log_otsu", "otsu_separability"])
@given(sample=positive_floats, data=st.data())
def test_order_does_not_matter(name, sample, data):
    estimate = getattr(filters, name)
    values, member = padded(sample, np.float32)
    order = np.array(data.draw(st.permutations(range(SIZE))))
    assert estimate(values, member) == estimate(values[order], member[order])


@pytest.mark.parametrize("name", ["otsu", "log_otsu", "otsu_separability"])
@pytest.mark.parametrize("filler", [np.nan, np.inf, -np.inf, 0.0, 1e30])
@given(sample=positive_floats)
def test_masked_out_is_left_out(name, filler, sample):
    estimate = getattr(filters, name)
    alone = estimate(*padded(sample, np.float32))
    assert estimate(*padded(sample, np.float32, filler)) == alone


@pytest.mark.parametrize("name", ["otsu", "log_otsu", "otsu_separability"])
def test_mask_equals_a_shorter_array(dtype, name):
    estimate = getattr(filters, name)
    values = np.random.default_rng(0).lognormal(size=50).astype(dtype)
    member = np.random.default_rng(1).random(50) < 0.6
    np.testing.assert_allclose(
        estimate(values, member), estimate(values[member]), rtol=4 * np.finfo(dtype).eps
    )


@pytest.mark.parametrize("name", ["otsu", "log_otsu", "otsu_separability"])
def test_jit_and_vmap_equal_the_plain_function(dtype, name):
    estimate = getattr(filters, name)
    values = np.random.default_rng(2).lognormal(size=(5, 30)).astype(dtype)
    member = np.random.default_rng(3).random((5, 30)) < 0.7
    plain = np.array([estimate(v, m) for v, m in zip(values, member, strict=True)])
    assert plain.dtype == dtype
    tolerance = 8 * np.finfo(dtype).eps
    batched = jax.jit(jax.vmap(estimate))(values, member)
    np.testing.assert_allclose(batched, plain, rtol=tolerance)


@given(sample=whole_numbers)
def test_separability_is_the_explained_share_of_the_variance(x64, sample):
    splits = exact_splits(sample)
    mean = Fraction(sum(sample), len(sample))
    spread = sum((v - mean) ** 2 for v in sample)
    best = max((criterion for criterion, _, _ in splits), default=0)
    expected = float(best / len(sample) / spread) if splits else 0.0
    measured = filters.otsu_separability(*padded(sample, np.float64))
    np.testing.assert_allclose(measured, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("sample", "expected"),
    [
        ([1, 2, 9, 10], 5.5),  # two clumps
        ([0, 1, 2], 0.5),  # both splits are equally good: the lower one
        ([2, 5, 7, 9, 12], 6),  # again
        ([5, 5, 5], 5),  # nothing to split
        ([7], 7),
        ([3, 8], 5.5),
        ([1, 1, 1, 1, 2], 1.5),  # ties never fall on both sides
        ([np.nan, 3, np.inf, 8, -np.inf], 5.5),  # not finite: not in the sample
    ],
)
def test_otsu_by_hand(dtype, sample, expected):
    threshold = filters.otsu(np.array(sample, dtype))
    assert threshold == expected
    assert threshold.dtype == dtype


@pytest.mark.parametrize(
    ("sample", "expected"),
    [
        ([1, 4, 10_000], 200),  # sqrt(4 * 10000)
        ([0, 0, 1, 100], 10),  # zeros are below every threshold and not part of the estimate
        ([np.inf, 1, 100], 10),
        ([-3, 1, 100], 10),
        ([0.25], 0.25),
        ([0.1, 0.1], 0.1),  # exactly the value, which must pass its own threshold
    ],
)
def test_log_otsu_by_hand(dtype, sample, expected):
    assert filters.log_otsu(np.array(sample, dtype)) == dtype.type(expected)


@pytest.mark.parametrize("estimate", [filters.otsu, filters.log_otsu])
def test_without_values_nothing_is_too_large(dtype, estimate):
    assert estimate(np.zeros(0, dtype)) == np.inf
    assert estimate(np.ones(4, dtype), np.zeros(4, bool)) == np.inf
    assert estimate(np.full(4, np.nan, dtype)) == np.inf
    assert estimate(np.full(1, np.nan, dtype)) == np.inf
    assert filters.log_otsu(np.zeros(3, dtype)) == np.inf


def test_separability_without_anything_to_split(dtype):
    for sample in ([], [1], [2, 2, 2], [np.nan, np.nan]):
        assert filters.otsu_separability(np.array(sample, dtype)) == 0
    np.testing.assert_allclose(filters.otsu_separability(np.array([0, 1, 1], dtype)), 1, rtol=1e-6)


def test_whole_numbers_become_the_default_float():
    assert filters.otsu(np.array([1, 2, 9, 10])) == 5.5
    assert filters.otsu(jnp.array([1, 2, 9, 10])).dtype == jnp.float32
    large = np.array([1, 2, 10**12, 10**12 + 4])  # beyond 32 bits
    np.testing.assert_allclose(filters.otsu(large), 5e11)


@pytest.mark.parametrize("values", [np.array([1j, 2]), np.array(["1", "2"])])
def test_only_real_numbers_are_split(values):
    unchecked = inspect.unwrap(filters.otsu)  # as without type checks
    with pytest.raises(InvalidInputError, match="numbers"):
        unchecked(values)


def test_neighbouring_floats_are_still_separated(dtype):
    low = dtype.type(1)
    high = np.nextafter(low, dtype.type(2))
    threshold = np.asarray(filters.otsu(np.array([low, high], dtype)))
    assert low <= threshold < high
    assert low <= np.asarray(filters.log_otsu(np.array([low, high], dtype))) < high


def test_large_floats_do_not_overflow(dtype):
    largest = np.finfo(dtype).max / 100  # its square does not exist
    assert filters.otsu(np.array([0, largest / 4, largest], dtype)) > largest / 4
    assert np.isfinite(filters.log_otsu(np.array([largest / 4, largest], dtype)))
    end = np.finfo(dtype).max  # twice this does not exist
    assert filters.otsu_separability(np.array([-end, -end, end], dtype)) > 0.99
    assert filters.otsu(np.array([-end, -end / 2, end], dtype)) > -end / 2


@pytest.mark.parametrize("draw", ["lognormal", "two clumps", "far from zero"])
def test_many_float32_values_split_as_in_float64(x64, draw):
    random = np.random.default_rng(5)
    values = {
        "lognormal": random.lognormal(size=300_000),
        "two clumps": np.r_[random.normal(0, 1, 150_000), random.normal(8, 1, 150_000)],
        "far from zero": random.normal(1000, 1, 300_000),
    }[draw].astype(np.float32)
    ordered = np.sort(values.astype(np.float64))
    centred = ordered - ordered.mean()
    low = np.arange(1, len(ordered))
    criterion = np.cumsum(centred)[:-1] ** 2 / (low * (len(ordered) - low))
    criterion[ordered[:-1] == ordered[1:]] = -1
    best = np.argmax(criterion)
    threshold = float(filters.otsu(values))
    # Values between the two thresholds, of 300000.
    assert abs(np.searchsorted(ordered, threshold, "right") - (best + 1)) <= 30


@pytest.mark.parametrize("name", ["otsu", "log_otsu", "otsu_separability"])
@pytest.mark.parametrize(
    "sample", [[1, 2, 4, 8], [3, 3, 3, 3], [np.nan, np.inf, 0, 2], [np.nan] * 4, [0, 0, 0, 0]]
)
def test_gradient_is_finite(dtype, name, sample):
    values = jnp.asarray(np.array(sample, dtype))
    gradient = jax.grad(getattr(filters, name))(values)
    assert np.isfinite(gradient).all()


def test_gradient_is_that_of_the_midpoint(dtype):
    gradient = jax.grad(filters.otsu)(jnp.asarray(np.array([1, 2, 9, 10], dtype)))
    np.testing.assert_array_equal(gradient, [0, 0.5, 0.5, 0])


def test_masks_may_be_zeros_and_ones():
    mask = as_selection(np.array([1, 0, 1]), (3,))
    assert mask.dtype == bool
    assert float(filters.otsu(np.array([1.0, np.nan, 5.0]), mask)) == 3.0


@pytest.mark.parametrize("shape", [(), (2, 3)])
def test_a_sample_is_flat(shape):
    with pytest.raises(InvalidInputError, match=r"use jax\.vmap"):
        as_sample(np.ones(shape))
