"""Fragments of one person's track are joined, and no others."""

from itertools import combinations

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import linear_sum_assignment

from catfree._run._cache import content_hash
from catfree._run._stitch import (
    add_habits,
    best_assignment,
    displacement_variance,
    learn_fragments,
    link_fragments,
    squared_displacement,
    stitch_tracks,
)
from catfree.methods.paper._assemble import empty_localization
from catfree.types import (
    Candidates,
    Detections,
    Fate,
    Localization,
    Origin,
    Tracks,
)

CAMERAS, LOOKS = 2, 16


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def sequence(people, holes, *, seed=0, frames=60, looks=True):
    """Make people who walk straight, missing in some frames; every fragment is a separate track.

    Args:
        people: number of people, 3 m apart, at 0.25 m per frame.
        holes: maps a person to the (first, last) frame without positions.
    """
    rng = np.random.default_rng(seed)
    clothes = unit(rng.normal(size=(people, LOOKS)))
    rows = []
    for person in range(people):
        track = 2 * person
        for frame in range(frames):
            begin, end = holes.get(person, (frames, frames))
            if begin <= frame <= end:
                continue
            x = 0.25 * frame + rng.normal(0, 0.02)
            rows.append((frame, track + (frame > end), person, x, 3.0 * person))
    rows.sort(key=lambda row: (row[0], row[1]))
    frame, track, person, x, y = (np.array(column) for column in zip(*rows, strict=True))
    count = len(frame)
    position = np.column_stack([x, y, np.zeros(count)])
    support = np.arange(CAMERAS * count).reshape(count, CAMERAS)
    tracks = Tracks(
        frame=frame,
        track_id=track,
        position=position,
        ground_xy=position[:, :2],
        sigma=np.full(count, 0.02),
        covariance=np.tile(0.0004 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.full(count, CAMERAS),
        origin=np.full(count, int(Origin.DETECTED)),
        support=support,
    )
    candidates = Candidates(
        frame=frame,
        position=position,
        sigma=tracks.sigma,
        ground_distance=np.zeros(count),
        rms_angle=np.zeros(count),
        support=support,
        score=np.ones(count),
        fate=np.full(count, int(Fate.ACCEPTED)),
    )
    seen = unit(
        clothes[person].repeat(CAMERAS, 0) + 0.05 * rng.normal(size=(CAMERAS * count, LOOKS))
    )
    detections = Detections(
        frame.repeat(CAMERAS),
        np.tile(np.arange(CAMERAS), count),
        np.tile([[0.0, 0, 10, 30]], (CAMERAS * count, 1)),
        embedding=seen if looks else None,
    )
    nothing = empty_localization(CAMERAS)
    return (
        Localization(tracks, candidates, nothing.thresholds, nothing.reliability, CAMERAS * count),
        detections,
        person,
    )


def pairs(labels):
    return labels[:, None] == labels[None, :]


@pytest.mark.slow
@given(
    st.integers(9, 12),
    st.dictionaries(
        st.integers(0, 8), st.tuples(st.integers(10, 30), st.integers(0, 12)), max_size=5
    ),
    st.integers(0, 20),
    st.booleans(),
)
def test_every_person_gets_one_identity(people, cuts, seed, looks):
    # Without appearance, only a short gap is certain.
    longest = 12 if looks else 2
    holes = {one: (begin, begin + min(gap, longest)) for one, (begin, gap) in cuts.items()}
    localization, detections, person = sequence(people, holes, seed=seed, looks=looks)
    found = stitch_tracks(localization, detections)
    joined = found.tracks
    place = np.lexsort((person, localization.tracks.frame))  # people stand apart in y
    again = np.lexsort((joined.ground_xy[:, 1], joined.frame))
    np.testing.assert_array_equal(joined.position[again], localization.tracks.position[place])
    np.testing.assert_array_equal(pairs(joined.track_id[again]), pairs(person[place]))
    assert set(joined.track_id) == set(range(people))
    # Box identities follow the new names.
    np.testing.assert_array_equal(pairs(found.identity), pairs(person.repeat(CAMERAS)))


@pytest.mark.slow
@given(st.randoms(use_true_random=False))
def test_names_of_the_pieces_do_not_matter(random):
    localization, detections, _ = sequence(9, {1: (20, 24), 4: (30, 33)})
    names = list(range(40, 40 + 18))
    random.shuffle(names)
    renamed = eqx.tree_at(
        lambda result: result.tracks.track_id,
        localization,
        np.array(names)[localization.tracks.track_id],
    )
    one = stitch_tracks(localization, detections).tracks
    two = stitch_tracks(renamed, detections).tracks

    def by_place(tracks):
        return tracks.track_id[np.lexsort((tracks.ground_xy[:, 1], tracks.frame))]

    np.testing.assert_array_equal(by_place(one), by_place(two))


def test_another_look_at_the_same_place_is_another_person():
    localization, detections, person = sequence(9, {3: (20, 24)})
    late = (detections.frame > 24) & (person.repeat(CAMERAS) == 3)
    stranger = np.where(late[:, None], -detections.embedding, detections.embedding)
    swapped = eqx.tree_at(lambda d: d.embedding, detections, stranger)
    joined = stitch_tracks(localization, swapped).tracks
    assert len(set(joined.track_id[joined.ground_xy[:, 1] == 9.0])) == 2  # the fourth person


def test_nobody_crosses_the_square_in_a_frame():
    localization, detections, person = sequence(9, {3: (20, 20)}, looks=False)
    far = (person == 3) & (localization.tracks.frame > 20)
    moved = localization.tracks.ground_xy + 14 * far[:, None]
    jumped = eqx.tree_at(lambda result: result.tracks.ground_xy, localization, moved)
    joined = stitch_tracks(jumped, detections).tracks
    assert len(set(joined.track_id[np.isin(joined.ground_xy[:, 1], (9.0, 23.0))])) == 2


def test_overlapping_pieces_lose_the_overlap_of_the_earlier_one():
    localization, detections, person = sequence(9, {})
    tracks = localization.tracks
    again = (person == 2) & (tracks.frame >= 28) & (tracks.frame < 31)
    late = (person == 2) & (tracks.frame >= 28)
    names = np.where(late, 99, tracks.track_id)
    doubled = tracks[np.r_[np.arange(len(tracks)), np.flatnonzero(again)]]
    names = np.r_[names, tracks.track_id[again]]
    doubled = eqx.tree_at(lambda table: table.track_id, doubled, names)
    doubled = doubled[np.lexsort((doubled.track_id, doubled.frame))]
    localization = eqx.tree_at(lambda result: result.tracks, localization, doubled)
    joined = stitch_tracks(localization, detections).tracks
    assert len(joined) == len(tracks)
    rows = np.column_stack([joined.frame, joined.track_id])
    assert len(np.unique(rows, axis=0)) == len(rows)


def test_nothing_to_join():
    empty = empty_localization(CAMERAS)
    nobody = Detections([], [], np.zeros((0, 4)))
    assert content_hash(stitch_tracks(empty, nobody)) == content_hash(empty)


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_squared_displacement_of_a_straight_walk(speed):
    frame = np.arange(30)
    xy = np.column_stack([speed * frame, np.zeros(30)])
    tracks = Tracks(
        frame=frame,
        track_id=np.zeros(30, int),
        position=np.pad(xy, ((0, 0), (0, 1))),
        ground_xy=xy,
        sigma=np.full(30, 0.01),
        covariance=np.tile(np.eye(2) * 1e-4, (30, 1, 1)),
        supporting_cameras=np.full(30, 2),
        origin=np.zeros(30, int),
    )
    nobody = Detections([], [], np.zeros((0, 4)))
    _, habits = learn_fragments(tracks, nobody, np.zeros(0, int))
    spread = displacement_variance(habits)
    lag = np.arange(1, len(spread))
    expected = np.maximum((speed * lag) ** 2 / 2, 1e-4)
    np.testing.assert_allclose(spread[1:], expected, rtol=1e-6)


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2)), unique=True, max_size=20))
def test_displacements_are_those_of_all_pairs_of_one_identity(drawn):
    # Sparse frames: some lags exceed the number of rows, and are left out.
    frame, identity = np.array(sorted(drawn), int).reshape(-1, 2).T
    rows = len(frame)
    xy = np.random.default_rng(rows).normal(size=(rows, 2))
    tracks = Tracks(
        frame=5 * frame,
        track_id=identity,
        position=np.pad(xy, ((0, 0), (0, 1))),
        ground_xy=xy,
        sigma=np.ones(rows),
        covariance=np.tile(np.eye(2), (rows, 1, 1)),
        supporting_cameras=np.full(rows, 2),
        origin=np.zeros(rows, int),
    )
    square, pairs = np.zeros(rows + 2), np.zeros(rows + 2)
    for i, j in combinations(range(rows), 2):
        lag = 5 * abs(frame[j] - frame[i])
        if identity[i] == identity[j] and lag < rows + 2:
            square[lag] += ((xy[j] - xy[i]) ** 2).mean()
            pairs[lag] += 1
    found = squared_displacement(tracks)
    np.testing.assert_allclose(found[0], square, atol=1e-12)
    np.testing.assert_array_equal(found[1], pairs)


@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), unique=True, min_size=1, max_size=20),
    st.integers(0, 100),
)
def test_best_assignment_is_that_of_the_whole_table(pairs_of_indices, seed):
    one, two = np.array(pairs_of_indices).T
    gain = np.random.default_rng(seed).uniform(0.1, 1, len(one))
    before, after = best_assignment(one, two, gain, 6)
    table = np.zeros((6, 6))
    table[one, two] = gain
    best = table[linear_sum_assignment(-table)].sum()
    assert len(set(before)) == len(set(after)) == len(before)
    assert (table[before, after] > 0).all()
    np.testing.assert_allclose(table[before, after].sum(), best)


def test_habits_of_one_part_are_its_own_and_those_of_more_lie_between():
    localization, detections, _ = sequence(9, {1: (20, 24)})
    tracks = localization.tracks
    fragments, whole = learn_fragments(tracks, detections, localization.identity)
    twice = add_habits([whole, whole])
    np.testing.assert_allclose(displacement_variance(twice), displacement_variance(whole))
    np.testing.assert_array_equal(
        link_fragments(fragments, twice), link_fragments(fragments, whole)
    )
