"""Candidate pairs: the closed form of the residual, the rules, and memory."""

import tracemalloc

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from catfree import Detections, Rays
from catfree.methods.paper.association import (
    _candidate_pairs as pairs_module,
    candidate_pairs,
    cast_rays,
    observe,
)
from catfree.methods.paper.association._candidate_pairs import pair_residual
from catfree.settings import AssociationSettings
from catfree.synthetic import make_layout

NUMBER = st.floats(-2, 2).map(lambda x: round(x, 3))
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
WEIGHT = st.floats(1e-3, 1)

residual_of_pair = jax.jit(pair_residual)


def least_squares_residual(origins, directions, weights) -> float:
    """Stack the equations sqrt(w) (I - d dᵀ)(x - o) = 0 and solve them."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    scaled = np.sqrt(weights)[:, None, None] * across
    right = np.einsum("cij,cj->ci", scaled, origins).ravel()
    point = np.linalg.lstsq(scaled.reshape(-1, 3), right, rcond=None)[0]
    sight = point - origins
    sine = np.linalg.norm(np.cross(sight, directions), axis=1)
    return float(np.arctan2(sine, (sight * directions).sum(1)).max())


@pytest.mark.slow
@settings(max_examples=200)
@given(VECTOR, VECTOR, VECTOR, VECTOR, WEIGHT, WEIGHT)
def test_the_residual_is_that_of_least_squares(x64, o1, d1, o2, d2, w1, w2):
    origins, directions = np.array([o1, o2]), np.array([d1, d2])
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    assume((lengths > 0.1).all())
    directions /= lengths
    assume(np.linalg.norm(np.cross(*directions)) > 0.01)
    weights = np.array([w1, w2])
    residual = float(residual_of_pair(origins, directions, weights))
    across = np.cross(*directions)
    depths = np.array([np.cross(origins[1] - origins[0], d) @ across for d in directions[::-1]])
    assume((np.abs(depths) > 1e-6).all())  # the angle is undefined at a camera center
    np.testing.assert_allclose(
        residual, least_squares_residual(origins, directions, weights), atol=1e-7
    )
    if (depths < 0).any():
        assert residual > np.pi / 2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_parallel_rays_never_match(x64, dtype):
    origins = np.array([[0, 0, 0], [1, 0, 0]], dtype)
    for second in ([0, 0, 1], [0, 0, -1]):
        directions = np.array([[0, 0, 1], second], dtype)
        assert residual_of_pair(origins, directions, np.ones(2, dtype)) == dtype(np.pi)


def test_rays_from_one_place_meet_in_the_camera_and_never_match(x64):
    directions = np.array([[0.6, 0, 0.8], [0, 0.6, 0.8]])
    residual = residual_of_pair(np.zeros((2, 3)), directions, np.ones(2))
    np.testing.assert_allclose(residual, np.pi / 2)


def test_the_less_reliable_ray_has_the_larger_residual(x64):
    origins = np.array([[0.0, 0, 0], [1, 0, 0.1]])
    directions = np.array([[0.6, 0.8, 0], [-0.6, 0.8, 0]])
    even = residual_of_pair(origins, directions, np.ones(2))
    np.testing.assert_allclose(even, np.arctan2(0.05, 1 / 1.2))
    uneven = residual_of_pair(origins, directions, np.array([3.0, 1.0]))
    np.testing.assert_allclose(uneven, np.arctan2(0.075, 1 / 1.2))


FOOT = st.tuples(
    st.integers(0, 1),
    st.integers(0, 3),
    st.floats(-6, 6).map(lambda x: round(x, 2)),
    st.floats(-6, 6).map(lambda x: round(x, 2)),
    st.integers(0, 5),
)
LAYOUT = make_layout("ring4")


def observed(feet, *, embeddings: bool):
    """Make detections of people on the ground of a ring of four cameras."""
    frame, camera = np.array([row[:2] for row in feet]).T
    place = np.array([(x, y, 0.0) for _, _, x, y, _ in feet])
    rig = LAYOUT.rig
    local = np.einsum("nij,nj->ni", rig.R[camera], place) + rig.t[camera]
    pixel = np.einsum("nij,nj->ni", rig.K[camera], local)
    pixel = pixel[:, :2] / pixel[:, 2:]
    box = np.hstack([pixel - np.array([10, 100]), pixel + np.array([10, 0])])
    looks = np.eye(6)[[row[4] for row in feet]] + 0.3
    detections = Detections(frame, camera, box, embedding=looks if embeddings else None)
    observations = observe(detections, rig, keep=np.ones(len(feet), bool))
    return observations, cast_rays(observations, rig)


def brute_force(observations, rays: Rays, sigma_theta: float, rules: AssociationSettings) -> list:
    """Check every pair against every rule, one at a time."""
    count = len(observations)
    ends = [
        (i, j)
        for i in range(count)
        for j in range(i + 1, count)
        if observations.frame_index[i] == observations.frame_index[j]
        and observations.kept.camera[i] != observations.kept.camera[j]
    ]
    residual = {
        pair: float(residual_of_pair(*(np.asarray(a)[list(pair)] for a in vars(rays).values())))
        for pair in ends
    }
    camera = observations.kept.camera
    admitted = []
    for i, j in ends:
        if residual[i, j] > rules.residual_factor * sigma_theta:
            continue
        if observations.appearance is None:
            admitted.append((residual[i, j], residual[i, j], i, j, False))
            continue
        distance = 1 - observations.appearance[i] @ observations.appearance[j]
        others = [
            r for (a, b), r in residual.items() if a == i and b != j and camera[b] == camera[j]
        ]
        others += [
            r for (a, b), r in residual.items() if b == j and a != i and camera[a] == camera[i]
        ]
        unique = residual[i, j] <= rules.uniqueness_ratio * min(others, default=np.inf)
        similar = distance <= rules.appearance_threshold
        if similar or unique:
            admitted.append((distance, residual[i, j], i, j, not similar))
    return admitted


@pytest.mark.slow
@settings(max_examples=60)
@given(st.lists(FOOT, min_size=1, max_size=14), st.booleans(), st.sampled_from([5, 1 << 20]))
def test_pairs_are_those_of_the_rules_in_their_order(x64, monkeypatch, feet, embeddings, at_once):
    monkeypatch.setattr(pairs_module, "PAIRS_AT_ONCE", at_once)
    rules, sigma_theta = AssociationSettings(), 0.05
    observations, rays = observed(feet, embeddings=embeddings)
    pairs = candidate_pairs(
        observations,
        rays,
        (0, len(observations.frames)),
        sigma_theta=sigma_theta,
        settings=rules,
    )
    wanted = {row[2:4]: row for row in brute_force(observations, rays, sigma_theta, rules)}
    found = list(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    assert set(found) == set(wanted)
    assert len(found) == len(wanted)
    assert [wanted[pair][4] for pair in found] == pairs.singletons_only.tolist()
    keys = np.array([wanted[pair][:2] for pair in found]).reshape(-1, 2)
    assert (np.diff(keys[:, 0]) >= -1e-6).all()
    tied = np.diff(keys[:, 0]) == 0
    assert (np.diff(keys[:, 1])[tied] >= -1e-12).all()


@pytest.mark.slow
@settings(max_examples=20)
@given(st.lists(FOOT, min_size=2, max_size=14))
def test_frames_are_independent(x64, feet):
    observations, rays = observed(feet, embeddings=True)
    options = {"sigma_theta": 0.05, "settings": AssociationSettings()}
    frames = len(observations.frames)
    whole = candidate_pairs(observations, rays, (0, frames), **options)
    apart = []
    for frame in range(frames):
        begin, end = observations.frame_start(np.array([frame, frame + 1]))
        part = Rays(*(np.asarray(a)[begin:end] for a in vars(rays).values()))
        pairs = candidate_pairs(observations, part, (frame, frame + 1), **options)
        apart += list(zip(pairs.first + begin, pairs.second + begin, strict=True))
    assert set(apart) == set(zip(whole.first, whole.second, strict=True))


@pytest.mark.slow
def test_a_crowded_frame_needs_bounded_memory():
    rng = np.random.default_rng(0)
    count = 4000
    feet = [
        (0, int(c), float(x), float(y), int(p))
        for c, x, y, p in zip(
            rng.integers(0, 4, count),
            rng.uniform(-6, 6, count),
            rng.uniform(-6, 6, count),
            rng.integers(0, 6, count),
            strict=True,
        )
    ]
    observations, rays = observed(feet, embeddings=True)
    options = {"sigma_theta": 0.002, "settings": AssociationSettings()}
    candidate_pairs(observations, rays, (0, 1), **options)
    tracemalloc.start()
    candidate_pairs(observations, rays, (0, 1), **options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6  # six million pairs of two indices alone would take 96 MB
