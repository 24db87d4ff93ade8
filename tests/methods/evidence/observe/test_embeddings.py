"""Embeddings become unit vectors, whichever rows of the caller's array are used."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.methods.evidence.observe import _embeddings
from catfree.methods.evidence.observe._embeddings import embeddings_of


@given(st.integers(0, 10**6), st.integers(0, 30), st.sampled_from([np.float32, np.float64]))
def test_vectors_are_those_of_the_callers_rows_and_of_unit_length(seed, count, dtype):
    rng = np.random.default_rng(seed)
    raw = (rng.normal(size=(count, 5)) * 10.0 ** rng.uniform(-4, 4, (count, 1))).astype(dtype)
    raw[rng.random(count) < 0.2] = 0
    row = rng.permutation(count)[: count // 2]
    found = embeddings_of(raw, row)
    unit = found[np.arange(len(row))]
    assert unit.dtype == np.float32
    assert unit.shape == (len(row), found.dim)
    blank = ~raw[row].any(axis=1)
    np.testing.assert_array_equal(found.length == 0, blank)
    np.testing.assert_array_equal(unit[blank], 0)
    np.testing.assert_allclose(np.linalg.norm(unit[~blank], axis=1), 1, rtol=1e-6)
    along = unit * np.linalg.norm(raw[row].astype(float), axis=1, keepdims=True)
    np.testing.assert_allclose(along, raw[row], rtol=1e-5)
    part = slice(len(row) // 3, len(row))
    np.testing.assert_array_equal(found.of_boxes(part)[:], unit[part])


@pytest.mark.parametrize("block", [1, 7])
def test_lengths_are_the_same_a_few_at_a_time(monkeypatch, block):
    raw = np.random.default_rng(0).normal(size=(20, 3))
    whole = embeddings_of(raw, np.arange(20))
    monkeypatch.setattr(_embeddings, "BLOCK", block)
    np.testing.assert_array_equal(embeddings_of(raw, np.arange(20)).length, whole.length)


def test_many_boxes_of_groups_are_taken_at_once():
    raw = np.random.default_rng(0).normal(size=(12, 3))
    found = embeddings_of(raw, np.arange(12))
    table = np.arange(12).reshape(3, 4)
    np.testing.assert_array_equal(found[table], found[:].reshape(3, 4, 3))
