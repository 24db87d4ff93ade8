from dataclasses import replace

import numpy as np
import pytest

from catfree.methods.evidence import EvidenceSettings, solve
from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._views import ground_views
from catfree.methods.evidence.report._sharp_positions import sharp_positions
from catfree.methods.evidence.report._uneven_ground import ground_shift, usual_shift
from catfree.methods.evidence.track._tracking import Trails
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import (
    HEIGHT,
    make_rig,
    make_scene,
    state_of_boxes,
    walk,
)

RULES = EvidenceSettings()


def shift_seen_by(cameras, rig, unit=HEIGHT, rules=RULES):
    """Compute the shift of one person at (1, 0.5) meters seen by these cameras of a rig."""
    scene, C = make_scene(rig), rig.camera_count
    state = state_of_boxes(scene, np.array(cameras), 3, unit, rules)
    member = np.full((1, C), -1)
    member[0, cameras] = np.arange(len(cameras))
    xy = (np.array([1.0, 0.5]) @ np.asarray(scene.ground.basis)[:2] - state.views.origin) / unit
    trails = Trails(
        np.zeros(1, int), np.zeros(1, int), np.zeros(1, int), np.array([[*xy, 1.0, 0, 0]]),
        np.eye(5)[None],
    )  # fmt: skip
    empty = Information(np.zeros((1, 3, 3)), np.zeros((1, 3)), np.zeros(1))
    groups = Groups(np.zeros(1, int), member, empty, np.zeros(1))
    return ground_shift(trails, replace(state, groups=groups), rules)[0], xy


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_one_camera_moves_a_raised_person_away_by_distance_over_height():
    rig = make_rig()
    shift, xy = shift_seen_by([0], rig)
    views = ground_views(make_scene(rig), HEIGHT)
    away = xy - views.station[0]
    # Raised by z, the visible foot, which is nearer than the body, moves away by z / camera height,
    # and the head by z / (camera height - H).
    ratio = shift @ away / (away @ away)
    nearer = 1 - FOOT_AHEAD / np.linalg.norm(away)
    assert nearer * HEIGHT / 3.0 < ratio < HEIGHT / (3.0 - HEIGHT)
    assert ratio * np.linalg.norm(away) == pytest.approx(np.linalg.norm(shift), rel=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_cameras_all_around_cancel_what_cameras_on_one_side_share():
    rig = make_rig(count=8)
    one_side, _ = shift_seen_by([0, 1], rig)
    around, _ = shift_seen_by([0, 2, 4, 6], rig)
    assert np.linalg.norm(around) < 0.3 * np.linalg.norm(one_side)


def test_uneven_ground_widens_along_the_shift_only():
    rules = EvidenceSettings(sway=0.0, unevenness=0.05)
    widened, _ = sharp_positions(np.eye(5)[None] * 0.01, np.array([[2.0, 0.0]]), np.ones(1), rules)
    np.testing.assert_allclose(widened[0], [[0.02, 0], [0, 0.01]])


def test_on_even_ground_nobody_is_shifted():
    rules = EvidenceSettings(uneven_ground=False)
    shift, _ = shift_seen_by([0, 1], make_rig(), rules=rules)
    np.testing.assert_array_equal(shift, [0, 0])


@pytest.mark.slow
def test_reported_positions_are_as_sure_as_the_settings_ask():
    _, detections, scene = walk(seed=14, frames=6)
    solution = solve(detections, scene)
    sigma = np.sqrt(np.linalg.eigvalsh(solution.position_covariance[solution.kept]).max(1))
    assert solution.kept.any()
    assert (sigma < EvidenceSettings().report_radius).all()


def test_the_usual_shift_is_the_median_of_where_the_track_is_seen():
    """Make two tracks; in the first, one instant is a chance match and one is a gap."""
    track, group = np.array([0, 0, 0, 0, 0, 1]), np.array([0, 1, 2, -1, 3, 4])
    frame = np.array([0, 1, 2, 3, 4, 0])
    trails = Trails(track, frame, group, np.zeros((6, 5)), np.zeros((6, 5, 5)))
    shift = np.array([[1, 0], [0, 2.0], [9, 9], [0, 0], [-1.5, 0], [7, 0]])
    usual = usual_shift(trails, shift, reach=4)
    np.testing.assert_array_equal(usual, [[-1.5, 0]] * 5 + [[7, 0]])
    alone = usual_shift(trails, shift, reach=0)
    np.testing.assert_array_equal(alone[group >= 0], shift[group >= 0])
