"""Persistence of matches against sets of frames."""

import collections
import inspect
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError

CAMERAS = 3

hypotheses = st.lists(
    st.tuples(
        st.integers(0, 4),  # frame
        st.lists(st.integers(-1, 3), min_size=CAMERAS, max_size=CAMERAS),  # tracklet of each camera
        st.booleans(),
    ),
    max_size=12,
)


def table(drawn):
    frame = np.array([row[0] for row in drawn], np.int64)
    tracklet = np.array([row[1] for row in drawn], np.int64).reshape(len(drawn), CAMERAS)
    # Unique over all cameras, and large enough to overflow a product in int32.
    tracklet = np.where(tracklet >= 0, tracklet * 10_000_019 + np.arange(CAMERAS), -1)
    return frame, tracklet, np.array([row[2] for row in drawn], bool)


def frames_by_hand(frame, tracklet, where):
    pairs = [
        set(itertools.combinations([t for t in row if t >= 0], 2)) if counts else set()
        for row, counts in zip(tracklet.tolist(), where, strict=True)
    ]
    seen = collections.defaultdict(set)
    for f, of_row in zip(frame.tolist(), pairs, strict=True):
        for pair in of_row:
            seen[pair].add(f)
    return [max((len(seen[pair]) for pair in of_row), default=0) for of_row in pairs]


@given(drawn=hypotheses)
def test_frames_equal_sets(drawn):
    assert filters.frames_of_pairs(*table(drawn)).tolist() == frames_by_hand(*table(drawn))


@given(drawn=hypotheses, minimum=st.integers(0, 4))
def test_kept_is_seen_often_enough(drawn, minimum):
    frame, tracklet, where = table(drawn)
    keep = filters.temporally_consistent(frame, tracklet, where, minimum_frames=minimum)
    enough = np.array(frames_by_hand(frame, tracklet, where), int) >= minimum
    np.testing.assert_array_equal(keep, where & enough if minimum > 1 else where)


@given(drawn=hypotheses, data=st.data())
def test_order_and_names_do_not_matter(drawn, data):
    frame, tracklet, where = table(drawn)
    rows = np.array(data.draw(st.permutations(range(len(frame)))), int)
    cameras = np.array(data.draw(st.permutations(range(CAMERAS))))
    plain = filters.temporally_consistent(frame, tracklet, where)
    other = filters.temporally_consistent(
        frame[rows] * 100 + 7, tracklet[rows][:, cameras], where[rows]
    )
    np.testing.assert_array_equal(other, plain[rows])


def test_masked_out_is_left_out():
    frame, tracklet = np.array([0, 1]), np.array([[5, 6], [5, 6]])
    assert filters.temporally_consistent(frame, tracklet).tolist() == [True, True]
    masked = filters.temporally_consistent(frame, tracklet, np.array([True, False]))
    assert masked.tolist() == [False, False]


@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_persistence_by_hand(convert):
    frame = convert(np.array([0, 1, 1, 2, 2], np.int32))
    tracklet = convert(
        np.array(
            [
                [1, 2, 3],  # its pair (1, 2) recurs in frame 1
                [1, 2, 4],
                [1, -1, 5],  # (1, 5) is seen only in frame 1
                [8, 9, -1],  # twice, but in the same frame
                [8, 9, -1],
            ],
            np.int32,
        )
    )
    assert filters.temporally_consistent(frame, tracklet).tolist() == [
        True,
        True,
        False,
        False,
        False,
    ]
    assert filters.frames_of_pairs(frame, tracklet).tolist() == [2, 2, 1, 1, 1]
    everyone = filters.temporally_consistent(frame, tracklet, minimum_frames=1)
    assert everyone.tolist() == [True] * 5


def test_nothing_to_compare():
    assert filters.temporally_consistent(np.zeros(0, int), np.zeros((0, 4), int)).shape == (0,)
    assert not filters.temporally_consistent(np.zeros(2, int), np.array([[1], [1]])).any()
    assert not filters.temporally_consistent(np.arange(2), np.full((2, 3), -1)).any()


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ([0, 2], r"where\[1\] is neither true nor false"),
        ([True], r"where must have shape \(2\), got \(1,\)"),
    ],
)
def test_a_mask_that_is_none_is_named(where, message):
    frame, tracklet = np.array([0, 1]), np.array([[5, 6], [5, 6]])
    for function in (filters.temporally_consistent, filters.frames_of_pairs):
        unchecked = inspect.unwrap(function)  # bypass the tests' type checks
        with pytest.raises(InvalidInputError, match=message):
            unchecked(frame, tracklet, where)


@pytest.mark.parametrize(
    ("frame", "tracklet", "message"),
    [
        ([0, 1], [0, 1], r"tracklet must have shape \(2, n\), got \(2,\)"),
        ([0, 1], [[0, 1]], r"tracklet must have shape \(2, n\), got \(1, 2\)"),
        ([0, 0.5], [[0, 1]] * 2, r"frame\[1\] is 0.5"),
        (0, [[0, 1]], r"frame must have shape \(n\), got \(\)"),
        ([[0, 1]], [[0, 1]], r"frame must have shape \(n\), got \(1, 2\)"),
    ],
)
def test_what_is_no_table_of_tracklets_is_named(monkeypatch, frame, tracklet, message):
    # Bypass the tests' type checks.
    consistent, count = map(
        inspect.unwrap, (filters.temporally_consistent, filters.frames_of_pairs)
    )
    with pytest.raises(InvalidInputError, match=message):
        count(frame, tracklet)
    monkeypatch.setattr("catfree.filters._temporal.frames_of_pairs", count)
    for least in (1, 2):
        with pytest.raises(InvalidInputError, match=message):
            consistent(frame, tracklet, minimum_frames=least)
