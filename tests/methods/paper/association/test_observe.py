"""Canonical order, time steps, ranges, appearance distances."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Detections
from catfree.methods.paper.association import observe
from catfree.methods.paper.association._observe import (
    appearance_distance,
    time_steps,
)
from catfree.synthetic import make_layout
from catfree.types._sampling import expand_ranges

RIG = make_layout("ring4").rig

RANGES = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=8)


@given(RANGES)
def test_ranges_are_expanded_like_nested_loops(ranges):
    start, stop = np.array(ranges, int).reshape(-1, 2).T
    i, j = expand_ranges(start, stop)
    wanted = [(n, k) for n, (low, high) in enumerate(ranges) for k in range(low, high)]
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == wanted


@pytest.mark.parametrize(
    ("frames", "steps"),
    [
        ([], []),
        ([7], [0]),
        ([3, 90], [0, 1]),
        ([0, 5, 10, 15], [0, 1, 2, 3]),
        ([0, 5, 10, 25, 30], [0, 1, 2, 5, 6]),  # two frames without any detection
        ([0, 1, 3], [0, 1, 3]),
        ([-4, -3, -1, 0, 1], [0, 1, 3, 4, 5]),
        ([0, 33, 67, 100, 200, 233], [0, 1, 2, 3, 6, 7]),  # milliseconds
    ],
)
def test_the_usual_distance_of_frames_is_one_step(frames, steps):
    assert time_steps(np.array(frames, np.int64)).tolist() == steps


@given(
    st.lists(st.integers(0, 50), min_size=2, unique=True).map(sorted),
    st.integers(1, 40),
    st.integers(-1000, 1000),
)
def test_steps_do_not_depend_on_how_frames_are_numbered(frames, factor, offset):
    frames = np.array(frames)
    steps = time_steps(frames)
    np.testing.assert_array_equal(time_steps(factor * frames + offset), steps)
    assert (np.diff(steps) >= 1).all()


ROW = st.tuples(
    st.integers(-3, 3), st.integers(0, 3), st.integers(0, 40), st.integers(0, 40), st.booleans()
)


def detections(rows) -> Detections:
    frame, camera, x, y, ankles = np.array(rows, int).reshape(-1, 5).T
    box = np.stack([x, y, x + 10, y + 30 + x % 3], axis=-1)
    looks = np.stack([x, y, np.ones(len(x))], axis=-1)
    return Detections(frame, camera, box, x / 50, ankles.astype(bool), looks)


@given(st.lists(ROW, min_size=1, max_size=20, unique_by=lambda row: row[:4]), st.randoms())
def test_the_callers_order_has_no_effect(rows, random):
    shuffled = list(range(len(rows)))
    random.shuffle(shuffled)
    everything = np.ones(len(rows), bool)
    seen = observe(detections(rows), RIG, keep=everything)
    other = observe(detections([rows[i] for i in shuffled]), RIG, keep=everything)
    np.testing.assert_array_equal(np.array(shuffled)[other.row], seen.row)
    jax.tree.map(np.testing.assert_array_equal, replace(other, row=seen.row), seen)


@given(st.lists(ROW, min_size=1, max_size=20), st.data())
def test_cells_hold_the_detections_of_one_camera_and_frame(rows, data):
    keep = np.array(data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows))))
    seen = observe(detections(rows), RIG, keep=keep)
    given_rows = detections(rows)
    assert sorted(seen.row.tolist()) == np.flatnonzero(keep).tolist()
    np.testing.assert_array_equal(seen.kept.box, given_rows.box[seen.row])
    np.testing.assert_array_equal(seen.frames[seen.frame_index], given_rows.frame[seen.row])
    assert seen.cell_start[0] == 0
    assert seen.cell_start[-1] == len(seen)
    for cell, (begin, end) in enumerate(zip(seen.cell_start, seen.cell_start[1:], strict=False)):
        assert (seen.frame_index[begin:end] == cell // 4).all()
        assert (seen.kept.camera[begin:end] == cell % 4).all()
    starts = seen.frame_start(np.arange(len(seen.frames) + 1))
    np.testing.assert_array_equal(
        np.repeat(np.arange(len(seen.frames)), np.diff(starts)), seen.frame_index
    )


def test_appearance_is_normalised_and_zero_stays_zero():
    seen = Detections([0, 0], [0, 1], [[0, 0, 1, 1]] * 2, embedding=[[3.0, 4.0], [0, 0]])
    looks = observe(seen, RIG, keep=np.ones(2, bool)).appearance
    assert looks is not None
    np.testing.assert_allclose(looks, [[0.6, 0.8], [0, 0]], atol=1e-7)


def test_appearance_distance_is_the_cosine_distance():
    looks = np.array([[1, 0], [0, 1], [-1, 0], [0, 0]], np.float32)
    first, second = np.array([0, 0, 0, 0]), np.array([0, 1, 2, 3])
    np.testing.assert_array_equal(appearance_distance(looks, first, second), [0, 1, 2, 1])
    wide = np.zeros((3, 5_000_000), np.float32)  # one pair at a time
    wide[:, 0] = [1, 1, -1]
    np.testing.assert_array_equal(
        appearance_distance(wide, np.array([0, 0]), np.array([1, 2])), [0, 2]
    )
