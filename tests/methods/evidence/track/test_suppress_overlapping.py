import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence import EvidenceSettings, describe, solve
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.methods.evidence.track._tracking import Trails
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Fate

RADIUS = 0.15


def trails(track, frame, xy, seen=None, spread=None):
    """Make tracks at places (n, 2), with `seen` false in gaps and `spread` as variance."""
    track, frame = np.asarray(track, int), np.asarray(frame, int)
    n = len(track)
    mean = np.column_stack([np.reshape(xy, (n, 2)), np.ones(n), np.zeros((n, 2))])
    group = np.where(np.ones(n, bool) if seen is None else seen, np.arange(n), -1)
    spread = np.ones(n) if spread is None else np.asarray(spread, float)
    return Trails(track, frame, group, mean, spread[:, None, None] * np.eye(5))


@st.composite
def crowds(draw):
    """Draw static tracks close to one another, with the evidence of each of their rows.

    Evidence saturates, so that many tracks are equally well supported; no two are equally sharp.
    """
    people, frames = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    count = people * frames
    place = st.tuples(st.integers(0, 10), st.integers(0, 10))
    xy = 0.06 * np.array(draw(st.lists(place, min_size=people, max_size=people)))
    evidence = draw(st.lists(st.sampled_from([2.0, 6.0]), min_size=people, max_size=people))
    flags = st.lists(st.booleans(), min_size=count, max_size=count)
    sharpness = draw(st.permutations(range(count)))
    rows = trails(
        np.repeat(np.arange(people), frames),
        np.tile(np.arange(frames), people),
        np.repeat(xy, frames, axis=0),
        np.array(draw(flags)),
        1 + np.array(sharpness),
    )
    return rows, np.repeat(evidence, frames), np.array(draw(flags))


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@settings(max_examples=60, deadline=None)
@given(crowds())
def test_nobody_stays_beside_a_better_supported_one_and_nobody_goes_without_one(crowd):
    rows, evidence, here = crowd
    alone = suppress_overlapping_tracks(rows, evidence, here, RADIUS)
    assert not (alone & ~here).any()
    support = np.bincount(rows.track, np.where(here, evidence, 0))[rows.track]
    rank = list(zip(rows.group >= 0, support, -rows.covariance[:, 0, 0], strict=True))
    apart = np.linalg.norm(rows.mean[:, None, :2] - rows.mean[None, :, :2], axis=-1)
    in_reach = (rows.frame[:, None] == rows.frame) & (apart < RADIUS)
    np.fill_diagonal(in_reach, False)
    assert not (in_reach & alone[:, None] & alone).any()
    for row in np.flatnonzero(here & ~alone):
        assert any(rank[other] > rank[row] for other in np.flatnonzero(in_reach[row] & alone))


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@settings(max_examples=60, deadline=None)
@given(crowds(), st.randoms(use_true_random=False))
def test_the_order_of_the_rows_says_nothing(crowd, random):
    rows, evidence, here = crowd
    order = np.arange(len(rows))
    random.shuffle(order)
    mixed = suppress_overlapping_tracks(rows[order], evidence[order], here[order], RADIUS)
    np.testing.assert_array_equal(
        mixed, suppress_overlapping_tracks(rows, evidence, here, RADIUS)[order]
    )


@pytest.mark.slow
def test_a_long_track_outlives_a_short_one_that_is_surer_for_a_moment():
    rows = trails([0, 0, 0, 1], [0, 1, 2, 1], [[0, 0]] * 3 + [[0.1, 0]])
    found = suppress_overlapping_tracks(
        rows, np.array([3.0, 3.0, 3.0, 6.0]), np.ones(4, bool), RADIUS
    )
    np.testing.assert_array_equal(found, [True, True, True, False])


@pytest.mark.slow
def test_who_was_seen_stays_before_the_gap_of_a_better_supported_track():
    rows = trails([0, 0, 0, 1], [0, 1, 2, 1], [[0, 0]] * 4, seen=[True, False, True, True])
    found = suppress_overlapping_tracks(
        rows, np.array([6.0, 1.0, 6.0, 2.0]), np.ones(4, bool), RADIUS
    )
    np.testing.assert_array_equal(found, [True, False, True, True])


@pytest.mark.slow
def test_of_equals_the_sharper_one_stays():
    rows = trails([0, 1], [0, 0], [[0, 0]] * 2, spread=[2.0, 1.0])
    found = suppress_overlapping_tracks(rows, np.full(2, 6.0), np.ones(2, bool), RADIUS)
    np.testing.assert_array_equal(found, [False, True])


@pytest.mark.slow
def test_who_is_not_there_displaces_nobody_and_a_radius_of_nought_keeps_all():
    rows = trails([0, 1], [0, 0], [[0, 0]] * 2)
    found = suppress_overlapping_tracks(rows, np.array([6.0, 2.0]), np.array([False, True]), RADIUS)
    np.testing.assert_array_equal(found, [False, True])
    assert suppress_overlapping_tracks(rows, np.array([6.0, 2.0]), np.ones(2, bool), 0.0).all()


@pytest.mark.slow
def test_arms_length_is_far_enough_and_so_is_another_moment():
    rows = trails([0, 1, 2], [0, 0, 1], [[0, 0], [0.3, 0], [0, 0]])
    assert suppress_overlapping_tracks(rows, np.ones(3), np.ones(3, bool), RADIUS).all()


def test_nobody_is_alone_where_nobody_is():
    assert suppress_overlapping_tracks(
        trails([], [], []), np.zeros(0), np.zeros(0, bool), RADIUS
    ).shape == (0,)


def in_camps(personal_space, by_looks):
    """Simulate a crowd with distinct embeddings, in a rig so wrong that cameras disagree."""
    looks = DetectorModel(identity=0.7, view=0.0, camera=0.0, noise=0.0)
    world = make_world("gmvd6", 0, frames=8, detector=looks)
    rules = EvidenceSettings(personal_space=personal_space, link_by_looks=by_looks)
    solution = solve(world.detections, world.scene, rules)
    return solution, describe(solution, world.detections, world.scene, rules)


def pairs_in_one_place(solution):
    rows = solution.trails[solution.kept]
    apart = np.linalg.norm(rows.mean[:, None, :2] - rows.mean[None, :, :2], axis=-1)
    together = (rows.frame[:, None] == rows.frame) & ~np.eye(len(rows), dtype=bool)
    return (together & (apart < RADIUS)).sum() // 2


# Tracks continued by appearance duplicate fewer people.
@pytest.mark.slow
@pytest.mark.parametrize(("by_looks", "doubled"), [(False, 3), (True, 1)])
def test_camps_of_cameras_report_one_person_and_nobody_is_lost(by_looks, doubled):
    both, _ = in_camps(0.0, by_looks)
    one, found = in_camps(RADIUS, by_looks)
    assert pairs_in_one_place(both) >= doubled
    assert pairs_in_one_place(one) == 0
    assert len(found.tracks) >= 0.97 * (both.kept.sum() - pairs_in_one_place(both))
    rows, suppressed = one.trails, one.fate == Fate.SUPPRESSED
    groups = rows.group[suppressed & (rows.group >= 0)]
    assert set(np.flatnonzero(found.candidates.fate == Fate.SUPPRESSED)) == set(groups)
    for row in np.flatnonzero(suppressed):
        there = one.kept & (rows.frame == rows.frame[row])
        assert np.linalg.norm(rows.mean[there, :2] - rows.mean[row, :2], axis=1).min() <= RADIUS
