"""Padded lengths: long enough, never longer than guaranteed, and few."""

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.geometry._buckets import in_blocks, padded, padded_length

counts = st.integers(0, 10**6)
blocks = st.integers(1, 10**4)


@given(counts, blocks, st.integers(2, 4))
def test_padded_lengths_are_powers_times_the_block(count, block, factor):
    length = padded_length(count, block, factor)
    assert length >= count
    assert length == block or length < factor * count
    while length > block:
        length, rest = divmod(length, factor)
        assert rest == 0
    assert length == block


@given(counts, counts)
def test_longer_arrays_never_get_shorter_lengths(count, other):
    low, high = sorted((count, other))
    assert padded_length(low, 64) <= padded_length(high, 64)


@pytest.mark.slow
def test_few_lengths_serve_a_million_rows():
    assert {padded_length(count, 16384) for count in range(1, 10**6, 37)} == {
        16384 * 4**power for power in range(4)
    }


@given(st.integers(0, 40), st.sampled_from([1, 4, 16]))
def test_blocks_give_what_one_call_gives(count, block):
    rng = np.random.default_rng(count)
    rows = (rng.standard_normal((count, 3)), {"weight": rng.random(count)})
    lengths = []

    def function(x, named):
        lengths.append(len(x))
        return x.sum(1) * named["weight"], (x * 2, named["weight"] > 0.5)

    total, (double, heavy) = in_blocks(function, rows, block)
    np.testing.assert_array_equal(total, rows[0].sum(1) * rows[1]["weight"])
    np.testing.assert_array_equal(double, rows[0] * 2)
    np.testing.assert_array_equal(heavy, rows[1]["weight"] > 0.5)
    assert set(lengths) == {block}


def test_blocks_compile_once_and_keep_shapes_without_rows():
    @jax.jit
    def function(x, y):
        return x @ y.T, y

    for count in (0, 1, 7, 8, 9, 30):
        first, second = in_blocks(lambda x: function(x, x), (np.ones((count, 2)),), 8)
        assert first.shape == (count, 8)
        assert second.shape == (count, 2)
    assert function._cache_size() == 1


@pytest.mark.slow
@given(st.integers(0, 5), st.integers(0, 5), st.integers(0, 3), st.integers(0, 3))
def test_padding_keeps_the_array_and_adds_zeros(rows, columns, more, extra):
    array = np.ones((rows, columns, 2), np.float32)
    found = np.asarray(padded(array, rows + more, columns + extra))
    assert found.shape == (rows + more, columns + extra, 2)
    np.testing.assert_array_equal(found[:rows, :columns], array)
    assert found.sum() == array.sum()
