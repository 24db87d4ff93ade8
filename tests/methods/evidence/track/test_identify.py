"""Identities: switched and lost ones are repaired, and the evidence never falls."""

import dataclasses
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.group._appearance import Likeness, Looks, no_looks
from catfree.methods.evidence.track._identify import (
    HORIZON,
    SWEEPS,
    AbsenceHabits,
    estimate_habits,
    estimate_walk,
    identify,
    sweep,
)
from catfree.methods.evidence.track._pasts import SeenPositions
from catfree.methods.evidence.track._tracking import Motion, Population, Trails, transition
from catfree.settings import EvidenceSettings

MOTION = Motion(0.2, 0.85, 0.03, 0.005)
RULES = EvidenceSettings()
SPREAD, NOISE = 0.06, 0.05
HABITS = AbsenceHabits(0.02, 0.05, 0.5)
LARGEST_CROWD = 100  # positions


def population(frames, **changes):
    time = np.arange(frames, dtype=float)
    known = Population(time, MOTION, 0.3, SPREAD, RULES, no_looks(LARGEST_CROWD))
    return known._replace(**changes)


class Nodes(NamedTuple):
    """Sort positions by frame."""

    frame: np.ndarray
    seen: SeenPositions


def nodes_at(frame, state, noise=NOISE):
    """Sort positions by frame, measured (N, 3) with a deviation, without appearance."""
    frame, state = np.asarray(frame, int), np.asarray(state, float)
    matrix = np.tile(np.eye(3) / noise**2, (len(frame), 1, 1))
    return Nodes(frame, SeenPositions(matrix, state / noise**2, no_looks(len(frame))))


def crowd(seed, people=4, frames=12, room=3.0, recall=0.85):
    """Draw people from the model in a small room; return identities and seen positions."""
    rng = np.random.default_rng(seed)
    A, Q = transition(MOTION, 1.0)
    state = np.zeros((people, 5))
    state[:, :2] = rng.uniform(0, room, (people, 2))
    state[:, 2] = 1 + SPREAD * rng.standard_normal(people)
    state[:, 3:] = MOTION.speed * rng.standard_normal((people, 2))
    states = []
    for _ in range(frames):
        states.append(state)
        state = state @ A.T + rng.multivariate_normal(np.zeros(5), Q, people)
    frame, person = (a.ravel() for a in np.indices((frames, people)))
    keep = rng.random(len(frame)) < recall
    seen = np.concatenate(states)[keep, :3]
    measured = seen + NOISE * rng.standard_normal(seen.shape)
    return person[keep], nodes_at(frame[keep], measured)


def dense_evidence(nodes, chain, known, habits=HABITS):
    """Compute the log evidence of chains by one multivariate normal over each chain."""
    total = 0.0
    for name in np.unique(chain):
        rows = np.flatnonzero(chain == name)
        frame = nodes.frame[rows]
        measured = nodes.seen.vector[rows] * NOISE**2
        # Moments of the states of a new person; a wide Gaussian stands for the uniform position.
        wide = 1e3
        P = np.diag([wide**2] * 2 + [SPREAD**2] + [MOTION.speed**2] * 2)
        moments, mean = [P], np.tile([measured[0, 0], measured[0, 1], 1.0], len(rows))
        for a, b in pairwise(frame):
            for _ in range(b - a):
                A, Q = transition(MOTION, 1.0)
                P = A @ P @ A.T + Q
            moments.append(P)
        cov = np.zeros((3 * len(rows), 3 * len(rows)))
        for i, j in product(range(len(rows)), repeat=2):
            low, high = min(i, j), max(i, j)
            step = np.linalg.matrix_power(transition(MOTION, 1.0)[0], frame[high] - frame[low])
            block = (step @ moments[low])[:3, :3]
            block = block if i > j else block.T
            cov[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
        cov += NOISE**2 * np.eye(len(cov))
        total += scipy.stats.multivariate_normal(mean, cov).logpdf(measured.ravel())
        total += np.log(2 * np.pi * wide**2 * known.density)
        hidden = np.diff(frame) - 1
        total += 2 * np.log(habits.leave) - habits.surprise(hidden).sum()
    return total


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6))
def test_a_sweep_never_lowers_the_evidence_of_the_chains(seed):
    person, nodes = crowd(seed, people=3, frames=7, room=1.0)
    rng = np.random.default_rng(seed)
    known = population(7, settings=EvidenceSettings(foot_outlier=1e-12))
    # People whose identities switch at random instants.
    chain = person.copy()
    for t in range(1, 7):
        if rng.random() < 0.4:
            order = rng.permutation(3)
            chain = np.where(nodes.frame >= t, order[chain], chain)
    chain = np.unique(chain, return_inverse=True)[1]
    new = sweep(*nodes, chain, HABITS, known)
    before, after = (dense_evidence(nodes, c, known) for c in (chain, new))
    assert after > before - 1e-3


@pytest.mark.slow
@given(st.integers(0, 10**6))
def test_no_identity_occurs_twice_in_a_frame_and_none_is_left_out(seed):
    rng = np.random.default_rng(seed)
    person, nodes = crowd(seed, people=5, room=0.8)
    chain = np.where(rng.random(len(person)) < 0.2, 5 + np.arange(len(person)), person)
    new = sweep(*nodes, np.unique(chain, return_inverse=True)[1], HABITS, population(12))
    assert set(new) == set(range(new.max() + 1))
    pairs = np.column_stack([nodes.frame, new])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    first = [np.flatnonzero(new == name)[0] for name in range(new.max() + 1)]
    assert first == sorted(first)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.randoms(use_true_random=False))
def test_names_and_the_order_within_a_frame_change_no_identity(seed, random):
    person, nodes = crowd(seed)
    order = list(range(len(person)))
    random.shuffle(order)
    order = np.array(order)[np.argsort(nodes.frame[order], kind="stable")]
    mixed = Nodes(nodes.frame[order], nodes.seen.at(order))
    name = np.random.default_rng(seed).permutation(person.max() + 1)
    plain = sweep(*nodes, person, HABITS, population(12))[order]
    other = sweep(*mixed, name[person[order]], HABITS, population(12))
    pairs = len(np.unique(np.stack([plain, other]), axis=1).T)
    assert pairs == len(np.unique(plain)) == len(np.unique(other))


def path(frames, start, step, height=1.0):
    """Simulate a person who walks straight: frames, and states (T, 3)."""
    frames = np.asarray(frames)
    xy = np.asarray(start, float) + frames[:, None] * np.asarray(step, float)
    return frames, np.column_stack([xy, np.full(len(frames), height)])


def joined(*paths):
    """Return nodes of several paths, and their persons."""
    frame = np.concatenate([p[0] for p in paths])
    state = np.concatenate([p[1] for p in paths])
    who = np.repeat(np.arange(len(paths)), [len(p[0]) for p in paths])
    order = np.argsort(frame, kind="stable")
    return nodes_at(frame[order], state[order]), who[order]


def settled(nodes, chain, known):
    """Test after all sweeps: the futures of the first contain its errors."""
    for _ in range(SWEEPS):
        chain = sweep(*nodes, chain, HABITS, known)
    return chain


def test_two_who_were_exchanged_where_they_crossed_are_told_apart():
    nodes, who = joined(
        path(range(14), [0, 0], [0.3, 0.0]), path(range(14), [3.9, 0.1], [-0.3, 0.0])
    )
    exchanged = np.where(nodes.frame >= 7, 1 - who, who)
    np.testing.assert_array_equal(sweep(*nodes, exchanged, HABITS, population(14)), who)


def test_heights_tell_apart_who_stand_together():
    low, high = (path(range(20), [x, 0], [0, 0], height) for x, height in ((0, 0.85), (0.1, 1.15)))
    nodes, who = joined(low, high)
    exchanged = np.where(nodes.frame >= 9, 1 - who, who)
    np.testing.assert_array_equal(settled(nodes, exchanged, population(20)), who)


@pytest.mark.parametrize("missing", [1, 3, 8, HORIZON])
def test_someone_alone_keeps_one_identity_through_a_gap_that_people_survive(missing):
    habits = AbsenceHabits(0.005, 0.02, 1 - 1 / missing if missing > 1 else 0.3)
    frames = np.r_[np.arange(10), 10 + missing + np.arange(10)]
    nodes, _ = joined(path(frames, [0, 0], [0.0, 0.0]))
    lost = (frames >= 10).astype(int)
    new = sweep(*nodes, lost, habits, population(20 + missing))
    assert new.max() == (0 if missing < HORIZON else 1)


def test_two_places_too_far_apart_to_walk_are_two_people():
    first, second = path(range(6), [0, 0], [0, 0]), path(range(8, 14), [9, 0], [0, 0])
    nodes, _ = joined(first, second)
    new = settled(nodes, np.zeros(12, int), population(14))
    np.testing.assert_array_equal(new, [0] * 6 + [1] * 6)


@pytest.mark.slow
def test_looks_decide_whether_two_who_met_passed_or_turned_back():
    frames = np.arange(20)
    x = 0.3 * np.abs(frames - 9.5)
    left, right = ((frames, np.column_stack([sign * x, 0 * x, 1 + 0 * x])) for sign in (-1, 1))
    nodes, side = joined(left, right)
    passed = np.where(nodes.frame >= 10, 1 - side, side)
    known = population(20)
    apart = np.abs(nodes.frame - 9.5) > 1
    np.testing.assert_array_equal(settled(nodes, side, known)[apart], passed[apart])
    known = known._replace(likeness=Likeness((0.1, 0.1), (0.9, 0.1), 4.0, 0.5))
    for who in (passed, side):
        seen = nodes.seen._replace(looks=Looks(np.eye(2)[who] * 3, np.full(len(who), 3)))
        for start in (passed, side):
            found = settled(nodes._replace(seen=seen), start, known)
            np.testing.assert_array_equal(found[apart], who[apart])


def test_rates_are_shares_of_what_was_seen_with_one_more_of_each():
    # One person stays throughout with a gap of two frames; another comes and leaves.
    frame = np.r_[[0, 1, 4, 5], [2, 3]]
    order = np.argsort(frame, kind="stable")
    habits = estimate_habits(frame[order], np.repeat([0, 1], [4, 2])[order], 6)
    assert habits == pytest.approx((4 / 16, 2 / 8, 2 / 4))
    assert habits.surprise(np.arange(3)) == pytest.approx(
        [0, -np.log(0.25 * 0.5), -np.log(0.25 * 0.5 * 0.5)]
    )


def test_being_hidden_for_some_time_is_certain_once_somebody_hides():
    gaps = np.arange(1, 400)
    assert np.exp(-HABITS.surprise(gaps)).sum() == pytest.approx(HABITS.hide)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.7, 0.95), st.floats(0.0, 0.05))
def test_the_walk_is_what_was_drawn_whatever_the_error_of_positions(seed, memory, noise):
    rng = np.random.default_rng(seed)
    people, frames, speed = 60, 300, 0.15
    v = speed * rng.standard_normal((people, 2))
    steps = []
    for _ in range(frames):
        steps.append(v)
        v = memory * v + np.sqrt(1 - memory**2) * speed * rng.standard_normal(v.shape)
    place = np.cumsum(steps, 0) + noise * rng.standard_normal((frames, people, 2))
    frame, chain = (a.ravel() for a in np.indices((frames, people)))
    found = estimate_walk(place.reshape(-1, 2), frame, chain, population(frames))
    assert found.speed == pytest.approx(speed, rel=0.15)
    assert found.memory ** (1 / RULES.sudden) == pytest.approx(memory, abs=0.05)


def test_of_too_few_steps_the_usual_walk_is_taken():
    few = estimate_walk(np.zeros((6, 2)), np.arange(6), np.zeros(6, int), population(6))
    assert few == MOTION


def tracks(person, nodes):
    """Return trails and information of groups with the same content as nodes."""
    N = len(person)
    order = np.lexsort((nodes.frame, person))
    info = Information(nodes.seen.matrix[order], nodes.seen.vector[order], np.zeros(N))
    mean = np.pad(nodes.seen.vector[order] * NOISE**2, ((0, 0), (0, 2)))
    cov = np.tile(NOISE**2 * np.eye(5), (N, 1, 1))
    return Trails(person[order], nodes.frame[order], np.arange(N), mean, cov), info


def test_rows_that_are_not_reported_have_no_identity_and_do_not_matter():
    person, nodes = crowd(3)
    trails, info = tracks(person, nodes)
    error = np.tile(0.01**2 * np.eye(2), (len(trails), 1, 1))
    reported = trails.track != 2
    names = identify(trails, reported, error, info, population(12))
    np.testing.assert_array_equal(names >= 0, reported)
    kept = np.flatnonzero(reported)
    alone = dataclasses.replace(trails[kept], group=np.arange(len(kept)))
    same = identify(alone, np.ones(len(kept), bool), error[kept], info[kept], population(12))
    np.testing.assert_array_equal(names[kept], same)


def test_nobody_has_no_identity():
    person, nodes = crowd(0)
    trails, info = tracks(person, nodes)
    error = np.zeros((len(trails), 2, 2))
    names = identify(trails, np.zeros(len(trails), bool), error, info, population(12))
    assert (names == -1).all()
