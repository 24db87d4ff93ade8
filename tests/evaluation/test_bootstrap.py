"""Bootstrap intervals: laws, a slow resampling, and coverage of a known truth."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import evaluation
from catfree.errors import InsufficientDataError, InvalidInputError

RATES = ("moda", "modp", "precision", "recall")


def from_counts(tp, fp, fn, distance=0.1):
    tp = np.asarray(tp)
    return evaluation.DetectionMetrics(
        frames=np.arange(len(tp)),
        tp_per_frame=tp,
        fp_per_frame=np.asarray(fp),
        fn_per_frame=np.asarray(fn),
        distance_sum_per_frame=tp * distance,
        threshold=0.5,
    )


counts = st.lists(
    st.tuples(st.integers(1, 20), st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=12
).map(lambda frames: from_counts(*np.array(frames).T))


@given(counts, st.integers(0, 100))
def test_intervals_are_ordered_and_repeatable(metrics, seed):
    intervals = evaluation.bootstrap(metrics, 200, seed=seed)
    assert intervals == evaluation.bootstrap(metrics, 200, seed=seed)
    wider = evaluation.bootstrap(metrics, 200, seed=seed, level=0.99)
    for name in RATES:
        interval = getattr(intervals, name)
        assert interval.low <= interval.high <= 100
        assert interval.value == getattr(metrics, name)
        assert getattr(wider, name).low <= interval.low
        assert getattr(wider, name).high >= interval.high


@given(st.integers(1, 9), st.integers(0, 5), st.integers(0, 5), st.integers(1, 10), st.data())
def test_frames_that_are_all_alike_give_a_point(tp, fp, fn, frames, data):
    metrics = from_counts([tp] * frames, [fp] * frames, [fn] * frames)
    block = data.draw(st.integers(1, frames))
    intervals = evaluation.bootstrap(metrics, 50, block_length=block)
    for name in RATES:
        assert getattr(intervals, name) == pytest.approx((getattr(metrics, name),) * 3)


@given(counts)
def test_one_block_of_everything_is_the_sequence_itself(metrics):
    intervals = evaluation.bootstrap(metrics, 20, block_length=len(metrics.frames))
    assert intervals.moda == pytest.approx((metrics.moda,) * 3)


def test_equals_resampling_one_by_one():
    random = np.random.default_rng(1)
    metrics = from_counts(*random.integers(1, 10, (3, 7)))
    block, samples, n = 3, 400, 7
    starts = np.random.default_rng(5).integers(n, size=(samples, 3))
    modas = []
    for row in starts:
        frames = [(start + k) % n for start in row for k in range(block)][:n]
        tp, fp, fn = (
            sum(int(array[f]) for f in frames)
            for array in (metrics.tp_per_frame, metrics.fp_per_frame, metrics.fn_per_frame)
        )
        modas.append(100 * (1 - (fp + fn) / (tp + fn)))
    intervals = evaluation.bootstrap(metrics, samples, seed=5, block_length=block)
    modas.sort()
    tail = 0.025 * (samples - 1)
    assert intervals.moda.low == pytest.approx(modas[math.floor(tail)])
    assert intervals.moda.high == pytest.approx(modas[math.ceil(samples - 1 - tail)])


def test_width_agrees_with_the_normal_approximation():
    # For recall of independent frames with 20 people each: variance of a ratio of sums.
    random = np.random.default_rng(0)
    tp = random.binomial(20, 0.7, 400)
    metrics = from_counts(tp, np.zeros(400, int), 20 - tp)
    interval = evaluation.bootstrap(metrics, 4000).recall
    half_width = 1.96 * 100 * np.std(tp / 20) / math.sqrt(400)
    assert (interval.high - interval.low) / 2 == pytest.approx(half_width, rel=0.06)


def test_blocks_widen_the_interval_of_slowly_changing_errors():
    tp = np.repeat([18, 2, 15, 5, 19, 1, 12, 8], 25)
    metrics = from_counts(tp, np.zeros(200, int), 20 - tp)
    single, blocks = (evaluation.bootstrap(metrics, block_length=b).recall for b in (1, 25))
    assert blocks.high - blocks.low > 2 * (single.high - single.low)


def test_resamples_without_ground_truth_do_not_break_it():
    metrics = from_counts([1, 0], [0, 1], [0, 0])
    interval = evaluation.bootstrap(metrics).moda
    assert (interval.low, interval.high) == (-math.inf, 100.0)
    nothing = evaluation.bootstrap(from_counts([0], [0], [0])).moda
    assert all(math.isnan(value) for value in nothing)


def test_bad_arguments_are_refused():
    metrics = from_counts([1, 2], [0, 0], [0, 0])
    with pytest.raises(InsufficientDataError, match="0 frames"):
        evaluation.bootstrap(from_counts(*np.zeros((3, 0), int)))
    with pytest.raises(InvalidInputError, match="block_length is 3; it must be between 1 and 2"):
        evaluation.bootstrap(metrics, block_length=3)
    for samples, level in ((0, 0.95), (10, 1.0)):
        with pytest.raises(InvalidInputError, match=r"^samples is"):
            evaluation.bootstrap(metrics, samples, level=level)
    with pytest.raises(InvalidInputError, match="level is nan"):
        evaluation.bootstrap(metrics, level=math.nan)


def test_one_line_summary():
    intervals = evaluation.bootstrap(from_counts([1], [0], [1]), 10)
    assert str(intervals).startswith("MODA 50.00 [50.00, 50.00]  MODP 80.00")
    assert str(intervals).endswith("(95 % intervals)")
