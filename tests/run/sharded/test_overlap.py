"""Tracks of one person in two shards are matched, whatever their numbers."""

import numpy as np
from hypothesis import given, strategies as st

from catfree._run.sharded._overlap import GATE, match_tracks
from catfree.types import Origin, Tracks

SIGMA = 0.1


def positions(rows):
    rows = np.asarray(rows, float).reshape(-1, 4)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    count = len(rows)
    return Tracks(
        frame=rows[:, 0].astype(int),
        track_id=rows[:, 1].astype(int),
        position=np.zeros((count, 3)),
        ground_xy=rows[:, 2:],
        sigma=np.full(count, SIGMA),
        covariance=np.tile(SIGMA**2 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.zeros(count, int),
        origin=np.full(count, int(Origin.DETECTED)),
    )


@given(st.integers(1, 6), st.integers(1, 20), st.randoms(use_true_random=False))
def test_people_apart_are_matched(people, frames, random):
    names = random.sample(range(100), people)
    rng = np.random.default_rng(people)
    place = np.stack([3.0 * np.arange(people), np.zeros(people)], -1)
    one, two = [], []
    for frame in range(frames):
        for person in range(people):
            one.append([frame, person, *(place[person] + rng.normal(0, SIGMA / 3, 2))])
            two.append([frame, names[person], *(place[person] + rng.normal(0, SIGMA / 3, 2))])
    before, after = match_tracks(positions(one), positions(two))
    assert dict(zip(before.tolist(), after.tolist(), strict=True)) == dict(enumerate(names))
    back = match_tracks(positions(two), positions(one))
    assert set(zip(before, after, strict=True)) == set(zip(*back[::-1], strict=True))


@given(st.floats(0, 3))
def test_the_gate_is_a_mahalanobis_distance(distance):
    before, _ = match_tracks(positions([[0, 1, 0, 0]]), positions([[0, 2, distance, 0]]))
    assert (len(before) == 1) == (distance**2 / (2 * SIGMA**2) < GATE)


def test_the_longer_company_wins():
    walk = [[frame, 0, 0, 0] for frame in range(10)]
    company = [[frame, 5, 0.05, 0] for frame in range(10)] + [[0, 6, 0, 0]]
    before, after = match_tracks(positions(walk), positions(company))
    assert (before.tolist(), after.tolist()) == ([0], [5])


def test_no_common_frame_no_match():
    empty = positions([])
    for one, two in ((empty, empty), (positions([[0, 1, 0, 0]]), positions([[1, 1, 0, 0]]))):
        assert [len(side) for side in match_tracks(one, two)] == [0, 0]
