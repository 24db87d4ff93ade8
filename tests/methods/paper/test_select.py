"""The filters in sequence: a hypothesis' fate names the filter that removed it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Fate
from catfree.methods.paper import _select as selection
from catfree.methods.paper._select import (
    Hypotheses,
    outside_by_frame,
    select_positions,
    suppress_by_frame,
)
from catfree.settings import SelectionSettings

SIGMA_THETA = 0.02
RULES = SelectionSettings()  # RMS gate 0.04 rad, radius 0.018


def people(frames: int = 4, count: int = 5) -> Hypotheses:
    """Make people who stand far apart, all well seen by three cameras, in every frame."""
    total = frames * count
    person = np.tile(np.arange(count), frames)
    tracklets = np.column_stack([person, person + 100, person + 200])
    return Hypotheses(
        frame_index=np.repeat(np.arange(frames), count),
        ground_xy=np.column_stack([0.1 * person, np.zeros(total)]),
        ground_distance=np.full(total, 0.001) + 1e-5 * np.arange(total),
        rms_angle=np.full(total, 0.005),
        sigma=np.full(total, 0.004) + 1e-5 * np.arange(total),
        weight=np.full(total, 3.0),
        cameras=np.full(total, 3),
        tracklet=tracklets,
        supporting_tracklet=tracklets,
        score=np.zeros(total),
    )


def joined(*parts: Hypotheses) -> Hypotheses:
    return Hypotheses(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def junk(frames: int = 4, count: int = 3, **columns) -> Hypotheses:
    """Make hypotheses far from the people, with their own tracklets."""
    base = people(frames, count)
    far = base._replace(
        ground_xy=base.ground_xy + np.array([0.0, 5.0]),
        tracklet=base.tracklet + 1000,
        supporting_tracklet=base.supporting_tracklet + 1000,
    )
    return far._replace(**{k: np.full(len(far.sigma), v) for k, v in columns.items()})


def fates(hypotheses: Hypotheses, **rules) -> np.ndarray:
    settings = dataclasses.replace(RULES, **rules)
    return select_positions(hypotheses, settings, sigma_theta=SIGMA_THETA).fate


UNCERTAIN: dict[str, Any] = {"sigma": 0.1, "ground_distance": 0.5, "weight": 1.0, "cameras": 2}
FLOATING: dict[str, Any] = {"ground_distance": 0.5}
GATES = ["none", "support", "ground_only", "uncertainty_add", "uncertainty_replace"]
GATES += ["ground_then_uncertainty_replace", "ground_then_uncertainty_add"]
GATES += ["uncertainty_then_ground"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gates", "uncertain", "floating"),
    [
        ("none", Fate.ACCEPTED, Fate.ACCEPTED),
        ("support", Fate.SUPPORT_FILTER, Fate.ACCEPTED),
        ("ground_only", Fate.SUPPORT_FILTER, Fate.GROUND_FILTER),
        ("uncertainty_add", Fate.SUPPORT_FILTER, Fate.ACCEPTED),
        ("uncertainty_replace", Fate.UNCERTAINTY_FILTER, Fate.ACCEPTED),
        ("ground_then_uncertainty_replace", Fate.GROUND_FILTER, Fate.GROUND_FILTER),
        ("ground_then_uncertainty_add", Fate.SUPPORT_FILTER, Fate.GROUND_FILTER),
        ("uncertainty_then_ground", Fate.UNCERTAINTY_FILTER, Fate.GROUND_FILTER),
    ],
)
def test_each_order_of_the_gates_names_what_removed(gates, uncertain, floating):
    right, wrong = people(), junk(**UNCERTAIN)
    above = junk(**FLOATING)._replace(ground_xy=junk().ground_xy + np.array([0, 5.0]))
    above = above._replace(tracklet=above.tracklet + 1000)
    fate = fates(joined(right, wrong, above), gates=gates, recover=False)
    assert (fate[20:32] == uncertain).all()
    assert (fate[32:] == floating).all()
    if gates != "ground_then_uncertainty_replace":  # splits the rest after the ground filter
        assert (fate[:20] == Fate.ACCEPTED).all()


@pytest.mark.slow
def test_the_rms_gate_comes_first_and_its_losers_teach_nothing():
    wrong = junk(rms_angle=0.0401, **UNCERTAIN)
    chosen = select_positions(joined(people(), wrong), RULES, sigma_theta=SIGMA_THETA)
    alone = select_positions(people(), RULES, sigma_theta=SIGMA_THETA)
    assert (chosen.fate[20:] == Fate.RMS_GATE).all()
    assert chosen.tau_sigma == alone.tau_sigma
    assert (fates(joined(people(), junk(rms_angle=0.0399)), gates="none") != Fate.RMS_GATE).all()
    assert (fates(joined(people(), wrong), gates="none", rms_factor=3.0) == Fate.ACCEPTED).all()


@pytest.mark.slow
def test_no_camera_pair_no_sigma():
    blind = junk(sigma=np.inf, cameras=1, weight=1.0)
    chosen = select_positions(joined(people(), blind), RULES, sigma_theta=SIGMA_THETA)
    assert (chosen.fate[20:] == Fate.UNCERTAINTY_FILTER).all()
    alone = select_positions(people(), RULES, sigma_theta=SIGMA_THETA)
    assert chosen.tau_sigma == alone.tau_sigma


@pytest.mark.slow
def test_a_match_must_last():
    flicker = junk(frames=4, count=1)
    once = np.arange(4)[:, None] * 10 + np.array([5000, 6000, 7000])
    flicker = flicker._replace(tracklet=once, supporting_tracklet=once)
    everything = joined(people(), flicker)
    assert (fates(everything, gates="none")[20:] == Fate.TEMPORAL_FILTER).all()
    assert (fates(everything, gates="none", temporal_frames=1)[20:] == Fate.ACCEPTED).all()
    # One pair of its tracklets that supports a hypothesis in another frame is enough.
    pair = once.copy()
    pair[1, :2] = pair[0, :2]
    lasting = joined(people(), flicker._replace(supporting_tracklet=pair))
    assert fates(lasting, gates="none")[20:].tolist() == [
        Fate.ACCEPTED,
        Fate.TEMPORAL_FILTER,
        Fate.TEMPORAL_FILTER,
        Fate.TEMPORAL_FILTER,
    ]


@pytest.mark.slow
def test_the_better_supported_of_two_close_ones_stays():
    double = people()._replace(ground_xy=people().ground_xy + np.array([0.0179, 0.0]))
    for weight, kept in [(2.0, slice(0, 20)), (4.0, slice(20, 40))]:
        stronger = double._replace(weight=np.full(20, weight))
        fate = fates(joined(people(), stronger), gates="none")
        assert (fate[kept] == Fate.ACCEPTED).all()
        assert (fate == Fate.SUPPRESSED).sum() == 20
    apart = people()._replace(ground_xy=people().ground_xy + np.array([0.0181, 0.0]))
    assert (fates(joined(people(), apart), gates="none") == Fate.ACCEPTED).all()


@pytest.mark.slow
def test_the_score_breaks_ties_only_where_it_is_used():
    double = people()._replace(ground_xy=people().ground_xy + 0.001, score=np.ones(20))
    fate = fates(joined(people(), double), gates="none")
    assert (fate[20:] == Fate.ACCEPTED).all()
    fate = fates(joined(people(), double), gates="none", use_score=False)
    assert (fate[:20] == Fate.ACCEPTED).all()


def recoverable(cameras: int, shift: float) -> Hypotheses:
    """Add a person seen less well than the rest, at a distance from the first."""
    worse = junk(count=1, cameras=cameras, weight=float(cameras))
    place = np.tile([[shift, 0.0]], (4, 1))
    return worse._replace(ground_xy=place, sigma=np.array([0.02, 0.02, 0.03, 0.03]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cameras", "shift", "recovered"),
    [(3, -0.05, True), (2, -0.05, False), (3, -0.0179, False), (3, -0.0181, True)],
)
def test_recovery_is_for_well_seen_people_away_from_the_others(cameras, shift, recovered):
    everything = joined(people(), recoverable(cameras, shift))
    rules = dataclasses.replace(RULES, gates="uncertainty_replace")
    chosen = select_positions(everything, rules, sigma_theta=SIGMA_THETA)
    assert (chosen.fate[:20] == Fate.ACCEPTED).all()
    # The thresholds are re-estimated on the remaining hypotheses, so some of these pass.
    assert (chosen.fate[20:] == Fate.RECOVERED).any() == recovered
    assert chosen.accepted.sum() == np.isin(chosen.fate, (0, 1)).sum()
    without = fates(everything, gates="uncertainty_replace", recover=False)
    assert (without[20:] == Fate.UNCERTAINTY_FILTER).all()
    assert (without != Fate.RECOVERED).all()


@pytest.mark.slow
def test_a_fixed_quantile_replaces_the_thresholds():
    chosen = select_positions(
        people(),
        dataclasses.replace(RULES, fixed_quantile=0.5, gates="uncertainty_replace", recover=False),
        sigma_theta=SIGMA_THETA,
    )
    assert chosen.tau_sigma is not None
    np.testing.assert_allclose(chosen.tau_sigma, np.median(people().sigma), rtol=1e-5)
    assert chosen.tau_g is None
    assert (chosen.fate == Fate.ACCEPTED).sum() == 10


@pytest.mark.slow
@pytest.mark.parametrize("gates", GATES)
def test_no_hypotheses(gates):
    nobody = Hypotheses(*(column[:0] for column in people()))
    chosen = select_positions(
        nobody, dataclasses.replace(RULES, gates=gates), sigma_theta=SIGMA_THETA
    )
    assert chosen.fate.shape == (0,)
    assert chosen.tau_sigma is None


PLACE = st.tuples(
    st.integers(0, 2),
    st.integers(0, 30),
    st.integers(0, 30),
    st.integers(0, 5),
    st.booleans(),
)


@pytest.mark.slow
@given(st.lists(PLACE, max_size=30), st.sampled_from([0.0, 5.0, 5.5]))
def test_suppression_by_frame_is_greedy(places, radius):
    frame, x, y, weight, candidate = np.array(places, int).reshape(-1, 5).T
    xy, candidate = np.column_stack([x, y]).astype(float), candidate.astype(bool)
    priority = np.column_stack([weight, np.zeros(len(x))]).astype(float)
    keep = suppress_by_frame(frame, xy, priority, candidate, radius)
    kept: list[int] = []
    for i in np.argsort(-weight, kind="stable"):
        near = [j for j in kept if frame[j] == frame[i] and np.hypot(*(xy[i] - xy[j])) <= radius]
        if candidate[i] and not near:
            kept.append(int(i))
    assert np.flatnonzero(keep).tolist() == sorted(kept)
    free = outside_by_frame(frame, xy, keep, np.ones(len(x), bool), radius)
    for i in range(len(x)):
        near = [j for j in kept if frame[j] == frame[i] and np.hypot(*(xy[i] - xy[j])) <= radius]
        assert free[i] == (not near)


@pytest.mark.slow
@pytest.mark.parametrize("count", [40, 3000])
def test_suppression_compares_so_many_pairs_at_a_time_and_keeps_the_same(monkeypatch, count):
    rng = np.random.default_rng(1)
    frame = np.repeat([0, 1, 2], [count, 5, 5])
    place = rng.uniform(0, 1, (len(frame), 2))
    rank = rng.permutation(len(frame))[:, None].astype(float)
    present = np.ones(len(frame), bool)
    pairs = []
    suppress = selection._suppress_frames

    def spy(xy, *rest):
        pairs.append(xy.shape[0] * xy.shape[1] ** 2)
        return suppress(xy, *rest)

    monkeypatch.setattr(selection, "_suppress_frames", spy)
    kept = suppress_by_frame(frame, place, rank, present, 0.05)
    places = max(64, 1 << (count - 1).bit_length())
    assert max(pairs) <= max(selection.PAIRS_BLOCK, places**2)
    monkeypatch.setattr(selection, "PAIRS_BLOCK", 1)
    np.testing.assert_array_equal(suppress_by_frame(frame, place, rank, present, 0.05), kept)


def test_positions_without_a_rival_are_kept_without_comparing_pairs(monkeypatch):
    monkeypatch.delattr(selection, "_suppress_frames")
    place = np.array([[0.0, 0], [1, 0], [0, 0], [5, 5]])
    frame, rank = np.array([0, 0, 2**62, 0]), np.zeros((4, 1))
    candidate = np.array([True, True, True, False])
    kept = suppress_by_frame(frame, place, rank, candidate, 0.9)
    np.testing.assert_array_equal(kept, candidate)
    assert not suppress_by_frame(frame[:0], place[:0], rank[:0], candidate[:0], 0.9).size


def test_the_shapes_of_a_sequence_do_not_depend_on_how_many_frames_hold_rivals(monkeypatch):
    shapes = []
    suppress = selection._suppress_frames

    def spy(xy, *rest):
        shapes.append(xy.shape)
        return suppress(xy, *rest)

    monkeypatch.setattr(selection, "_suppress_frames", spy)
    frame = np.repeat(np.arange(4), 2)
    rank, candidate = np.arange(8.0)[:, None], np.ones(8, bool)
    for crowded in (1, 2, 4):
        place = np.column_stack([np.tile([0.0, 9], 4), np.zeros(8)])
        place[frame < crowded] = 0
        kept = suppress_by_frame(frame, place, rank, candidate, 0.9)
        assert kept.sum() == 8 - crowded
    assert len(set(shapes)) == 1
