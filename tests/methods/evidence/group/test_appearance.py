"""Appearance between frames: ratios by brute force, and identities after people meet."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence._solve import solve
from catfree.methods.evidence.group import _appearance as appearance
from catfree.methods.evidence.group._appearance import (
    GroupLooks,
    Likeness,
    Looks,
    PairRatios,
    appearance_log_odds,
    compare_looks,
    no_looks,
)
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._embeddings import embeddings_of
from catfree.methods.evidence.track._tracking import Motion, Population, follow
from catfree.settings import EvidenceSettings
from catfree.synthetic import make_world

LIKENESS = Likeness((0.1, 0.05), (0.7, 0.15), limit=4.0, weight=0.5)


def unit(rng, *shape):
    values = rng.standard_normal(shape)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 4))
def test_the_ratio_is_that_of_the_mean_distance_of_all_pairs(seed, groups, cameras):
    rng = np.random.default_rng(seed)
    n = groups * cameras
    embedding = unit(rng, n, 5)
    blank = rng.random(n) < 0.2
    embedding[blank] = 0
    member = np.where(rng.random((groups, cameras)) < 0.7, np.arange(n).reshape(groups, -1), -1)
    looks = GroupLooks(embeddings_of(embedding, np.arange(n)), member).at(slice(None))
    found = compare_looks(looks, looks, looks.boxes, LIKENESS)
    for a in range(groups):
        for b in range(groups):
            one, two = ([i for i in member[g] if i >= 0 and not blank[i]] for g in (a, b))
            expected = 0.0
            if one and two:
                pairs = [1 - embedding[i] @ embedding[j] for i in one for j in two]
                expected = len(two) * float(LIKENESS(np.array([np.mean(pairs)]))[0])
            # Sums are in single precision, whose error the narrow Gaussian multiplies by 200.
            assert found[a, b] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("at_a_time", [1, 15, 1 << 18])
def test_ratios_of_pairs_are_those_of_all_pairs(monkeypatch, at_a_time):
    rng = np.random.default_rng(0)
    embedding = unit(rng, 12, 5).astype(np.float32)
    monkeypatch.setattr(appearance, "NUMBERS_AT_A_TIME", at_a_time)
    ratios = PairRatios(embeddings_of(embedding, np.arange(12)), LIKENESS)
    one, two = np.divmod(np.arange(144), 12)
    expected = LIKENESS(1 - embedding @ embedding.T)
    np.testing.assert_allclose(ratios(one, two).reshape(12, 12), expected, rtol=1e-4)
    some = ratios.of_boxes(slice(7, 12))
    one, two = np.divmod(np.arange(25), 5)
    np.testing.assert_allclose(some(one, two).reshape(5, 5), expected[7:, 7:], rtol=1e-4)


@given(st.integers(0, 10**6))
def test_boxes_without_embedding_say_nothing(seed):
    rng = np.random.default_rng(seed)
    embedding, member = unit(rng, 12, 5), np.arange(12).reshape(3, 4)
    blank = rng.random(12) < 0.4
    embedding[blank] = 0
    ratios = PairRatios(embeddings_of(embedding, np.arange(12)), LIKENESS)
    one, two = np.divmod(np.arange(144), 12)
    either = blank[one] | blank[two]
    assert (ratios(one, two)[either] == 0).all()
    info = Information(np.zeros((3, 3, 3)), np.zeros((3, 3)), np.zeros(3))
    groups = Groups(np.arange(3), member, info, np.zeros(3))
    without = dataclasses.replace(groups, member=np.where(blank[member], -1, member))
    np.testing.assert_array_equal(
        appearance_log_odds(groups, ratios), appearance_log_odds(without, ratios)
    )


def test_looks_are_learned_although_some_cameras_have_no_embeddings():
    world = make_world("ring4", 1, frames=12, people=8)
    boxes = world.detections
    some = dataclasses.replace(boxes, embedding=boxes.embedding * (boxes.camera < 3)[:, None])
    all_known, some_known = (solve(b, world.scene).ratios.likeness for b in (boxes, some))
    for kind in ("same", "other"):
        one, other = (getattr(likeness, kind)[0] for likeness in (all_known, some_known))
        assert one == pytest.approx(other, abs=0.1)


def meeting(turn_back: bool):
    """Let two people of one height approach each other; return (T, 2, 2) places, in H0."""
    time = np.arange(-10, 11)
    x = np.abs(time) if turn_back else -time
    return np.stack([np.stack([-0.15 * x, 0 * x], -1), np.stack([0.15 * x, 0 * x + 0.02], -1)], 1)


def who(places, looks, likeness=LIKENESS, deviation=0.1):
    """Return (T, 2) track of each person."""
    T = len(places)
    state = np.concatenate([places, np.ones((T, 2, 1))], -1).reshape(-1, 3)
    precision = np.broadcast_to(np.eye(3) / deviation**2, (2 * T, 3, 3)).copy()
    info = Information(precision, state / deviation**2, (state**2).sum(1) / deviation**2)
    frame, member = np.repeat(np.arange(T), 2), np.arange(2 * T)[:, None]
    groups = Groups(frame, member, info, np.zeros(2 * T))
    time, motion = np.arange(T, dtype=float), Motion(0.15, 0.85, 0.03, 0.005)
    people = Population(time, motion, 0.01, 0.06, EvidenceSettings(), looks, likeness)
    trails = follow(groups, np.full(2 * T, 5.0), people)
    track = np.full(2 * T, -1)
    track[trails.group[trails.group >= 0]] = trails.track[trails.group >= 0]
    return track.reshape(T, 2)


@pytest.mark.parametrize("turn_back", [False, True])
def test_looks_tell_who_is_who_after_a_meeting(turn_back):
    places = meeting(turn_back)
    rng = np.random.default_rng(0)
    people = unit(rng, 2, 16)
    seen = np.tile(people, (len(places), 1)) + 0.05 * rng.standard_normal((2 * len(places), 16))
    seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    looks = Looks(seen, np.ones(len(seen), int))
    track = who(places, looks)
    assert (track == track[0]).all()
    assert track[0, 0] != track[0, 1]
    # By motion alone they appear to walk on, which is true for those who did.
    alone = who(places, no_looks(2 * len(places)))
    assert (alone == alone[0]).all() != turn_back


def test_without_embeddings_looks_have_no_say():
    places = meeting(turn_back=False)
    nobody = no_looks(2 * len(places), 4)
    np.testing.assert_array_equal(who(places, nobody), who(places, nobody, likeness=None))


def test_somebody_else_in_the_same_place_is_somebody_new():
    places = np.zeros((8, 2, 2))
    places[:, 1] = 50.0  # far from the first
    people = np.eye(3)
    seen = np.array([people[[0 if t < 4 else 1, 2]] for t in range(8)]).reshape(-1, 3)
    likeness = dataclasses.replace(LIKENESS, limit=40.0)
    track = who(places, Looks(4 * seen, np.full(16, 4)), likeness)
    assert len(np.unique(track[:4, 0])) == len(np.unique(track[4:, 0])) == 1
    assert track[3, 0] != track[4, 0]
    assert (track[:, 1] == track[0, 1]).all()
