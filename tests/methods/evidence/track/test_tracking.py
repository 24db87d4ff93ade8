"""Tracks: the smoother against a dense solution, simulated people, and gaps."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import Information, mean_and_covariance
from catfree.methods.evidence.group._appearance import no_looks
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.track._pasts import corrected_states
from catfree.methods.evidence.track._tracking import (
    Motion,
    Population,
    estimate_motion,
    follow,
    log_likelihood_of_states,
    mutual_steps,
    transition,
    unlinked,
)
from catfree.settings import EvidenceSettings

MOTION = Motion(0.2, 0.85, 0.03, 0.005)
# With so few people and so wide a gate, no step looks like a new person.
DENSITY, SPREAD = 1e-6, 0.06
RULES = EvidenceSettings(gate=40.0)


def groups_at(frame, state, deviation):
    """Make groups seen at states (H, 3) with a deviation of each place and height."""
    frame, state = np.asarray(frame, int), np.asarray(state, float)
    precision = np.broadcast_to(np.eye(3) / deviation**2, (len(frame), 3, 3)).copy()
    vector = state / deviation**2
    info = Information(precision, vector, (state**2).sum(1) / deviation**2)
    member = np.zeros((len(frame), 1), int)
    return Groups(frame, member, info, np.zeros(len(frame)))


def tracked(groups, time, log_odds=3.0, rules=RULES):
    time, looks = np.asarray(time, float), no_looks(len(groups))
    people = Population(time, MOTION, DENSITY, SPREAD, rules, looks)
    return follow(groups, np.full(len(groups), log_odds), people)


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
def test_a_step_is_that_of_a_velocity_that_fades_and_is_renewed(dt):
    # Van Loan's integral of dv = -rate v dt + noise, for a memory so long that, as in the filter,
    # the position moves with the velocity at the step's beginning.
    motion = dataclasses.replace(MOTION, memory=0.9999)
    rate = -np.log(motion.memory)
    F = np.array([[0.0, 1.0], [0.0, -rate]])
    G = np.diag([0.0, 2 * rate * motion.speed**2])
    block = scipy.linalg.expm(np.block([[-F, G], [np.zeros((2, 2)), F.T]]) * dt)
    exact_A = block[2:, 2:].T
    exact_Q = exact_A @ block[:2, 2:]
    A, Q = transition(motion, dt)
    jitter = transition(dataclasses.replace(motion, speed=0.0), dt)[1]
    for axis in (0, 1):
        both = np.ix_([axis, axis + 3], [axis, axis + 3])
        np.testing.assert_allclose(A[both], exact_A, rtol=1e-3)
        np.testing.assert_allclose((Q - jitter)[both], exact_Q, rtol=1e-3)
    assert (np.linalg.eigvalsh(Q) > -1e-15).all()


def dense_solution(observed, time):
    """Compute mean (T, 5) and covariance (T, 5, 5) of a person from one system of all moments.

    `observed` is the information (3, 3) and (3,) of each moment, or None in a gap.
    """
    T = len(time)
    matrix, vector = np.zeros((5 * T, 5 * T)), np.zeros(5 * T)
    matrix[2, 2] += SPREAD**-2
    vector[2] += SPREAD**-2
    matrix[3:5, 3:5] += np.eye(2) / MOTION.speed**2
    for t, seen in enumerate(observed):
        if seen is not None:
            at = slice(5 * t, 5 * t + 3)
            matrix[at, at] += seen[0]
            vector[at] += seen[1]
        if t:
            A, Q = transition(MOTION, time[t] - time[t - 1])
            step = np.hstack([-A, np.eye(5)])
            both = slice(5 * t - 5, 5 * t + 5)
            matrix[both, both] += step.T @ np.linalg.solve(Q, step)
    covariance = np.linalg.inv(matrix)
    blocks = [slice(5 * t, 5 * t + 5) for t in range(T)]
    return (covariance @ vector).reshape(T, 5), np.array([covariance[b, b] for b in blocks])


@pytest.mark.slow
@given(st.integers(0, 10**6), st.integers(1, 9), st.floats(0.02, 0.3))
def test_a_smoothed_track_is_the_solution_of_all_its_moments_at_once(seed, frames, deviation):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, frames))
    there = rng.random(frames) < 0.7
    there[[0, -1]] = True
    seen = np.flatnonzero(there)
    path = np.cumsum(rng.normal(0, 0.05, (frames, 2)), 0)
    state = np.column_stack([path, np.full(frames, 1.02)])[seen]
    groups = groups_at(seen, state + 0.3 * deviation * rng.standard_normal(state.shape), deviation)
    found = tracked(groups, time, rules=dataclasses.replace(RULES, gap=frames, gap_penalty=0.0))
    assert len(np.unique(found.track)) == 1
    np.testing.assert_array_equal(found.frame, np.arange(frames))
    np.testing.assert_array_equal(found.group >= 0, there)
    index = np.where(there, np.cumsum(there) - 1, -1)
    info = groups.info
    observed = [(info.matrix[i], info.vector[i]) if i >= 0 else None for i in index]
    mean, covariance = dense_solution(observed, time)
    np.testing.assert_allclose(found.mean, mean, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-12)


def crowd(seed, people=6, frames=20, deviation=0.05, recall=0.9):
    """Draw separate people from the model: identities, true places, and groups of those seen."""
    rng = np.random.default_rng(seed)
    A, Q = transition(MOTION, 1.0)
    start = np.stack(np.meshgrid([0.0, 30, 60], [0.0, 30]), -1).reshape(-1, 2)[:people]
    height = 1 + SPREAD * rng.standard_normal(people)
    state = np.column_stack([start, height, MOTION.speed * rng.standard_normal((people, 2))])
    states = []
    for _ in range(frames):
        states.append(state)
        state = state @ A.T + rng.multivariate_normal(np.zeros(5), Q, people)
    frame, person = (a.ravel() for a in np.indices((frames, people)))
    keep = rng.random(len(frame)) < recall
    true = np.concatenate(states)[keep, :3]
    groups = groups_at(frame[keep], true + deviation * rng.standard_normal(true.shape), deviation)
    return person[keep], true[:, :2], groups


@pytest.mark.slow
@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_people_keep_their_track_and_its_smoothing_helps(seed):
    person, place, groups = crowd(seed)
    found = tracked(groups, np.arange(20))
    seen = found.group >= 0
    np.testing.assert_array_equal(np.sort(found.group[seen]), np.arange(len(groups)))
    pairs = np.unique(np.column_stack([found.track[seen], person[found.group[seen]]]), axis=0)
    assert len(pairs) == len(np.unique(found.track)) == len(np.unique(person))
    error = found.mean[seen, :2] - place[found.group[seen]]
    raw = mean_and_covariance(groups.info, SPREAD)[0][:, :2] - place
    assert (error**2).mean() < (raw**2).mean()


@pytest.mark.slow
def test_errors_of_tracks_are_as_large_as_stated():
    ratio = []
    for seed in range(40):
        _, place, groups = crowd(seed)
        found = tracked(groups, np.arange(20))
        seen = found.group >= 0
        error = found.mean[seen, :2] - place[found.group[seen]]
        inverse = np.linalg.inv(found.covariance[seen, :2, :2])
        ratio.append(np.einsum("ni,nij,nj->n", error, inverse, error).mean() / 2)
    # The mean is one, to within four deviations of the mean over these crowds.
    assert np.mean(ratio) == pytest.approx(1, abs=4 * np.std(ratio) / np.sqrt(len(ratio)))
    assert np.std(ratio) < 0.3


@pytest.mark.slow
@settings(max_examples=10)
@given(st.integers(0, 10**6), st.randoms(use_true_random=False))
def test_the_order_within_a_frame_renames_and_no_more(seed, random):
    _, _, groups = crowd(seed)
    order = list(range(len(groups)))
    random.shuffle(order)
    order = np.array(order)[np.argsort(groups.frame[order], kind="stable")]
    mixed = Groups(
        groups.frame[order], groups.member[order], groups.info[order], groups.gain[order]
    )
    one, other = tracked(groups, np.arange(20)), tracked(mixed, np.arange(20))

    def chains(trails, name):
        """Return each track as its groups with their positions."""
        return {
            tuple(name[trails.group[rows][trails.group[rows] >= 0]]): trails.mean[rows]
            for rows in (np.flatnonzero(trails.track == k) for k in np.unique(trails.track))
        }

    plain, renamed = chains(one, np.arange(len(groups))), chains(other, order)
    assert plain.keys() == renamed.keys()
    for key, mean in plain.items():
        np.testing.assert_allclose(renamed[key], mean, atol=1e-9)


@pytest.mark.parametrize("missing", [0, 1, RULES.gap, RULES.gap + 1])
def test_a_track_bridges_as_many_frames_as_the_settings_allow(missing):
    rules = dataclasses.replace(RULES, gap_penalty=0.0)
    frames = np.r_[np.arange(4), 4 + missing + np.arange(4)]
    groups = groups_at(frames, np.tile([1.0, 2.0, 1.0], (8, 1)), 0.05)
    found = tracked(groups, np.arange(8 + missing), rules=rules)
    bridged = missing <= RULES.gap
    assert len(np.unique(found.track)) == (1 if bridged else 2)
    # Ends are trimmed: no track lasts longer than its person was seen.
    assert (found.group < 0).sum() == (missing if bridged else 0)
    inside = found.covariance[:, 0, 0]
    if bridged and missing:
        assert inside[found.group < 0].min() > inside[found.group >= 0].max()


def test_who_is_unlikely_starts_no_track():
    groups = groups_at([0, 1, 2], np.tile([1.0, 2.0, 1.0], (3, 1)), 0.05)
    assert len(tracked(groups, np.arange(3), log_odds=-RULES.evidence_limit / 2)) == 0
    assert len(tracked(groups, np.arange(3), log_odds=0.1 - RULES.evidence_limit / 2)) == 3


def test_two_people_farther_apart_than_anyone_walks_are_two():
    groups = groups_at([0, 1], [[0.0, 0, 1], [5.0, 0, 1]], 0.05)
    assert len(np.unique(tracked(groups, np.arange(2)).track)) == 2


def test_nobody_leaves_no_track():
    assert len(tracked(groups_at([], np.zeros((0, 3)), 0.1), np.arange(3))) == 0
    nobody = unlinked(np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert len(nobody) == 0


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0.08, 0.6))
def test_the_speed_of_a_scattered_crowd_is_what_was_drawn(seed, speed):
    rng = np.random.default_rng(seed)
    people, frames = 25, 40
    place = 20.0 * np.stack(np.divmod(np.arange(people), 5), -1)
    step = np.clip(speed * rng.standard_normal((frames, people, 2)), -1, 1)
    path = place + np.cumsum(step, 0)
    frame = np.repeat(np.arange(frames), people)
    found = estimate_motion(path.reshape(-1, 2), frame, np.arange(frames).astype(float), RULES)
    # From 2000 steps the deviation is known to 1/60; paths of 40 steps stay in their cells.
    assert found.speed == pytest.approx(np.sqrt((step[1:] ** 2).mean()), rel=0.1)
    assert found.speed == pytest.approx(speed, rel=0.12)


@given(
    st.lists(st.integers(0, 4), min_size=1, max_size=8).map(np.cumsum),
    st.integers(0, 10**6),
    st.sampled_from([0.0, 1.0, 1e6]),
)
def test_steps_join_positions_that_are_each_others_nearest(counts, seed, distance):
    """`counts` are running totals, so that some frames are empty."""
    rng = np.random.default_rng(seed)
    frame = np.repeat(np.arange(len(counts)), np.diff(counts, prepend=0)).astype(int)
    position = distance + rng.standard_normal((len(frame), 2))
    expected = []
    for t in range(len(counts) - 1):
        a, b = position[frame == t], position[frame == t + 1]
        if len(a) and len(b):
            apart = np.linalg.norm(a[:, None] - b[None], axis=-1)
            near = (apart == apart.min(0)) & (apart == apart.min(1)[:, None])
            expected.extend((b[None] - a[:, None])[near])
    found = mutual_steps(position, frame)
    np.testing.assert_array_equal(found, np.reshape(expected, (-1, 2)))


def test_the_speed_over_a_pause_of_the_recording_says_nothing():
    frame = np.repeat([0, 1], 12)
    path = np.arange(24)[:, None] % 12 * np.array([[5.0, 0.0]]) + 0.3 * frame[:, None]
    close = estimate_motion(path, frame, np.array([0.0, 1.0]), RULES)
    assert close.speed == pytest.approx(0.3)
    assert estimate_motion(path, frame, np.array([0.0, 9.0]), RULES) == estimate_motion(
        path[:1], frame[:1], np.array([0.0]), RULES
    )


def uncertain_states(seed, count=4):
    """Draw means (n, 5), covariances (n, 5, 5), and measurements of their first three entries."""
    rng = np.random.default_rng(seed)
    mean, root = rng.standard_normal((count, 5)), rng.standard_normal((count, 5, 5))
    covariance = root @ root.swapaxes(1, 2)
    measured, root = rng.standard_normal((count, 3)), rng.standard_normal((count, 3, 3))
    noise = 10 ** rng.uniform(-3, 1) * (root @ root.swapaxes(1, 2) + 0.1 * np.eye(3))
    return mean, covariance, measured, noise


@given(st.integers(0, 10**6))
def test_states_are_corrected_as_by_the_gain_of_a_kalman_filter(seed):
    mean, covariance, measured, noise = uncertain_states(seed)
    precision = np.linalg.inv(noise)
    vector = (precision @ measured[..., None])[..., 0]
    after, around = corrected_states(mean, covariance, precision, vector)
    for i, m in enumerate(mean):
        gain = covariance[i][:, :3] @ np.linalg.inv(covariance[i][:3, :3] + noise[i])
        np.testing.assert_allclose(after[i], m + gain @ (measured[i] - m[:3]), atol=1e-6)
        kept = np.eye(5) - np.pad(gain, ((0, 0), (0, 2)))
        expected = kept @ covariance[i] @ kept.T + gain @ noise[i] @ gain.T
        np.testing.assert_allclose(around[i], expected, atol=1e-6 * covariance[i].max())


@given(st.integers(0, 10**6))
def test_states_are_as_likely_as_the_measurement_that_they_predict(seed):
    mean, covariance, measured, noise = uncertain_states(seed)
    precision = np.linalg.inv(noise)
    vector = (precision @ measured[..., None])[..., 0]
    found = log_likelihood_of_states(mean[:, :3], covariance[:, :3, :3], precision, vector)
    for i, m in enumerate(mean):
        predicted = scipy.stats.multivariate_normal(m[:3], covariance[i][:3, :3] + noise[i])
        exact = scipy.stats.multivariate_normal(measured[i], noise[i]).logpdf(measured[i])
        # The form omits the measurement's own square and the maximum of its density.
        rest = 0.5 * measured[i] @ vector[i]
        np.testing.assert_allclose(
            found[i] - rest, predicted.logpdf(measured[i]) - exact, rtol=1e-6, atol=1e-6
        )


def test_a_sure_measurement_of_an_unsure_state_leaves_a_covariance():
    covariance = np.diag([1e8, 1e8, 1.0, 1.0, 1.0])[None]
    covariance[0, 0, 3] = covariance[0, 3, 0] = 5e3
    precise = np.diag([1e8, 1e8, 1e4])[None]
    mean, around = np.zeros((1, 5)), covariance
    for _ in range(50):
        mean, around = corrected_states(mean, around, precise, np.ones((1, 3)))
        assert (np.linalg.eigvalsh(around + around.swapaxes(1, 2)) > 0).all()
        assert (np.diagonal(around, axis1=1, axis2=2) > 0).all()
    np.testing.assert_allclose(around[0, 0, 0], 1e-8 / 50, rtol=1e-6)
