"""Videos or camera names in the wrong order."""

from dataclasses import replace

import numpy as np
import pytest

import catfree as cf
from catfree.calibration import Verdict, check
from catfree.calibration.watching._sights import sights
from catfree.calibration.watching._swapped import swapped_cameras
from catfree.errors import InvalidInputError
from catfree.settings import Settings
from catfree.synthetic import make_world

CAMERAS, FRAMES = 6, 40


@pytest.fixture(scope="module")
def world():
    return make_world("gmvd6", seed=23, frames=FRAMES, people=12)


@pytest.fixture(scope="module")
def localization(world):
    return cf.localize(world.detections, world.true_scene)


@pytest.mark.slow
@pytest.mark.parametrize("cycle", [(0, 4), (2, 5), (1, 3, 4)])
def test_each_camera_gets_the_boxes_that_are_its_own(world, localization, cycle):
    """Keep the people of the correct cameras, and swap only the cameras of the boxes."""
    given = np.arange(CAMERAS)
    given[list(cycle)] = np.roll(cycle, 1)
    boxes = replace(world.detections, camera=given[world.detections.camera])
    moved = np.argsort(given)  # people refer to boxes by their new cameras
    tracks = localization.tracks
    tracks = replace(tracks, support=tracks.support[:, moved])
    recording = sights(world.true_scene, boxes, replace(localization, tracks=tracks), Settings())
    matched = np.full(CAMERAS, 0.9)
    matched[list(cycle)] = 0.1
    found = swapped_cameras(recording, matched)
    assert found == {int(given[camera]): camera for camera in cycle}


@pytest.mark.slow
def test_nothing_is_swapped_where_boxes_fit_nowhere(world, localization):
    """Shuffled frames, one suspect, cameras that should show no people, too few trusted cameras."""
    boxes = world.detections
    order = np.random.default_rng(0).permutation(FRAMES)
    elsewhere = np.isin(boxes.camera, [1, 2])
    shuffled = replace(boxes, frame=np.where(elsewhere, order[boxes.frame], boxes.frame))
    matched = np.array([0.9, 0.1, 0.1, 0.9, 0.9, 0.9])
    recording = sights(world.true_scene, shuffled, localization, Settings())
    assert swapped_cameras(recording, matched) == {}
    recording = sights(world.true_scene, boxes, localization, Settings())
    assert swapped_cameras(recording, np.array([0.9, 0.1, 0.9, 0.9, 0.9, 0.9])) == {}
    assert swapped_cameras(recording, np.full(CAMERAS, np.nan)) == {}
    assert swapped_cameras(recording, np.array([0.9, 0.1, 0.1, 0.1, 0.1, 0.1])) == {}


@pytest.mark.slow
def test_a_check_says_whose_boxes_were_swapped(world):
    given = np.array([4, 1, 2, 3, 0, 5])
    boxes = replace(world.detections, camera=given[world.detections.camera])
    result = check(world.true_scene, boxes, camera_names=["a", "b", "c", "d", "door", "f"])
    assert {one.camera: one.swapped_with for one in result.cameras if one.swapped_with} == {0: 4}
    assert result.cameras[4].swapped_with == 0
    assert result.verdicts[0] == result.verdicts[4] == Verdict.MOVED
    assert "fit the place of camera 'door'" in result.cameras[0].advice
    assert result.cameras[0].since is None
    straight = check(world.true_scene, world.detections)
    assert all(one.swapped_with is None for one in straight.cameras)


def test_names_of_other_cameras_are_refused_before_any_work(world):
    with pytest.raises(InvalidInputError, match="camera_names has 2 names, but there are 6"):
        check(world.true_scene, world.detections, camera_names=["a", "b"])
