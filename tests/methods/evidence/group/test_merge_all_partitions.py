"""Greedy merging against all partitions of a handful of boxes of one instant."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import Information, log_evidence
from catfree.methods.evidence.group._merge import merge_boxes

DENSITY, SPREAD, GATE = 0.2, 0.05, 16.0
MOST = 7  # boxes: 877 partitions
ROWS = 64  # padded length


def boxes_at(mean, deviation):
    """Make information on (x, y, height) of boxes that measure each equally well, padded."""
    mean, precision = np.asarray(mean, float), np.asarray(deviation, float) ** -2
    info = Information(np.zeros((ROWS, 3, 3)), np.zeros((ROWS, 3)), np.zeros(ROWS))
    n = len(mean)
    info.matrix[:n] = precision[:, None, None] * np.eye(3)
    info.vector[:n] = precision[:, None] * mean
    info.constant[:n] = precision * (mean**2).sum(1)
    return info


def greedy(info, camera, cameras):
    """Return the library's groups, sorted."""
    n = len(camera)
    frame, camera = np.zeros(ROWS, int), np.pad(camera, (0, ROWS - n))
    valid = np.arange(ROWS) < n
    groups = merge_boxes(info, frame, camera, valid, cameras, DENSITY, SPREAD, GATE)
    return sorted(sorted(row[row >= 0].tolist()) for row in groups.member)


def partitions(camera):
    """Yield all ways to group boxes without two of one camera in a group."""
    found = [[]]
    for box, view in enumerate(camera):
        found = [
            more
            for groups in found
            for more in (
                [*groups, [box]],
                *(
                    [*groups[:k], [*group, box], *groups[k + 1 :]]
                    for k, group in enumerate(groups)
                    if view not in camera[group]
                ),
            )
        ]
    return [sorted(map(sorted, groups)) for groups in found]


def evidence_of(info, groups):
    """Compute the total log evidence of groups that are one person each."""
    total = Information(
        *(
            np.array([values[group].sum(0) for group in groups])
            for values in (info.matrix, info.vector, info.constant)
        )
    )
    return float(log_evidence(total, DENSITY, SPREAD).sum())


def likeliest(info, camera):
    return max(partitions(camera), key=lambda groups: evidence_of(info, groups))


@st.composite
def crowds(draw, most_cameras=4):
    """Draw a few people near enough to confuse, seen by some cameras; at most seven boxes."""
    count = draw(st.integers(2, most_cameras))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    people = draw(st.integers(1, 4))
    width = draw(st.floats(0.1, 3.0))
    state = np.column_stack([rng.uniform(0, width, (people, 2)), rng.normal(1, SPREAD, people)])
    pairs = np.array(list(itertools.product(range(people), range(count))))
    person, camera = pairs[np.sort(rng.permutation(len(pairs))[:MOST])].T
    deviation = rng.uniform(0.03, 0.25, len(person))
    mean = state[person] + deviation[:, None] * rng.standard_normal((len(person), 3))
    return boxes_at(mean, deviation), camera, count


def test_all_partitions_are_enumerated_once():
    bell = [1, 1, 2, 5, 15, 52, 203, 877]
    for n, count in enumerate(bell):
        every = partitions(np.arange(n))
        assert len(every) == count == len({str(groups) for groups in every})
    # Two boxes of each of two cameras: 1 way apart, 4 with one pair, 2 with two.
    assert len(partitions(np.array([0, 0, 1, 1]))) == 7


@settings(max_examples=20)
@given(crowds())
def test_the_evidence_of_a_group_is_its_integral_over_places_and_heights(crowd):
    info, camera, _ = crowd
    precision = info.matrix[: len(camera), 0, 0]
    mean = info.vector[: len(camera)] / precision[:, None]
    # Errors are equally large along all axes, so the integral is a product of three.
    place, step = np.linspace(-4, 8, 24001, retstep=True)
    for group in likeliest(info, camera):
        away = mean[group][..., None] - place
        likelihood = np.exp(-0.5 * (precision[group, None, None] * away**2).sum(0))
        likelihood[2] *= np.exp(-0.5 * ((place - 1) / SPREAD) ** 2) / (SPREAD * np.sqrt(2 * np.pi))
        integral = np.log(DENSITY) + np.log(likelihood.sum(1) * step).sum()
        np.testing.assert_allclose(evidence_of(info, [group]), integral, atol=1e-6)


@pytest.mark.slow
@settings(max_examples=40)
@given(crowds())
def test_no_merge_improves_what_greedy_merging_leaves_and_nothing_beats_the_likeliest(crowd):
    info, camera, cameras = crowd
    groups = greedy(info, camera, cameras)
    found, best = evidence_of(info, groups), evidence_of(info, likeliest(info, camera))
    assert groups in partitions(camera)
    apart = evidence_of(info, [[box] for box in range(len(camera))])
    assert apart - 1e-9 <= found <= best + 1e-9
    for one, two in itertools.combinations(groups, 2):
        if not set(camera[one]) & set(camera[two]):
            assert evidence_of(info, [one + two]) <= evidence_of(info, [one, two]) + 1e-9


@settings(max_examples=40)
@given(crowds(most_cameras=2))
def test_between_two_cameras_greedy_merging_gains_at_least_half_of_what_can_be_gained(crowd):
    # A greedy matching has at least half of the maximum weight (Preis 1999).
    info, camera, cameras = crowd
    apart = evidence_of(info, [[box] for box in range(len(camera))])
    found = evidence_of(info, greedy(info, camera, cameras)) - apart
    best = evidence_of(info, likeliest(info, camera)) - apart
    assert found >= 0.5 * best - 1e-9


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(2, 4))
def test_people_far_apart_are_grouped_as_is_likeliest(seed, people, cameras):
    rng = np.random.default_rng(seed)
    pairs = np.array(list(itertools.product(range(people), range(cameras))))
    person, camera = pairs[np.sort(rng.permutation(len(pairs))[:MOST])].T
    deviation = rng.uniform(0.03, 0.1, len(person))
    # Boxes of different people are over ten deviations apart, those of one within one.
    state = np.column_stack([3.0 * np.arange(people), rng.uniform(0, 1, people), np.ones(people)])
    mean = state[person] + deviation[:, None] * rng.uniform(-1, 1, (len(person), 3))
    info = boxes_at(mean, deviation)
    groups = greedy(info, camera, cameras)
    assert groups == sorted(np.flatnonzero(person == k).tolist() for k in np.unique(person))
    assert groups == likeliest(info, camera)
