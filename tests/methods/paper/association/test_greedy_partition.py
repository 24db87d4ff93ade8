"""The parallel partition equals the plain loop over pairs."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from catfree import Rays
from catfree.methods.paper.association import (
    CandidatePairs,
    _greedy_partition as partition,
    greedy_partition,
)

CAMERAS = 4
PLACES = 24  # detections per problem: one shape, compiled once
TOLERANCE = 0.04

CENTERS = np.array([[3.0, 0, 1], [0, 3, 1.2], [-3, 0, 0.8], [0, -3, 1]])


def worst_residual(origins, directions, weights) -> tuple[float, float]:
    """Return the largest angle at the weighted least-squares point, and its condition number."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    matrix = np.einsum("c,cij->ij", weights, across)
    point = np.linalg.solve(matrix, np.einsum("c,cij,cj->i", weights, across, origins))
    sight = point - origins
    sine = np.linalg.norm(np.cross(sight, directions), axis=1)
    angle = np.arctan2(sine, np.einsum("ci,ci->c", sight, directions))
    return float(angle.max()), float(np.linalg.cond(matrix))


def one_after_the_other(rays: Rays, camera, pairs: CandidatePairs, tolerance: float) -> set:
    """Compute the partition by a loop in which each pair may merge its groups."""
    group = {i: [i] for i in range(len(camera))}
    for first, second, alone in zip(*pairs, strict=True):
        one, other = group[int(first)], group[int(second)]
        merged = one + other
        if one is other or len({camera[i] for i in merged}) < len(merged):
            continue
        if alone and len(merged) > 2:
            continue
        rows = sorted(merged)
        residual, condition = worst_residual(
            rays.origin[rows], rays.direction[rows], rays.weight[rows]
        )
        # If rounding would decide, the two may differ.
        assume(abs(residual - tolerance) > 1e-7)
        assume(condition < 1e7)
        if residual <= tolerance:
            for i in merged:
                group[i] = merged
    return {frozenset(members) for members in group.values() if len(members) > 1}


def as_sets(groups: np.ndarray) -> set:
    return {frozenset(row[row >= 0].tolist()) for row in groups}


def make_rays(camera, target, noise, weight) -> Rays:
    origin = CENTERS[camera]
    direction = target + noise - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rows = ((0, PLACES - len(camera)), (0, 0))
    return Rays(np.pad(origin, rows), np.pad(direction, rows), np.pad(weight, rows[0]))


COORDINATE = st.floats(-1, 1).map(lambda x: round(x, 3))
NOISE = st.floats(-0.15, 0.15).map(lambda x: round(x, 4))
PLACE = st.tuples(COORDINATE, COORDINATE)
DETECTION = st.tuples(
    st.integers(0, CAMERAS - 1),
    st.integers(0, 2),
    st.tuples(NOISE, NOISE, NOISE),
    st.sampled_from([1.0, 0.5, 0.03]),
)


@st.composite
def problems(draw):
    people = np.array(draw(st.lists(PLACE, min_size=3, max_size=3)))
    seen = draw(st.lists(DETECTION, min_size=2, max_size=PLACES))
    camera = np.array([row[0] for row in seen])
    person = np.array([row[1] for row in seen])
    noise = np.array([row[2] for row in seen])
    weight = np.array([row[3] for row in seen])
    target = np.column_stack([people[person], np.zeros(len(seen))])
    possible = [
        (i, j) for i in range(len(seen)) for j in range(i + 1, len(seen)) if camera[i] != camera[j]
    ]
    order = draw(st.permutations(possible))
    alone = draw(st.lists(st.booleans(), min_size=len(order), max_size=len(order)))
    return camera, target, noise, weight, np.array(order).reshape(-1, 2), np.array(alone, bool)


def check(problem) -> None:
    camera, target, noise, weight, order, alone = problem
    rays = make_rays(camera, target, noise, weight)
    pairs = CandidatePairs(order[:, 0], order[:, 1], alone)
    wanted = one_after_the_other(rays, camera, pairs, TOLERANCE)
    groups = greedy_partition(
        rays,
        np.pad(camera, (0, PLACES - len(camera))),
        pairs,
        camera_count=CAMERAS,
        tolerance=TOLERANCE,
    )
    assert as_sets(groups) == wanted
    for row in groups:
        present = np.flatnonzero(row >= 0)
        np.testing.assert_array_equal(camera[row[present]], present)


@pytest.mark.slow
@settings(max_examples=150)
@given(problems())
def test_all_pairs_at_once_equal_one_pair_after_the_other(x64, problem):
    check(problem)


@pytest.mark.slow
@settings(max_examples=80)
@given(problems())
def test_small_windows_and_few_decisions_a_round_change_nothing(x64, small_windows, problem):
    check(problem)


@pytest.fixture
def small_windows(monkeypatch):
    # The window is a shape, so this compiles another variant with the other bound.
    monkeypatch.setattr(partition, "WINDOW", 13)
    monkeypatch.setattr(partition, "DECISIONS", 2)


def exact_rays(camera, target, centers=CENTERS) -> Rays:
    origin = centers[camera]
    direction = target - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(origin, direction, np.ones(len(camera)))


@pytest.mark.slow
def test_a_first_merge_decides_what_can_follow(x64):
    # Camera 2 sees two places close together: the earlier pair takes the place in the group.
    camera = np.array([0, 1, 2, 2])
    target = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0.01, 0], [0, 0.0, 0.0]])
    rays = exact_rays(camera, target)
    for order, wanted in [
        ([(0, 1), (0, 2), (0, 3)], {frozenset({0, 1, 2})}),
        ([(0, 3), (0, 1), (1, 2)], {frozenset({0, 1, 3})}),
        ([(0, 2), (1, 3), (0, 1)], {frozenset({0, 2}), frozenset({1, 3})}),
    ]:
        first, second = np.array(order).T
        pairs = CandidatePairs(first, second, np.zeros(len(order), bool))
        groups = greedy_partition(rays, camera, pairs, camera_count=4, tolerance=0.1)
        assert as_sets(groups) == wanted


@pytest.mark.slow
def test_a_unique_pair_only_joins_those_that_are_alone(x64):
    camera = np.array([0, 1, 2])
    rays = exact_rays(camera, np.zeros((3, 3)))
    pairs = CandidatePairs(np.array([0, 0]), np.array([1, 2]), np.array([False, True]))
    groups = greedy_partition(rays, camera, pairs, camera_count=4, tolerance=0.1)
    assert as_sets(groups) == {frozenset({0, 1})}
    pairs = CandidatePairs(np.array([0, 0]), np.array([2, 1]), np.array([True, False]))
    groups = greedy_partition(rays, camera, pairs, camera_count=4, tolerance=0.1)
    assert as_sets(groups) == {frozenset({0, 1, 2})}


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [32, 70])
def test_any_number_of_cameras(cameras):
    # Sets of cameras are bit sets, 32 per word.
    angle = np.linspace(0, 2 * np.pi, cameras, endpoint=False)
    centers = np.column_stack([np.cos(angle), np.sin(angle), np.full(cameras, 0.5)])
    camera = np.tile(np.arange(cameras), 2)
    person = np.repeat([0, 1], cameras)
    target = np.array([[0.1, 0, 0], [-0.3, 0.2, 0]])[person]
    rays = exact_rays(camera, target, centers)
    first, second = np.triu_indices(2 * cameras, k=1)
    different = camera[first] != camera[second]
    pairs = CandidatePairs(first[different], second[different], np.zeros(different.sum(), bool))
    rays = Rays(*(column.astype(np.float32) for column in vars(rays).values()))
    groups = greedy_partition(rays, camera, pairs, camera_count=cameras, tolerance=0.03)
    np.testing.assert_array_equal(groups, np.arange(2 * cameras).reshape(2, cameras))


def test_without_pairs_there_are_no_groups():
    none = np.zeros(0, np.int64)
    pairs = CandidatePairs(none, none, np.zeros(0, bool))
    rays = exact_rays(np.array([0, 1]), np.zeros((2, 3)))
    groups = greedy_partition(rays, np.array([0, 1]), pairs, camera_count=4, tolerance=0.1)
    assert groups.shape == (0, 4)


@pytest.mark.slow
def test_held_to_the_ground_rays_that_meet_above_it_do_not_agree(x64):
    camera = np.array([0, 1])
    pairs = CandidatePairs(np.array([0]), np.array([1]), np.array([False]))
    for height, free, held in [(0.0, 1, 1), (0.6, 1, 0)]:
        rays = exact_rays(camera, np.array([[0.0, 0, height], [0, 0, height]]))
        for constrained, wanted in [(False, free), (True, held)]:
            groups = greedy_partition(
                rays,
                camera,
                pairs,
                camera_count=4,
                tolerance=TOLERANCE,
                constrain_to_ground=constrained,
            )
            assert len(groups) == wanted
