import numpy as np
from evidence_worlds import walk
from hypothesis import given, settings, strategies as st

from catfree.evidence import EvidenceSettings, describe, solve
from catfree.evidence.exclusion import alone_in_place
from catfree.evidence.tracking import Trails
from catfree.types import Fate

RADIUS = 0.15


def trails(track, frame, xy):
    track, frame = np.asarray(track, int), np.asarray(frame, int)
    n = len(track)
    mean = np.column_stack([np.reshape(xy, (n, 2)), np.ones(n), np.zeros((n, 2))])
    return Trails(track, frame, np.arange(n), mean, np.tile(np.eye(5), (n, 1, 1)))


@st.composite
def crowds(draw):
    """Tracks that stand still close to one another, with the evidence of each of their rows."""
    people, frames = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    place = st.tuples(st.floats(0, 0.6), st.floats(0, 0.6))
    xy = np.array(draw(st.lists(place, min_size=people, max_size=people)))
    evidence = draw(
        st.lists(
            st.floats(0.5, 9), min_size=people, max_size=people, unique_by=lambda e: round(e, 3)
        )
    )
    here = draw(st.lists(st.booleans(), min_size=people * frames, max_size=people * frames))
    rows = trails(np.repeat(np.arange(people), frames), np.tile(np.arange(frames), people),
                  np.repeat(xy, frames, axis=0))  # fmt: skip
    return rows, np.repeat(evidence, frames), np.array(here)


@settings(max_examples=60, deadline=None)
@given(crowds())
def test_nobody_stays_beside_a_better_supported_one_and_nobody_goes_without_one(crowd):
    rows, evidence, here = crowd
    alone = alone_in_place(rows, evidence, here, RADIUS)
    assert not (alone & ~here).any()
    support = np.bincount(rows.track, np.where(here, evidence, 0))[rows.track]
    apart = np.linalg.norm(rows.mean[:, None, :2] - rows.mean[None, :, :2], axis=-1)
    together = rows.frame[:, None] == rows.frame[None, :]
    np.fill_diagonal(together, False)
    clearly_in_reach = together & (apart < RADIUS - 1e-6)
    in_reach = together & (apart < RADIUS + 1e-6)
    assert not (clearly_in_reach & alone[:, None] & alone[None, :]).any()
    for row in np.flatnonzero(here & ~alone):
        assert (in_reach[row] & alone & (support > support[row] - 1e-6)).any()


@settings(max_examples=30, deadline=None)
@given(crowds(), st.randoms(use_true_random=False))
def test_the_order_of_the_rows_says_nothing(crowd, random):
    rows, evidence, here = crowd
    order = np.arange(len(rows))
    random.shuffle(order)
    mixed = alone_in_place(rows[order], evidence[order], here[order], RADIUS)
    support = np.bincount(rows.track, np.where(here, evidence, 0))
    if len(np.unique(support)) == len(support):
        np.testing.assert_array_equal(mixed, alone_in_place(rows, evidence, here, RADIUS)[order])


def test_a_long_track_outlives_a_short_one_that_is_surer_for_a_moment():
    rows = trails([0, 0, 0, 1], [0, 1, 2, 1], [[0, 0]] * 3 + [[0.1, 0]])
    found = alone_in_place(rows, np.array([3.0, 3.0, 3.0, 6.0]), np.ones(4, bool), RADIUS)
    np.testing.assert_array_equal(found, [True, True, True, False])


def test_arms_length_is_far_enough_and_so_is_another_moment():
    rows = trails([0, 1, 2], [0, 0, 1], [[0, 0], [0.3, 0], [0, 0]])
    assert alone_in_place(rows, np.ones(3), np.ones(3, bool), RADIUS).all()


def test_nobody_is_alone_where_nobody_is():
    assert alone_in_place(trails([], [], []), np.zeros(0), np.zeros(0, bool), RADIUS).shape == (0,)


def test_what_is_reported_never_stands_in_one_place():
    _, detections, scene = walk(people=8, frames=10, seed=3, noise=0.03)
    for space in (EvidenceSettings().personal_space, 0.9):
        rules = EvidenceSettings(personal_space=space)
        solution = solve(detections, scene, rules)
        rows = solution.trails[solution.kept]
        apart = np.linalg.norm(rows.mean[:, None, :2] - rows.mean[None, :, :2], axis=-1)
        apart[(rows.frame[:, None] != rows.frame) | np.eye(len(rows), dtype=bool)] = np.inf
        assert apart.min() >= space - 1e-6
        suppressed = solution.trails.group[
            (solution.probability > 0.5) & ~solution.alone & (solution.trails.group >= 0)
        ]
        fates = describe(solution, scene, rules).candidates.fate
        assert set(np.flatnonzero(fates == Fate.SUPPRESSED)) == set(suppressed)
    assert len(suppressed) > 0
