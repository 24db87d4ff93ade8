"""The gates in every order of the ablation, against the rules written out with NumPy."""

import functools
import inspect
import math
from typing import get_args

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError
from catfree.filters._gates import quantile
from catfree.settings import Selection

SIZE = 10
EVERY_ORDER = get_args(Selection)

select = jax.jit(filters.select, static_argnames=("gates", "fixed_quantile"))

# Whole numbers have exact ties; 0 stands for sigma = inf.
rows = st.lists(
    st.tuples(st.integers(0, 30), st.integers(1, 30), st.integers(0, 12), st.booleans()),
    max_size=SIZE,
)


def arrays(drawn, dtype=np.float32):
    """Make columns sigma, g, weighted support and candidate, padded with irrelevant values."""
    sigma, distance, weight = np.full((3, SIZE), np.nan, dtype)
    candidate = np.zeros(SIZE, bool)
    for i, (s, g, w, is_candidate) in enumerate(drawn):
        sigma[i], distance[i], weight[i], candidate[i] = s or np.inf, g, w, is_candidate
    return sigma, distance, weight, candidate


def otsu_by_hand(sample):
    ordered = np.sort(sample)
    best, threshold = -1.0, ordered[0] if len(ordered) else np.inf
    for k in range(1, len(ordered)):
        low, high = ordered[:k], ordered[k:]
        criterion = len(low) * len(high) * (high.mean() - low.mean()) ** 2
        if low[-1] < high[0] and criterion > best * (1 + 1e-12):
            best, threshold = criterion, (low[-1] + high[0]) / 2
    return threshold


def keep_by_hand(sigma, distance, weight, candidate, gates):
    def below(values, members):
        sample = values[members & np.isfinite(values)]
        return (values <= math.exp(otsu_by_hand(np.log(sample))) * (1 + 1e-9)) & np.isfinite(values)

    everyone = candidate
    weight_sample = weight[everyone]
    supported = everyone & (weight >= (otsu_by_hand(weight_sample) if len(weight_sample) else 0))
    certain, grounded = everyone & below(sigma, everyone), everyone & below(distance, everyone)
    return {
        "none": everyone,
        "support": supported,
        "ground_only": supported & grounded,
        "uncertainty_add": supported & certain,
        "uncertainty_replace": certain,
        "ground_then_uncertainty_replace": grounded & below(sigma, grounded),
        "ground_then_uncertainty_add": supported & grounded & certain,
        "uncertainty_then_ground": certain & below(distance, certain),
    }[gates]


@pytest.mark.slow
@pytest.mark.parametrize("gates", EVERY_ORDER)
@given(drawn=rows)
def test_every_order_equals_its_rule(x64, gates, drawn):
    table = arrays(drawn, np.float64)
    np.testing.assert_array_equal(
        select(*table, gates=gates).keep, keep_by_hand(*table, gates=gates)
    )


@pytest.mark.slow
@pytest.mark.parametrize("gates", EVERY_ORDER)
@given(drawn=rows)
def test_every_candidate_has_one_fate(gates, drawn):
    table = arrays(drawn)
    outcome = select(*table, gates=gates)
    fates = np.stack([outcome.keep, outcome.uncertain, outcome.off_ground, outcome.unsupported])
    np.testing.assert_array_equal(fates.sum(0), table[3])


@pytest.mark.slow
@pytest.mark.parametrize("gates", EVERY_ORDER)
@pytest.mark.parametrize("fixed_quantile", [None, 0.6])
@given(drawn=rows, data=st.data())
def test_order_and_unit_do_not_matter(gates, fixed_quantile, drawn, data):
    table = arrays(drawn)
    order = np.array(data.draw(st.permutations(range(SIZE))))
    run = functools.partial(select, gates=gates, fixed_quantile=fixed_quantile)
    keep = np.asarray(run(*table).keep)
    np.testing.assert_array_equal(run(*(column[order] for column in table)).keep, keep[order])
    sigma, distance, weight, candidate = table
    factor = np.float32(2.0**12)  # exact, so rounding moves nothing across a threshold
    np.testing.assert_array_equal(
        run(sigma * factor, distance * factor, weight, candidate).keep, keep
    )


@pytest.mark.slow
@pytest.mark.parametrize("fixed_quantile", [None, 0.3])
def test_the_second_threshold_comes_from_the_survivors(fixed_quantile):
    random = np.random.default_rng(0)
    sigma, distance, weight = random.lognormal(size=(3, 200)).astype(np.float32)
    everyone = np.ones(200, bool)
    outcome = select(sigma, distance, weight, everyone, fixed_quantile=fixed_quantile)
    estimate = filters.log_otsu if fixed_quantile is None else lambda v: np.quantile(v, 0.3)
    np.testing.assert_allclose(outcome.tau_sigma, estimate(sigma), rtol=1e-6)
    np.testing.assert_allclose(
        outcome.tau_g, estimate(distance[sigma <= outcome.tau_sigma]), rtol=1e-6
    )
    assert outcome.tau_support == -np.inf


@pytest.mark.slow
def test_orders_by_hand():
    # Three good hypotheses; one uncertain, one off the ground, one with little support.
    sigma = np.array([1, 1.1, 1.2, 50, 1.1, 1.0], np.float32)
    distance = np.array([0.1, 0.12, 0.11, 0.1, 5.0, 0.13], np.float32)
    weight = np.array([4, 4.2, 4.1, 3.9, 4.0, 0.5], np.float32)
    everyone = np.ones(6, bool)
    final = filters.select(sigma, distance, weight, everyone)
    np.testing.assert_array_equal(np.flatnonzero(final.keep), [0, 1, 2, 5])
    np.testing.assert_array_equal(np.flatnonzero(final.uncertain), [3])
    np.testing.assert_array_equal(np.flatnonzero(final.off_ground), [4])
    np.testing.assert_allclose(final.tau_sigma, math.sqrt(1.2 * 50), rtol=1e-6)
    np.testing.assert_allclose(final.tau_g, math.sqrt(0.13 * 5), rtol=1e-6)
    added = filters.select(sigma, distance, weight, everyone, gates="ground_then_uncertainty_add")
    np.testing.assert_array_equal(np.flatnonzero(added.keep), [0, 1, 2])
    np.testing.assert_array_equal(np.flatnonzero(added.unsupported), [5])


@pytest.mark.slow
def test_infinite_sigma_is_never_certain():
    sigma = np.full(4, np.inf, np.float32)
    ones = np.ones(4, np.float32)
    outcome = filters.select(sigma, ones, ones, np.ones(4, bool), gates="uncertainty_replace")
    assert not outcome.keep.any()
    assert outcome.uncertain.all()
    ignored = filters.select(sigma, ones, ones, np.ones(4, bool), gates="support")
    assert ignored.keep.all()


@pytest.mark.slow
@pytest.mark.parametrize("gates", EVERY_ORDER)
@pytest.mark.parametrize("count", [0, 1, 3])
def test_equal_hypotheses_all_pass(dtype, gates, count):
    same = np.full(count, 0.1, dtype)
    outcome = filters.select(same, same, same, np.ones(count, bool), gates=gates)
    assert outcome.keep.shape == (count,)
    assert outcome.keep.all()
    assert outcome.tau_sigma.dtype == outcome.tau_g.dtype == outcome.tau_support.dtype == dtype


@pytest.mark.slow
@pytest.mark.parametrize("gates", EVERY_ORDER)
def test_a_point_on_the_ground_passes_the_ground_gate(gates):
    distance = np.array([0, 0, 1, 1.1, 40], np.float32)
    same = np.ones(5, np.float32)
    outcome = filters.select(same, distance, same, np.ones(5, bool), gates=gates)
    assert outcome.keep[:2].all()


def test_candidates_may_be_zeros_and_ones():
    sigma = np.array([1.0, 2.0, 30.0, 40.0])
    unchecked = inspect.unwrap(filters.select)  # bypass the tests' type checks
    gates = unchecked(sigma, sigma, sigma, np.array([1, 1, 1, 0]))
    assert {mask.dtype for mask in gates[:4]} == {np.dtype(bool)}
    np.testing.assert_array_equal(gates.keep, [True, False, False, False])
    with pytest.raises(InvalidInputError, match=r"candidate must have shape \(4\)"):
        unchecked(sigma, sigma, sigma, np.ones(1, bool))


def test_a_quantile_outside_its_range_is_an_error():
    one = np.ones(1, np.float32)
    with pytest.raises(InvalidInputError, match=r"fixed_quantile is 1\.5"):
        filters.select(one, one, one, one > 0, fixed_quantile=1.5)
    unchecked = inspect.unwrap(filters.select)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match="fixed_quantile is 'a'; it must be a finite numbe"):
        unchecked(one, one, one, one > 0, fixed_quantile="a")


@pytest.mark.slow
@given(
    sample=st.lists(st.floats(-100, 100, width=32), min_size=1, max_size=SIZE),
    share=st.floats(0, 1, width=32),
)
def test_quantile_equals_numpy(x64, sample, share):
    values = np.full(SIZE, np.nan)
    values[: len(sample)] = sample
    expected = np.quantile(sample, share)
    np.testing.assert_allclose(quantile(values, share), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_quantile_without_values(dtype):
    assert quantile(np.zeros(0, dtype), 0.5) == np.inf
    assert quantile(np.full(3, np.nan, dtype), 0.5) == np.inf


@pytest.mark.parametrize("gates", ["all", ["support"], None])
def test_gates_that_do_not_exist_are_named_with_those_that_do(gates):
    unchecked = inspect.unwrap(filters.select)  # as without type checks
    with pytest.raises(InvalidInputError, match="uncertainty_then_ground"):
        unchecked(np.ones(2), np.ones(2), np.ones(2), np.ones(2, bool), gates=gates)
