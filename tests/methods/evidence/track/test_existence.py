"""Log-odds of people: evidence for and against them, and the weight of clutter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._ground_cells import CELLS
from catfree.methods.evidence.observe._visibility import DetectionRate, Views, rate_of_counts
from catfree.methods.evidence.track._existence import (
    delivered,
    judge_groups,
    misses,
    with_pictures,
)
from catfree.settings import EvidenceSettings
from tests.methods.evidence.evidence_worlds import bare_boxes

CAMERAS = 4
PLAIN = EvidenceSettings(local_clutter=False)

# No learned probability is certain.
rates = st.lists(st.floats(0, 0.99), min_size=CAMERAS, max_size=CAMERAS).map(np.array)


class Scene:
    """Groups with members, in cells of the ground, and their boxes."""

    def __init__(self, there, cell, gain, frame=None):
        there = np.asarray(there, bool)
        H = len(there)
        self.frame = np.zeros(H, int) if frame is None else np.asarray(frame, int)
        self.group, self.camera = np.nonzero(there)
        n = len(self.group)
        self.member = np.full(there.shape, -1)
        self.member[self.group, self.camera] = np.arange(n)
        empty = Information(np.zeros((H, 3, 3)), np.zeros((H, 3)), np.zeros(H))
        self.groups = Groups(self.frame, self.member, empty, np.asarray(gain, float))
        self.cell = np.asarray(cell)[self.group]
        F = int(self.frame.max(initial=0)) + 1
        table = np.full((F, CAMERAS, max(n, 1)), -1)
        for row, (g, c) in enumerate(zip(self.group, self.camera, strict=True)):
            table[self.frame[g], c, row] = row
        self.boxes = bare_boxes(self.frame[self.group], self.camera, table)

    def judged(self, rate, agreement=0.0, rules=PLAIN, usual=1.0):
        H = len(self.groups)
        rate, usual = np.broadcast_to(rate, (H, CAMERAS)), np.broadcast_to(usual, CAMERAS)
        agreed = np.full(H, agreement)
        return judge_groups(self.groups, agreed, self.cell, self.boxes, rate, usual, rules)


def one(seen, gain=2.0):
    """Make one person in the middle, seen by these cameras, all of which have the frame."""
    return Scene([seen, [True] * CAMERAS], [0, 0], [gain, 0.0])


seen_by = st.lists(st.booleans(), min_size=CAMERAS, max_size=CAMERAS).filter(any)


@given(seen_by, rates, rates, st.floats(-5, 5))
def test_log_odds_are_gain_and_finds_and_misses_written_out(seen, rate, usual, gain):
    expected, usual = gain, np.maximum(usual, 0.01)
    for found, p, u in zip(seen, rate, usual, strict=True):
        expected += np.log(max(p, PLAIN.detection_rate_range[0]) / u if found else 1 - p)
    found = one(seen, gain).judged(rate, usual=usual)
    assert found.log_odds[0] == pytest.approx(expected, abs=1e-9)


@given(seen_by, st.floats(0.05, 0.95))
def test_where_all_are_seen_alike_a_find_is_worth_what_it_is_however_poor_the_camera(seen, rate):
    found = one(seen).judged(np.where(seen, rate, 0.0), usual=rate)
    assert found.log_odds[0] == pytest.approx(2.0)


@given(seen_by, rates, st.integers(0, CAMERAS - 1), st.floats(0, 0.99))
def test_who_should_be_seen_better_is_believed_less_where_missed_and_more_where_found(
    seen, rate, camera, other
):
    low, high = rate.copy(), rate.copy()
    low[camera], high[camera] = min(rate[camera], other), max(rate[camera], other)
    less, more = (one(seen).judged(r).log_odds[0] for r in (low, high))
    assert more >= less if seen[camera] else more <= less


@pytest.mark.slow
@given(seen_by, rates, st.integers(0, CAMERAS - 1), st.floats(0.01, 3))
def test_more_evidence_of_any_kind_is_more_belief(seen, rate, camera, more):
    plain = one(seen).judged(rate).log_odds[0]
    assert one(seen, 2.0 + more).judged(rate).log_odds[0] == pytest.approx(plain + more)
    assert one(seen).judged(rate, agreement=more).log_odds[0] == pytest.approx(plain + more)
    also = seen.copy()
    also[camera] = True
    # Detections at half the rate of clutter count against a person, but likely ones do not.
    likely = np.maximum(rate, 0.5)
    assert one(also).judged(likely).log_odds[0] >= one(seen).judged(likely).log_odds[0] - 1e-9


@given(seen_by, rates, rates, st.integers(0, CAMERAS - 1))
def test_saying_that_a_camera_has_no_picture_never_lowers_existence(seen, inside, cover, camera):
    scene = one([*seen[:camera], False, *seen[camera + 1 :]])
    silent = np.zeros((1, CAMERAS), bool)
    silent[0, camera] = True
    views = Views(*(np.stack([x, x]) for x in (inside, np.full(CAMERAS, 90.0), cover, inside)))
    rate = DetectionRate(
        np.tile([50.0, 100.0], (CAMERAS, 1)),
        np.array(PLAIN.cover_edges),
        *np.zeros((2, CAMERAS, 3, 5)),
        np.full((CAMERAS, 3, 5), 0.8),
        np.full(CAMERAS, 0.8),
    )
    boxes = replace(scene.boxes, silent=silent)
    told = with_pictures(views, scene.frame, boxes)
    assert (told.inside[:, camera] == 0).all()
    assert (told.share == views.share).all()
    more, less = (scene.judged(rate(v)).log_odds[0] for v in (told, views))
    assert more >= less


@given(seen_by, rates)
def test_without_misses_only_finds_count(seen, rate):
    rules = EvidenceSettings(local_clutter=False, use_misses=False)
    blind = np.where(seen, rate, 0.0)
    first = one(seen).judged(rate, rules=rules).log_odds[0]
    assert first == pytest.approx(one(seen).judged(blind).log_odds[0], abs=1e-9)


@given(st.integers(0, 10**9))
def test_a_miss_is_bounded_however_sure_the_camera(sightings):
    counts = np.full((1, 3, 5), float(sightings))
    learned = rate_of_counts(np.array([[50.0, 100.0]]), counts, counts, PLAIN).rate[0, :1, :1]
    against = misses(learned)
    assert np.log(0.01) - 1e-9 <= against[0] < 0


def test_a_camera_without_a_picture_is_out_only_where_many_are_expected():
    there = np.ones((5, CAMERAS), bool)
    there[:, 2] = False
    scene = Scene(there, np.zeros(5, int), np.zeros(5))
    few, many = (
        delivered(np.full((5, CAMERAS), rate), scene.groups, scene.boxes, PLAIN)
        for rate in (0.6, 0.61)  # of five people: three, and more than three
    )
    assert few.all()
    np.testing.assert_array_equal(many, [[True, True, False, True]])
    # It does not count against anyone, and its rate shows that it did not look.
    found = scene.judged(0.9)
    assert (found.rate[:, 2] == 0).all()
    np.testing.assert_allclose(found.log_odds, 3 * np.log(0.9))


def test_a_camera_that_saw_anybody_at_all_had_a_picture():
    there = np.ones((6, CAMERAS), bool)
    there[:5, 2] = False
    scene = Scene(there, np.zeros(6, int), np.zeros(6))
    assert delivered(np.full((6, CAMERAS), 0.9), scene.groups, scene.boxes, PLAIN).all()


def cluttered(false, true=40):
    """Make people in the middle, seen by all, and a place where only camera 0 sees something."""
    there = np.zeros((true + false, CAMERAS), bool)
    there[:true] = True
    there[true:, 0] = True
    middle, elsewhere = 17 * CELLS + 64, 11 * CELLS + 64
    cell = np.where(there.all(1), middle, elsewhere)
    gain = np.where(there.all(1), 8.0, 0.0)
    return Scene(there, cell, gain, np.arange(true + false) % 20)


@settings(max_examples=10)
@given(st.integers(10, 60))
def test_where_nobody_confirms_a_camera_it_is_believed_less(false):
    scene, rules = cluttered(false), EvidenceSettings()
    found = scene.judged(0.9, rules=rules)
    against = scene.judged(0.9).log_odds - found.log_odds  # log ratios of clutter of all boxes
    low, high = np.log(rules.clutter_range)
    # A ratio belongs to a camera and a place: those of the others are minimal.
    first = against[:40] - (CAMERAS - 1) * low
    assert against[40:].min() > first.max()
    assert first.min() >= low - 1e-9
    assert against[40:].max() <= high + 1e-9
    more = cluttered(false + 20).judged(0.9, rules=rules)
    assert more.log_odds[-1] <= found.log_odds[-1]


@pytest.mark.slow
@given(st.integers(0, 10**6))
def test_the_order_of_the_groups_says_nothing(seed):
    rng = np.random.default_rng(seed)
    H = 20
    there = rng.random((H, CAMERAS)) < 0.6
    there[~there.any(1), 0] = True
    cell, gain = rng.integers(0, CELLS**2, H), rng.normal(2, 3, H)
    frame, rate = rng.integers(0, 3, H), rng.random((H, CAMERAS))
    frame[:3] = range(3)
    order = rng.permutation(H)
    rules = EvidenceSettings()
    plain = Scene(there, cell, gain, frame).judged(rate, rules=rules)
    mixed = Scene(there[order], cell[order], gain[order], frame[order]).judged(
        rate[order], rules=rules
    )
    np.testing.assert_allclose(mixed.log_odds, plain.log_odds[order], atol=1e-9)
    np.testing.assert_array_equal(mixed.rate, plain.rate[order])
    assert np.isfinite(plain.log_odds).all()
