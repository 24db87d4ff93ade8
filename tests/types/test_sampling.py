import numpy as np
from hypothesis import given, strategies as st

from catfree.types._sampling import (
    common_step,
    evenly_spread,
    frame_step,
    mutually_lowest,
    rows_of_picture,
)


@given(st.integers(0, 300), st.integers(1, 120))
def test_spread_rows_are_distinct_in_order_and_as_even_as_whole_steps_allow(count, most):
    rows = np.arange(count)
    chosen = evenly_spread(rows, most)
    assert len(chosen) == min(count, most)
    assert (np.diff(chosen) > 0).all()
    if count and most > 1:
        assert chosen[0] == 0
        assert chosen[-1] == count - 1
        # Rounded, not truncated: no row is farther than half a step from its even place.
        even = np.linspace(0, count - 1, len(chosen))
        assert (np.abs(chosen - even) <= 0.5).all()


def test_spread_rows_keep_their_columns():
    rows = np.arange(20).reshape(10, 2)
    np.testing.assert_array_equal(evenly_spread(rows, 4), rows[[0, 3, 6, 9]])


def test_the_step_of_frames_is_their_usual_distance():
    assert frame_step(np.array([0, 40, 80, 200, 240])) == 40
    assert frame_step(np.array([7])) == frame_step(np.zeros(0, int)) == 1


def test_common_step():
    assert common_step(np.array([35, 5, 20, 5])) == 15
    assert common_step(np.array([7, 7])) == common_step(np.zeros(0, int)) == 1


@given(st.integers(0, 10**6), st.integers(0, 60), st.integers(0, 9), st.integers(0, 3))
def test_rows_of_a_picture_are_those_of_its_frame_and_camera(seed, n, frame, camera):
    rng = np.random.default_rng(seed)
    frames, cameras = np.sort(rng.integers(0, 8, n)), rng.integers(0, 3, n)
    np.testing.assert_array_equal(
        rows_of_picture(frames, cameras, frame, camera),
        np.flatnonzero((frames == frame) & (cameras == camera)),
    )


@given(st.integers(0, 10**6), st.integers(0, 30))
def test_mutually_lowest_pairs_are_the_first_best_of_both_members(seed, n):
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, 5, (2, n))
    cost = rng.integers(0, 4, n).astype(float)  # many are equal
    cost[cost == 3] = np.inf

    def first_best(members, pair):
        same = [k for k in range(n) if members[k] == members[pair]]
        return np.isfinite(cost[pair]) and min(same, key=lambda k: cost[k]) == pair

    expected = [first_best(one, pair) and first_best(other, pair) for pair in range(n)]
    assert mutually_lowest(cost, one, other).tolist() == expected
