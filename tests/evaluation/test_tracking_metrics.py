"""Tracking metrics: laws, an independent evaluator, hand-made cases, reference values."""

import itertools
import json
import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree import evaluation
from catfree.errors import InvalidInputError

# A grid of 1/8 m: sums, differences and squares of such numbers are exact in floating point, so
# laws hold exactly even where distances fall on the gate.
GRID = 8
COUNTS = (
    *("num_ground_truth", "num_predictions", "num_objects", "num_matches", "id_switches"),
    *("fp", "fn", "idtp", "idfp", "idfn", "fragmentations"),
    *("mostly_tracked", "partially_tracked", "mostly_lost"),
)


@st.composite
def tables(draw, frames=5, identities=4, extent=20):
    """Draw rows of a few people over a few frames, present or absent, anywhere on the grid."""
    cell = st.integers(-extent, extent).map(lambda value: value / GRID)
    keys = [(f, i) for f in range(frames) for i in range(identities)]
    present = draw(st.lists(st.sampled_from(keys), unique=True, max_size=len(keys)))
    table = [[f, i, draw(cell), draw(cell)] for f, i in present]
    return np.array(table, dtype=float).reshape(-1, 4)


def continuous(seed, frames=12, people=6, noise=0.3, lost=0.2, clutter=3, swap=0.1):
    """Simulate trajectories (distinct distances) with misses, clutter and identity switches."""
    random = np.random.default_rng(seed)
    start, step = random.uniform(0, 5, (people, 2)), random.normal(0, 0.2, (people, 2))
    truth, predicted = [], []
    identity = np.arange(people)
    for f in range(frames):
        where = start + f * step
        if random.random() < swap:
            identity = random.permutation(identity)
        seen = random.random(people) > 0.1
        truth += [[f, i, *where[i]] for i in np.flatnonzero(seen)]
        found = random.random(people) > lost
        measured = where + random.normal(0, noise, (people, 2))
        predicted += [[f, identity[i], *measured[i]] for i in np.flatnonzero(found)]
        junk = random.integers(0, clutter + 1)
        predicted += [[f, 100 + f * clutter + k, *random.uniform(0, 5, 2)] for k in range(junk)]
    return np.array(truth).reshape(-1, 4), np.array(predicted).reshape(-1, 4)


def counts(metrics):
    return {name: getattr(metrics, name) for name in COUNTS}


@given(tables(), st.booleans())
def test_a_perfect_tracker_scores_one_hundred(truth, relabelled):
    predicted = truth.copy()
    if relabelled:
        predicted[:, 1] = 1000 - 3 * predicted[:, 1]
    metrics = evaluation.tracking_metrics(truth, predicted)
    # Only two people on one spot may be confused.
    if len(np.unique(truth[:, [0, 2, 3]], axis=0)) < len(truth):
        assert metrics.fp == metrics.fn == 0
        return
    if len(truth):
        assert metrics.idf1 == 100.0
        assert metrics.tp == len(truth)
        assert metrics.mostly_tracked == metrics.num_objects
    isolated = all(
        math.dist(a[2:], b[2:]) > 1 for a, b in itertools.combinations(truth, 2) if a[0] == b[0]
    )
    if isolated and len(truth):
        assert (metrics.mota, metrics.motp, metrics.id_switches) == (100.0, 0.0, 0)


@given(tables(), tables())
def test_counts_add_up(truth, predicted):
    metrics = evaluation.tracking_metrics(truth, predicted)
    assert metrics.tp + metrics.fn == len(truth)
    assert metrics.tp + metrics.fp == len(predicted)
    assert metrics.idtp + metrics.idfn == len(truth)
    assert metrics.idtp + metrics.idfp == len(predicted)
    people = metrics.mostly_tracked + metrics.partially_tracked + metrics.mostly_lost
    assert people == metrics.num_objects
    if metrics.tp:
        assert 0 <= metrics.motp <= 1
        assert metrics.motp_percent == pytest.approx(100 - 100 * metrics.motp)
    if len(truth):
        assert metrics.mota <= 100
        assert metrics.mota <= metrics.recall + 1e-9


@given(st.integers(0, 10**6), st.floats(-3, 3))
def test_labels_frame_order_and_rigid_motion_do_not_matter(seed, angle):
    truth, predicted = continuous(seed)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    random = np.random.default_rng(seed + 1)
    moved = []
    for table in (truth, predicted):
        # Within a frame the order is kept: it decides between two people with the same id.
        shuffled = np.argsort(random.permutation(12)[table[:, 0].astype(int)], kind="stable")
        changed = table[shuffled]
        changed[:, 1] = random.permutation(1000)[changed[:, 1].astype(int)]
        changed[:, 2:] = changed[:, 2:] @ turn.T + np.array([3.0, -7.0])
        moved.append(changed)
    metrics, expected = (evaluation.tracking_metrics(*pair) for pair in (moved, (truth, predicted)))
    assert counts(metrics) == counts(expected)
    assert metrics.motp == pytest.approx(expected.motp, abs=1e-9, nan_ok=True)


@given(tables(), tables(), st.data())
def test_row_order_does_not_matter_to_the_identity_scores(truth, predicted, data):
    shuffled = [t[data.draw(st.permutations(range(len(t))))] for t in (truth, predicted)]
    metrics, expected = (evaluation.tracking_metrics(*p) for p in (shuffled, (truth, predicted)))
    assert (metrics.idtp, metrics.idfp, metrics.idfn) == (
        expected.idtp,
        expected.idfp,
        expected.idfn,
    )


@given(tables(frames=3, identities=3), tables(frames=3, identities=3))
def test_identity_scores_equal_the_best_of_all_assignments(truth, predicted):
    agree: dict[tuple[float, float], int] = {}
    for t in truth:
        for p in predicted:
            if t[0] == p[0] and math.dist(t[2:], p[2:]) <= 1:
                agree[t[1], p[1]] = agree.get((t[1], p[1]), 0) + 1
    best = max(
        sum(agree.get(pair, 0) for pair in zip(range(3), chosen, strict=True))
        for chosen in itertools.permutations(range(3))
    )
    assert evaluation.tracking_metrics(truth, predicted).idtp == best


@pytest.mark.slow
@given(tables(), tables(), tables(), tables())
def test_combining_adds_the_counts(truth, predicted, other_truth, other_predicted):
    parts = [
        evaluation.tracking_metrics(truth, predicted),
        evaluation.tracking_metrics(other_truth, other_predicted),
    ]
    combined = evaluation.combine_tracking(parts)
    for name, value in counts(combined).items():
        assert value == sum(getattr(part, name) for part in parts)
    # The other sequence, moved to later frames, places and identities, acts as a second one.
    for table in (other_truth, other_predicted):
        table += np.array([100, 100, 0, 0])
    joined = evaluation.tracking_metrics(
        np.vstack([truth, other_truth]), np.vstack([predicted, other_predicted])
    )
    assert counts(joined) == counts(combined)
    assert joined.mota == pytest.approx(combined.mota, nan_ok=True)
    assert joined.motp == pytest.approx(combined.motp, nan_ok=True)


def accumulate(truth, predicted, frames):
    """Compute metrics by py-motmetrics, or skip if it does not run."""
    motmetrics = pytest.importorskip("motmetrics")
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for frame in frames:
            t, p = truth[truth[:, 0] == frame], predicted[predicted[:, 0] == frame]
            squared = ((t[:, None, 2:] - p[None, :, 2:]) ** 2).sum(axis=-1)
            distance = np.where(squared <= 1, np.sqrt(squared), np.nan)
            accumulator.update(t[:, 1].astype(int), p[:, 1].astype(int), distance)
        names = [*PERCENT, *PACKAGE_NAMES, *SAME_NAMES]
        summary = motmetrics.metrics.create().compute(accumulator, metrics=names)
    return {name: float(summary[name].iloc[0]) for name in names}


PACKAGE_NAMES = {
    "num_switches": "id_switches",
    "num_false_positives": "fp",
    "num_misses": "fn",
    "num_fragmentations": "fragmentations",
}
SAME_NAMES = (
    *("motp", "idtp", "idfp", "idfn", "num_matches"),
    *("mostly_tracked", "partially_tracked", "mostly_lost"),
)
PERCENT = ("mota", "idf1", "idp", "idr", "precision", "recall")


@pytest.mark.slow
@settings(max_examples=12)
@given(
    st.integers(0, 10**6),
    st.floats(0.05, 0.8),
    st.floats(0, 0.5),
    st.integers(0, 4),
    st.floats(0, 0.5),
)
def test_equals_an_independent_evaluator(seed, noise, lost, clutter, swap):
    truth, predicted = continuous(seed, noise=noise, lost=lost, clutter=clutter, swap=swap)
    frames = range(13)  # one more than the rows have
    metrics = evaluation.tracking_metrics(truth, predicted, frames)
    for name, expected in accumulate(truth, predicted, frames).items():
        value = getattr(metrics, PACKAGE_NAMES.get(name, name))
        scale = 100 if name in PERCENT else 1
        assert value == pytest.approx(scale * expected, abs=1e-9, nan_ok=True), name


def one_person(frames, x=0.0, identity=1):
    return [[f, identity, x, 0.0] for f in frames]


def test_a_change_of_identity_is_one_switch_even_after_a_gap():
    truth = one_person(range(6))
    predicted = one_person((0, 1), identity=7) + one_person((4, 5), identity=8)
    metrics = evaluation.tracking_metrics(truth, predicted)
    assert (metrics.id_switches, metrics.fn, metrics.fragmentations) == (1, 2, 1)
    assert metrics.mota == pytest.approx(50.0)
    assert (metrics.idtp, metrics.idf1) == (2, pytest.approx(40.0))


def test_a_remembered_identity_wins_over_a_nearer_one():
    truth = one_person(range(3))
    predicted = [*one_person(range(3), x=0.75, identity=1), [2, 2, 0.25, 0.0]]
    metrics = evaluation.tracking_metrics(truth, predicted)
    assert (metrics.id_switches, metrics.fp, metrics.motp) == (0, 1, 0.75)


def test_two_people_who_remember_one_identity_are_served_in_row_order():
    first = [[0, 1, 0.0, 0.0], [1, 2, 0.0, 0.0]]
    predicted = [[f, 9, 0.0, 0.0] for f in range(3)]
    ahead = evaluation.tracking_metrics([*first, [2, 1, 0.25, 0.0], [2, 2, 0.5, 0.0]], predicted)
    behind = evaluation.tracking_metrics([*first, [2, 2, 0.5, 0.0], [2, 1, 0.25, 0.0]], predicted)
    assert (ahead.distance_sum, behind.distance_sum) == (0.25, 0.5)


def test_the_gate_includes_its_border():
    assert evaluation.tracking_metrics([[0, 1, 0, 0]], [[0, 1, 1, 0]]).tp == 1
    assert evaluation.tracking_metrics([[0, 1, 0, 0]], [[0, 1, 1 + 1e-9, 0]]).tp == 0


@pytest.mark.parametrize(
    ("found", "bucket"),
    [(8, "mostly_tracked"), (7, "partially_tracked"), (2, "partially_tracked"), (1, "mostly_lost")],
)
def test_mostly_tracked_and_lost(found, bucket):
    metrics = evaluation.tracking_metrics(one_person(range(10)), one_person(range(found)))
    assert getattr(metrics, bucket) == 1
    assert metrics.fragmentations == 0  # a person never found again is not an interruption


def test_empty_inputs():
    one = [[0, 1, 0.0, 0.0]]
    nothing = evaluation.tracking_metrics([], [])
    assert all(math.isnan(v) for v in (nothing.mota, nothing.motp, nothing.idf1, nothing.idp))
    assert nothing.num_frames == 0
    only_predictions = evaluation.tracking_metrics([], one)
    assert (only_predictions.mota, only_predictions.idf1, only_predictions.fp) == (-math.inf, 0, 1)
    only_truth = evaluation.tracking_metrics(one, [], [0, 1])
    assert (only_truth.mota, only_truth.idf1, only_truth.mostly_lost) == (0, 0, 1)
    assert math.isnan(only_truth.idp)
    assert only_truth.num_frames == 2


@pytest.mark.parametrize(
    ("truth", "predicted", "message"),
    [
        ([[0, 1, 0, 0], [0, 1, 5, 0]], [], r"ground_truth\[1\].*already in this frame"),
        ([], [[0, 1, 0, 0], [1, 1, 5, 0], [0, 1, 9, 9]], r"predictions\[2\].*already"),
        ([[0, 0.5, 0, 0]], [], r"ground_truth\[0\].*frame and id must be whole"),
        ([[0, math.nan, 0, 0]], [], r"ground_truth\[0\].*finite"),
        ([[0, 2**53, 0, 0], [1, 2**53 + 1, 0, 0]], [], r"\[0\].*id must be below 2\^53"),
    ],
)
@pytest.mark.parametrize("function", [evaluation.tracking_metrics, evaluation.hota])
def test_bad_rows_are_named(function, truth, predicted, message):
    with pytest.raises(InvalidInputError, match=message):
        function(truth, predicted)
    with pytest.raises(ValueError, match=message):
        function(truth, predicted)


def test_the_largest_threshold_matches_everybody():
    truth, predicted = [[0, 1, 0.0, 0.0]], [[0, 1, 1e9, 0.0]]
    for metrics in (evaluation.tracking_metrics, evaluation.detection_metrics):
        for threshold in (1e10, 1e300):
            found = metrics(truth, predicted, threshold=threshold)
            assert (found.fp, found.fn) == (0, 0)


def test_parts_of_different_thresholds_are_refused():
    one = [[0, 1, 0.0, 0.0]]
    parts = [evaluation.tracking_metrics(one, one, threshold=t) for t in (0.5, 1.0)]
    for refused in (parts, []):
        with pytest.raises(InvalidInputError, match="at least one, all computed with the same"):
            evaluation.combine_tracking(refused)


def test_one_line_summary():
    text = str(evaluation.tracking_metrics(one_person(range(2)), one_person([0], x=0.5)))
    assert text == (
        "MOTA 50.00  MOTP 0.500 m  IDF1 66.67  ID switches 0  MT 0  ML 0  FP 0  FN 1  (2 frames)"
    )


VECTOR_NAMES = {
    "motp_m": "motp",
    "num_switches": "id_switches",
    "num_gt": "num_ground_truth",
    "num_pred": "num_predictions",
}


def test_reference_values(shared):
    compared = 0
    for path in sorted((shared / "vectors" / "metrics").glob("*.json")):
        case = json.loads(path.read_text())
        if not any(name.startswith("tracking_motmetrics") for name in case["recommended_asserts"]):
            continue
        metrics = evaluation.tracking_metrics(case["gt"], case["pred"], case["frames"])
        for name, expected in case["expected"]["tracking_motmetrics"].items():
            if name in ("num_transfer", "num_ascend", "num_migrate"):
                continue
            value = getattr(metrics, VECTOR_NAMES.get(name, name))
            scale = 100 if name in PERCENT else 1
            assert value == pytest.approx(scale * float(expected), abs=1e-9, rel=0, nan_ok=True), (
                path.stem,
                name,
            )
        compared += 1
    assert compared >= 25
