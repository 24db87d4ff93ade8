"""Verdicts on simulated recordings with an event at a known time."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import catfree as cf
from catfree.calibration import Verdict, check
from catfree.calibration.watching._check import require_since
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.synthetic import make_world
from tests.calibration.watching.bumped import on_clock, renumber, turn_camera

FRAMES, BUMP = 120, 65


@pytest.fixture(scope="module")
def world():
    return make_world("ring5", seed=1, frames=FRAMES, people=8)


@pytest.fixture(scope="module")
def quiet(world):
    return on_clock(world.detections, world.layout.fps)


@pytest.fixture(scope="module")
def turned(world, quiet):
    """Turn a camera by two degrees, and check the rig."""
    boxes = turn_camera(quiet, world.true_rig, 1, np.deg2rad([0, 2, 0]), BUMP)
    return boxes, check(world.true_scene, boxes)


def others_fit(result, camera):
    return all(one.verdict == Verdict.FITS for one in result.cameras if one.camera != camera)


@pytest.mark.slow
def test_a_rig_that_stood_still_fits(world, quiet):
    result = check(world.true_scene, quiet)
    assert result.fits
    assert all(one.since is None for one in result.cameras)
    assert all(one.matched > 0.8 for one in result.cameras)
    assert str(result).count("fits") == 5


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.5, 1.0, 5.0])
def test_a_turned_camera_is_found_with_angle_and_time(world, quiet, degrees):
    turn = np.deg2rad(degrees) * np.array([0.6, 0.8, 0.0])
    boxes = turn_camera(quiet, world.true_rig, 1, turn, BUMP)
    result = check(world.true_scene, boxes)
    found = result.cameras[1]
    assert found.verdict == Verdict.MOVED
    assert others_fit(result, 1)
    assert abs(found.degrees - degrees) < 3 * found.degrees_sd
    off = found.turn - turn
    assert off @ np.linalg.solve(found.turn_covariance, off) < 16.3  # 99.9 % of chi-square, 3
    assert found.since is not None
    assert found.since_sd is not None
    assert abs(found.since - BUMP) <= max(3, 3 * found.since_sd)
    focal = float(np.asarray(world.true_rig.K)[1, 0, 0])
    assert found.pixels == pytest.approx(focal * np.deg2rad(degrees), rel=0.3)
    assert f"since frame {found.since}" in found.advice


@pytest.mark.slow
@pytest.mark.parametrize("scale", [3.0, 1e5])
def test_a_similarity_of_the_scene_changes_no_verdict(world, turned, scale):
    boxes, one = turned
    similarity = cf.geometry.Similarity(
        scale,
        np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        np.array([4.0, 5.0, 6.0]),
    )
    moved = cf.geometry.transform_scene(similarity, world.true_scene, metric=False)
    other = check(moved, boxes)
    assert one.verdicts == other.verdicts
    for a, b in zip(one.cameras, other.cameras, strict=True):
        assert a.degrees == pytest.approx(b.degrees, abs=1e-3)
        assert b.ground == pytest.approx(scale * a.ground, rel=0.02, abs=1e-3)


@pytest.mark.slow
def test_a_dead_camera_and_a_late_one(world, quiet):
    off = (quiet.camera == 2) & (quiet.frame >= 80)
    boxes = renumber(quiet[~off], 3, lambda frame: 3.0 + 0 * frame)
    result = check(world.true_scene, boxes)
    assert result.cameras[2].verdict == Verdict.DEAD
    assert result.cameras[2].since is not None
    assert abs(result.cameras[2].since - 80) <= 2 * result.window * world.layout.fps
    late = result.cameras[3]
    assert late.verdict == Verdict.LATE
    assert abs(late.lag - 3) < 3 * late.lag_sd
    assert [result.cameras[c].verdict for c in (0, 1, 4)] == [Verdict.FITS] * 3


@pytest.mark.slow
def test_a_camera_without_a_single_box_is_told_so(world, quiet):
    few = quiet[(quiet.camera != 2) & (quiet.frame < FRAMES // 3)]
    silent = check(world.true_scene, few).cameras[2]
    assert silent.verdict == Verdict.DOUBTFUL
    assert silent.matched == 0
    assert silent.advice.startswith("It has no boxes of people seen by the others.")


@pytest.mark.slow
def test_errors_before_a_trusted_frame_do_not_count(world, quiet):
    turned = turn_camera(quiet, world.true_rig, 0, np.deg2rad([0, 2.5, 0]), 0)
    assert check(world.true_scene, turned).cameras[0].verdict == Verdict.MOVED
    assert check(world.true_scene, turned, since=60).cameras[0].verdict == Verdict.FITS


@pytest.mark.slow
def test_a_recording_without_boxes_is_refused(world):
    nobody = cf.Detections([], [], np.zeros((0, 4)))
    with pytest.raises(InsufficientDataError, match="boxes"):
        check(world.true_scene, nobody)
    boxes = world.detections
    unsure = cf.Detections(boxes.frame, boxes.camera, boxes.box, np.full(len(boxes), 0.01))
    with pytest.raises(InsufficientDataError, match="confident boxes"):
        check(world.true_scene, unsure)


@pytest.mark.slow
def test_pictures_that_do_not_exist_count_as_for_localize(world, quiet):
    scene = world.true_scene
    gone = (quiet.camera == 2) & (quiet.frame >= FRAMES // 2)
    silent = [[frame, 2] for frame in range(FRAMES // 2, FRAMES)]
    told = check(scene, quiet[~gone], silent=silent)
    known = check(scene, quiet[~gone], localization=cf.localize(quiet[~gone], scene, silent=silent))
    assert str(told) == str(known)
    assert [c.pixels for c in told.cameras] == [c.pixels for c in known.cameras]
    assert told.cameras[2].verdict == Verdict.DEAD


@pytest.mark.parametrize("judge", [check, cf.estimate_clocks])
def test_a_box_in_a_picture_that_does_not_exist_is_refused(world, quiet, judge):
    with pytest.raises(InvalidInputError, match="silent says that camera"):
        judge(world.true_scene, quiet, silent=[[quiet.frame[0], quiet.camera[0]]])


def test_a_negative_lag_to_look_for_is_refused(world, quiet):
    with pytest.raises(InvalidInputError, match="maximum_offset is -1"):
        check(world.true_scene, quiet, maximum_offset=-1)


def test_a_trusted_frame_needs_boxes_before_it_and_from_it_on(world, quiet):
    first, last = int(quiet.frame.min()), int(quiet.frame.max())
    for since in (first - 5, first, last + 1):
        refused = f"since is frame {since}, .* frames {first} to {last}: cameras are compared"
        with pytest.raises(InvalidInputError, match=refused):
            check(world.true_scene, quiet, since=since)
    for since in (first + 1, last):
        assert require_since(since, quiet) == since
    with pytest.raises(InsufficientDataError, match="boxes"):
        check(world.true_scene, cf.Detections([], [], np.zeros((0, 4))), since=1)


@pytest.fixture(scope="module")
def twice(quiet):
    """The boxes of a camera in place of those of another one."""
    kept, copy = quiet[quiet.camera != 3], quiet[quiet.camera == 0]
    columns = {
        name: np.concatenate([getattr(kept, name), getattr(copy, name)])
        for name in ("frame", "camera", "box")
    }
    columns["camera"][len(kept) :] = 3
    return cf.Detections(**columns)


def test_a_video_read_twice_is_refused_before_any_work(world, twice):
    with pytest.raises(InvalidInputError, match="Cameras 0 and 3 have the same"):
        check(world.true_scene, twice)
    for judge in (
        partial(check, world.true_scene, twice),
        partial(cf.calibrate, twice, (1920, 1080)),
    ):
        with pytest.raises(InvalidInputError, match="Cameras 'a' and 'd' have the same"):
            judge(camera_names=list("abcde"))


@pytest.mark.slow
def test_boxes_of_a_camera_that_is_not_registered_do_not_matter(world, twice):
    """A camera that is known to be wrong is left out in this way."""
    scene, size = world.true_scene, np.array([[1920, 1080]] * 5)
    size[3] = 320, 240
    registered = [True, True, True, False, True]
    partial_scene = replace(scene, rig=replace(scene.rig, registered=registered, image_size=size))
    others = twice[twice.camera != 3]
    assert str(check(partial_scene, twice)) == str(check(partial_scene, others))
    refined, expected = (cf.refine(boxes, partial_scene, rounds=1) for boxes in (twice, others))
    np.testing.assert_array_equal(refined.scene.rig.t, expected.scene.rig.t)


def test_boxes_without_frame_numbers_are_refused_before_any_work(world, quiet):
    repeats = 1001 // int((quiet.camera == 2).sum()) + 1
    rows = np.tile(np.flatnonzero(quiet.camera == 2), repeats)
    everything = cf.Detections(np.zeros(len(rows), int), quiet.camera[rows], quiet.box[rows])
    with pytest.raises(InvalidInputError, match=rf"Camera 2 has {len(rows)} boxes in frame 0"):
        check(world.true_scene, everything)
    with pytest.raises(InvalidInputError, match=rf"Camera 'c' has {len(rows)} boxes in frame 0"):
        cf.calibrate(everything, (1920, 1080), camera_names=list("abcde"))


@pytest.mark.slow
def test_a_camera_that_died_early_is_dead_since_then(world, quiet):
    died = FRAMES // 4
    result = check(world.true_scene, quiet[(quiet.camera != 2) | (quiet.frame < died)])
    assert result.cameras[2].verdict == Verdict.DEAD
    assert result.cameras[2].since == pytest.approx(died, abs=0.15 * FRAMES)
    assert others_fit(result, 2)
