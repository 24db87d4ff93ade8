"""Pasts: the filter has the information of all measurements, and mixes up no one."""

import itertools

import jax
import numpy as np
from hypothesis import given, strategies as st

from catfree.methods.evidence.group._appearance import Looks
from catfree.methods.evidence.track._pasts import (
    SeenPositions,
    assign,
    extend,
    no_pasts,
    predict,
)
from catfree.methods.evidence.track._tracking import Motion, transition

MOTION = Motion(0.2, 0.85, 0.03, 0.005)
SPREAD = 0.06
WIDE = 1e3  # spread of an unknown place


def measured(state, precision, boxes=1):
    """Make positions (N, 3) with information (N, 3, 3) and one embedding each."""
    looks = Looks(np.ones((len(state), 1)) * boxes, np.full(len(state), boxes))
    return SeenPositions(precision, np.einsum("nij,nj->ni", precision, state), looks)


def followed(frames, seen):
    """Filter one person: return the past after the last frame from these positions."""
    pasts = no_pasts(1)
    for t in range(frames[0], frames[-1] + 1):
        at = np.flatnonzero(np.asarray(frames) == t)
        pasts = predict(pasts, *transition(MOTION, 1.0))
        linked = np.zeros(len(at), int) if len(pasts.name) else np.full(len(at), -1)
        begun = np.array([7] if len(at) and not len(pasts.name) else [], int)
        pasts = extend(pasts, linked, begun, seen.at(at), SPREAD, MOTION.speed)
    return pasts


@given(st.integers(0, 10**6), st.sets(st.integers(1, 5), max_size=4))
def test_a_past_is_what_all_measurements_say_together(seed, others):
    rng = np.random.default_rng(seed)
    frames = [0, *sorted(others)]
    N = len(frames)
    state = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.standard_normal((N, 3))
    root = rng.standard_normal((N, 3, 3))
    noise = 0.01 * (root @ root.transpose(0, 2, 1) + 0.1 * np.eye(3))
    past = followed(frames, measured(state, np.linalg.inv(noise)))
    # The last state and all measurements are jointly Gaussian.
    P = [np.diag([WIDE**2] * 2 + [SPREAD**2] + [MOTION.speed**2] * 2)]
    A, Q = transition(MOTION, 1.0)
    for _ in range(frames[-1]):
        P.append(A @ P[-1] @ A.T + Q)
    between = [np.linalg.matrix_power(A, frames[-1] - t) @ P[t] for t in frames]
    of_last = np.concatenate([b[:, :3] for b in between], axis=1)
    of_measured = np.zeros((3 * N, 3 * N))
    for i, j in itertools.product(range(N), repeat=2):
        early, late = sorted((i, j))
        block = np.linalg.matrix_power(A, frames[late] - frames[early]) @ P[frames[early]]
        block = block[:3, :3] if i == late else block[:3, :3].T
        of_measured[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block + (i == j) * noise[i]
    usual = np.array([0, 0, 1.0])
    pull = np.linalg.solve(of_measured, (state - usual).ravel())
    mean = np.array([0, 0, 1.0, 0, 0]) + of_last @ pull
    covariance = P[-1] - of_last @ np.linalg.solve(of_measured, of_last.T)
    np.testing.assert_allclose(past.mean[0], mean, atol=1e-5)
    np.testing.assert_allclose(past.covariance[0], covariance, atol=1e-5)
    assert past.name.tolist() == [7]
    assert past.gap.tolist() == [0]
    assert past.looks.boxes.tolist() == [N]
    assert past.looks.total.tolist() == [[N]]


@given(st.integers(0, 10**6), st.integers(0, 4), st.integers(0, 4))
def test_people_are_extended_independently_and_new_ones_come_last(seed, people, positions):
    rng = np.random.default_rng(seed)
    precision = np.tile(100 * np.eye(3), (people, 1, 1))
    first = measured(rng.standard_normal((people, 3)), precision)
    names = rng.permutation(100)[:people]
    before = extend(no_pasts(1), np.full(people, -1), names, first, SPREAD, MOTION.speed)
    row = rng.permutation(max(people, positions))[:positions]
    linked = np.where(row < people, row, -1)
    begun = 100 + np.arange((linked < 0).sum())
    precision = np.tile(100 * np.eye(3), (positions, 1, 1))
    seen = measured(rng.standard_normal((positions, 3)), precision, boxes=2)
    after = extend(before, linked, begun, seen, SPREAD, MOTION.speed)
    assert after.name.tolist() == [*names, *begun]
    for at in range(people):
        own = np.flatnonzero(linked == at)
        alone = extend(
            before.at(slice(at, at + 1)), np.zeros(len(own), int), begun[:0], seen.at(own),
            SPREAD, MOTION.speed,
        )  # fmt: skip
        for part, of_one in zip(*map(jax.tree.leaves, (after, alone)), strict=True):
            np.testing.assert_allclose(part[at], of_one[0], rtol=1e-12, atol=1e-12)
    assert after.gap.tolist() == [int(at not in linked) for at in range(people)] + [0] * len(begun)
    unseen = (np.setdiff1d(np.arange(people), linked)).tolist()
    assert before.at(unseen).mean.tolist() == after.at(unseen).mean.tolist()
    fresh = after.at(slice(people, None))
    np.testing.assert_allclose(fresh.covariance[:, [3, 4], [3, 4]], MOTION.speed**2)
    assert (fresh.mean[:, 3:] == 0).all()
    assert after.seen_within(0).name.tolist() == after.name[after.gap == 0].tolist()


@given(st.integers(0, 10**6), st.integers(0, 4), st.integers(0, 4))
def test_the_assignment_has_the_greatest_sum_of_gains(seed, pasts, positions):
    gain = np.random.default_rng(seed).standard_normal((pasts, positions))
    past = assign(gain)
    linked = np.flatnonzero(past >= 0)
    assert len(set(past[linked])) == len(linked)
    assert (gain[past[linked], linked] > 0).all()
    best = 0.0
    for choice in itertools.product([-1, *range(pasts)], repeat=positions):
        used = [c for c in choice if c >= 0]
        if len(set(used)) == len(used):
            best = max(best, sum(gain[c, k] for k, c in enumerate(choice) if c >= 0))
    assert np.isclose(gain[past[linked], linked].sum(), best)
