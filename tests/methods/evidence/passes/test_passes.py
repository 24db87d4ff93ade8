"""Each pass maps a complete state to a complete state, and changes only its own decisions."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest

from catfree.errors import InsufficientDataError
from catfree.methods.evidence import solve
from catfree.methods.evidence.learn._self_calibration import self_calibrate
from catfree.methods.evidence.passes._add_pose_errors import add_pose_errors
from catfree.methods.evidence.passes._choose_reported import choose_reported
from catfree.methods.evidence.passes._follow_people import follow_people
from catfree.methods.evidence.passes._group_boxes import expected_people, group_boxes
from catfree.methods.evidence.passes._learn_looks import learn_looks
from catfree.methods.evidence.passes._name_people import name_people
from catfree.methods.evidence.passes._observe_boxes import observe_boxes
from catfree.methods.evidence.passes._weigh_groups import weigh_groups
from catfree.settings import EvidenceSettings
from catfree.types import Fate
from tests.methods.evidence.evidence_worlds import make_rig, make_scene, walk

RULES = EvidenceSettings()
ROUND = (group_boxes, weigh_groups, follow_people)
ALL = (learn_looks, *ROUND * RULES.passes, choose_reported, name_people, add_pose_errors)
PEOPLE, FRAMES = 6, 12
OBSERVED = {"boxes", "views", "noise", "measurements", "ratios"}
CHANGED = {
    learn_looks: {"ratios"},
    group_boxes: {
        *("groups", "place", "existence", "trails", "evidence", "probability"),
        # For the rows of tracks that are dropped:
        *("position_covariance", "coverage", "fate", "identity"),
    },
    weigh_groups: {"rate", "existence"},
    choose_reported: {"position_covariance", "coverage", "fate", "identity"},
    name_people: {"identity"},
    add_pose_errors: {"position_covariance"},
}

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("x64")]


def _observed(detections, scene):
    return observe_boxes(detections, scene, *self_calibrate(detections, scene, RULES), RULES)


@cache
def states():
    """Return the state before and after each pass."""
    _, detections, scene = walk(PEOPLE, FRAMES)
    found = [_observed(detections, scene)]
    for run in ALL:
        found.append(run(found[-1], RULES))
    return found


def differs(one, two):
    if one is two:
        return False
    first, second = jax.tree.leaves(one), jax.tree.leaves(two)
    return len(first) != len(second) or any(
        np.shape(a) != np.shape(b) or not np.array_equal(a, b, equal_nan=True)
        for a, b in zip(first, second, strict=True)
    )


def test_solve_runs_the_passes_in_their_order():
    _, detections, scene = walk(PEOPLE, FRAMES)
    assert not differs(solve(detections, scene), states()[-1])


def test_an_unfinished_solve_ends_with_what_is_reported():
    _, detections, scene = walk(PEOPLE, FRAMES)
    chosen = states()[ALL.index(choose_reported) + 1]
    assert not differs(solve(detections, scene, finish=False), chosen)


def test_each_pass_changes_what_it_decides_and_nothing_else():
    for run, before, after in zip(ALL, states(), states()[1:], strict=False):
        names = {f.name for f in dataclasses.fields(before)}
        changed = {n for n in names if differs(getattr(before, n), getattr(after, n))}
        assert changed <= CHANGED.get(run, names - OBSERVED), run


def test_a_pass_run_twice_changes_nothing_more():
    state = states()[1 + len(ROUND) * RULES.passes]
    for run in (choose_reported, name_people):
        state = run(state, RULES)
        assert not differs(run(state, RULES), state), run


def test_new_groups_have_no_evidence_and_no_tracks_and_new_tracks_are_not_reported():
    grouped, followed = states()[2], states()[4]
    assert len(grouped.groups) >= PEOPLE
    assert len(grouped.existence.log_odds) == len(grouped.place) == len(grouped.groups)
    assert (grouped.existence.log_odds == 0).all()
    assert len(grouped.trails) == 0
    assert len(followed.trails) >= PEOPLE * FRAMES * 0.9
    assert not followed.kept.any()
    assert (followed.identity == -1).all()


def test_people_are_expected_once_there_are_tracks_and_the_tracks_are_forgotten():
    learned, followed, grouped = states()[1], *states()[4:6]
    assert len(expected_people(learned, RULES).frame) == 0
    expected = expected_people(followed, RULES)
    assert len(followed.trails) >= len(expected.frame) >= PEOPLE * FRAMES * 0.9
    assert len(grouped.trails) == 0


def test_everybody_who_walked_is_reported_and_has_one_identity():
    last = states()[-1]
    kept = last.kept
    assert kept.sum() == PEOPLE * FRAMES
    assert set(last.identity[kept]) == set(range(PEOPLE))
    assert (last.identity[~kept] == -1).all()
    assert set(last.fate[last.probability <= 0.5]) <= {Fate.TRACKING}


def test_errors_of_poses_widen_ellipses_and_never_narrow_them():
    before, after = states()[-2:]
    added = after.position_covariance[after.kept] - before.position_covariance[after.kept]
    assert np.linalg.eigvalsh(added).min() > -1e-12
    alone = add_pose_errors(before, dataclasses.replace(RULES, pose_errors=False))
    assert not differs(alone, before)


def test_a_single_instant_has_groups_that_are_judged_on_their_own():
    _, detections, scene = walk(PEOPLE, FRAMES)
    state = _observed(detections[detections.frame == 0], scene)
    for run in ROUND:
        state = run(state, RULES)
    assert len(state.trails) == len(state.groups)
    np.testing.assert_array_equal(state.evidence, state.existence.log_odds)
    named = name_people(choose_reported(state, RULES), RULES)
    assert named.kept.sum() == PEOPLE
    assert len(set(named.identity[named.kept])) == PEOPLE


def test_without_passes_of_tracking_every_group_is_judged_on_its_own():
    _, detections, scene = walk(PEOPLE, FRAMES)
    none = solve(detections, scene, EvidenceSettings(passes=0))
    assert not differs(none, solve(detections, scene, EvidenceSettings(track=False)))
    assert none.kept.sum() == PEOPLE * FRAMES


def test_boxes_of_nobody_on_the_ground_are_refused():
    _, detections, _ = walk(PEOPLE, 2)
    none = detections[detections.camera < 0]
    with pytest.raises(InsufficientDataError, match="whole person"):
        solve(none, make_scene(make_rig()))
