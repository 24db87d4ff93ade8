from dataclasses import replace

import jax
import numpy as np
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import Information, log_evidence, mean_and_covariance
from catfree.methods.evidence.group._groups import priors_of
from catfree.methods.evidence.group._merge import (
    PAIR_BLOCK,
    close_pairs,
    merge_boxes,
)
from catfree.methods.evidence.observe._measurement import start_noise
from catfree.settings import EvidenceSettings

DENSITY, SPREAD, GATE = 0.2, 0.05, 16.0
START = start_noise(4, EvidenceSettings())
NOISE = replace(START, density=np.array(DENSITY), spread=np.array(SPREAD))


def boxes_near(seed, people, cameras, noise):
    """Draw isotropic measurements of people at random places, one box per camera, padded."""
    rng = np.random.default_rng(seed)
    state = np.column_stack(
        [rng.uniform(0, 6, (people, 2)), 1 + 0.05 * rng.standard_normal(people)]
    )
    person, camera = (a.ravel() for a in np.meshgrid(np.arange(people), np.arange(cameras)))
    keep = rng.random(len(person)) < 0.8
    person, camera = person[keep], camera[keep]
    n, N = len(person), 64
    mean = state[person] + noise * rng.standard_normal((n, 3))
    precision = np.eye(3) / noise**2
    info = Information(np.zeros((N, 3, 3)), np.zeros((N, 3)), np.zeros(N))
    info.matrix[:n], info.vector[:n] = precision, mean @ precision
    info.constant[:n] = (mean**2).sum(1) / noise**2
    cam, valid = np.zeros(N, int), np.zeros(N, bool)
    cam[:n], valid[:n] = camera, True
    return info, cam, valid


def greedy(info, camera, valid, looks=None):
    """Merge the best pair, one at a time."""
    looks = np.zeros((len(camera),) * 2) if looks is None else looks
    groups = [[i] for i in np.flatnonzero(valid)]
    value = lambda g: float(  # noqa: E731
        log_evidence(
            Information(
                info.matrix[g].sum(0)[None],
                info.vector[g].sum(0)[None],
                info.constant[g].sum()[None],
            ),
            DENSITY,
            SPREAD,
        )[0]
    )
    while True:
        best, pair = 0.0, None
        for i in range(len(groups)):
            for j in range(i):
                if {camera[k] for k in groups[i]} & {camera[k] for k in groups[j]}:
                    continue
                gain = value(groups[i] + groups[j]) - value(groups[i]) - value(groups[j])
                gain += looks[np.ix_(groups[i], groups[j])].sum()
                if gain > best + 1e-12:
                    best, pair = gain, (i, j)
        if pair is None:
            return sorted(sorted(map(int, g)) for g in groups)
        i, j = pair
        groups = [g for k, g in enumerate(groups) if k not in pair] + [groups[i] + groups[j]]


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 5), st.floats(0.02, 0.3), st.booleans())
def test_merging_in_rounds_equals_one_best_pair_at_a_time(seed, people, noise, with_looks):
    info, camera, valid = boxes_near(seed, people, 3, noise)
    half = np.random.default_rng(seed).normal(0, 2, (64, 64))
    looks = half + half.T if with_looks else np.zeros((64, 64))
    ratio = (lambda one, two: looks[one, two]) if with_looks else None
    groups = merge_boxes(
        info, np.zeros(64, int), camera, valid, 3, DENSITY, SPREAD, 1e6, ratio=ratio
    )
    got = sorted(sorted(int(i) for i in row if i >= 0) for row in groups.member)
    assert got == greedy(info, camera, valid, looks)


def test_frames_merged_together_give_the_groups_of_each_alone():
    frames, rows = 1000, 64
    alone = [boxes_near(seed, 6, 3, 0.3) for seed in range(frames)]
    info = jax.tree.map(lambda *parts: np.concatenate(parts), *(a[0] for a in alone))
    camera, valid = (np.concatenate([a[k] for a in alone]) for k in (1, 2))
    frame = np.repeat(np.arange(frames), rows)
    mean, covariance = mean_and_covariance(info[valid], SPREAD)
    place = mean[:, :2], covariance[:, :2, :2]
    pairs = close_pairs(*place, frame[valid], camera[valid], GATE)
    assert len(pairs) > PAIR_BLOCK  # otherwise one block merges them
    groups = merge_boxes(info, frame, camera, valid, 3, DENSITY, SPREAD, GATE)
    for k in (0, 3, frames // 2, frames - 1):
        own, *rest = alone[k]
        one = merge_boxes(own, np.zeros(rows, int), *rest, 3, DENSITY, SPREAD, GATE)
        here = groups.member[groups.frame == k]
        assert (np.where(here >= 0, here - rows * k, -1) == one.member).all()


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_every_box_is_in_exactly_one_group_and_cameras_exclude_themselves(seed, people):
    info, camera, valid = boxes_near(seed, people, 4, 0.1)
    groups = merge_boxes(info, np.zeros(64, int), camera, valid, 4, DENSITY, SPREAD, GATE)
    rows = groups.member[groups.member >= 0]
    assert sorted(rows) == list(np.flatnonzero(valid))
    for c in range(4):
        own = groups.member[:, c]
        assert (camera[own[own >= 0]] == c).all()
    single = (groups.member >= 0).sum(1) == 1
    np.testing.assert_allclose(groups.gain[single], 0, atol=1e-9)
    assert (groups.gain[~single] > 0).all()


@given(st.integers(0, 10**6), st.integers(0, 40), st.floats(-2.0, 1.0))
def test_close_pairs_are_those_of_all_pairs(seed, count, spread):
    rng = np.random.default_rng(seed)
    position = rng.normal(0, 5, (count, 2))
    root = rng.normal(0, 1, (count, 2, 2)) * 10 ** rng.uniform(-2, spread, (count, 1, 1))
    covariance = root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    frame, camera = rng.integers(0, 3, count), rng.integers(0, 4, count)
    i, j = (a.ravel() for a in np.indices((count, count)))
    apart = position[i] - position[j]
    total = np.linalg.inv(covariance[i] + covariance[j])
    m2 = np.einsum("ni,nij,nj->n", apart, total, apart)
    close = (i < j) & (frame[i] == frame[j]) & (camera[i] != camera[j]) & (m2 < GATE)
    found = close_pairs(position, covariance, frame, camera, GATE)
    np.testing.assert_array_equal(found, np.column_stack([i[close], j[close]]))


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(0, 70))
def test_padding_changes_no_group(seed, people, tracks):
    info, camera, valid = boxes_near(seed, people, 4, 0.05)
    rng = np.random.default_rng(seed + 1)
    near = rng.integers(0, max(int(valid.sum()), 1), tracks)
    mean, _ = mean_and_covariance(info[near], SPREAD)
    precision = np.tile(100 * np.eye(3), (tracks, 1, 1))
    priors = priors_of(np.zeros(tracks, int), precision, 100 * mean, NOISE)

    def groups(extra):
        pad = lambda a: np.concatenate([a, np.zeros((extra, *a.shape[1:]), a.dtype)])  # noqa: E731
        padded = Information(pad(info.matrix), pad(info.vector), pad(info.constant))
        return merge_boxes(
            padded, pad(np.zeros(64, int)), pad(camera), pad(valid), 4, DENSITY, SPREAD, GATE,
            priors=priors,
        )  # fmt: skip

    tight, wide = groups(0), groups(192)
    np.testing.assert_array_equal(tight.member, wide.member)
    np.testing.assert_allclose(tight.info.matrix, wide.info.matrix, rtol=1e-12)
    np.testing.assert_allclose(tight.gain, wide.gain, rtol=1e-9, atol=1e-9)
