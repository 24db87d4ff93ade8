"""The order of camera pairs, and the placement of a pair."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.cameras._camera_model import (
    PAN,
    of_rig,
    scene_of,
    usual_focal,
)
from catfree.calibration.people.matching._workspace import Workspace, prepare
from catfree.calibration.people.search._camera_pairs import rank_pairs, search_pair
from catfree.settings import CalibrationSettings
from catfree.synthetic import make_world

SETTINGS = CalibrationSettings()
WORLD = make_world("ring4", seed=3, frames=60, people=7)
SIZE = np.asarray(WORLD.true_scene.rig.image_size)


def workspace(detections) -> Workspace:
    lenses = RadialLenses(usual_focal(SIZE, SETTINGS), np.zeros(len(SIZE)))
    return prepare(detections, SIZE, SETTINGS, None, lenses)


@pytest.fixture(scope="module")
def two_times() -> Workspace:
    """Cameras 2 and 3 show other instants than cameras 0 and 1."""
    boxes = WORLD.detections
    late = np.where(boxes.camera >= 2, 30, 0)
    return workspace(replace(boxes, frame=(boxes.frame + late) % 60))


def test_cameras_that_see_the_same_people_come_first(two_times):
    said = []
    couples = rank_pairs(two_times, lambda *state: said.append(state))
    assert set(couples[:2]) == {(0, 1), (2, 3)}
    assert sorted(couples) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert said == [("pairs", done, 6) for done in range(1, 7)]


def test_a_pair_is_placed_near_its_true_place(two_times):
    state = search_pair(two_times, 2, 3)
    assert state is not None
    assert state.placed.tolist() == [False, False, True, True]
    found = np.asarray(scene_of(state.parameters, SIZE, np.zeros(4)).rig.centers)[2:]
    true = np.asarray(WORLD.true_scene.rig.centers)[2:]
    apart = [np.linalg.norm(np.diff(centers, axis=0)) for centers in (found, true)]
    assert apart[0] == pytest.approx(apart[1], rel=0.15)
    heading = of_rig(WORLD.true_scene.rig)[2:, PAN]
    assert np.cos(np.diff(state.parameters[2:, PAN]) - np.diff(heading)) > np.cos(0.2)


def test_cameras_without_boxes_are_ranked_last():
    boxes = WORLD.detections
    couples = rank_pairs(workspace(boxes[boxes.camera != 1]), lambda *_: None)
    assert all(1 in couple for couple in couples[-3:])
