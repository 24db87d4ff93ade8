"""Evidence of cameras and people for one plane: the floor passes, every other plane fails."""

import re

import numpy as np
import pytest

from catfree.calibration.reconstructions._ground_evidence import (
    FEWEST_DETECTIONS,
    judge_plane,
    people_of,
    way_up,
)
from catfree.synthetic import RigError, World, make_world
from catfree.types import Plane


@pytest.fixture(scope="module")
def world() -> World:
    """Simulate people in front of six cameras 4.5 to 5 m high."""
    return make_world("ring6", 0, frames=6, rig_error=RigError(0.0, 0.0, 0.0, 0.0, 0.0))


def verdict(world: World, plane: Plane, *, with_people: bool = True):
    rig = world.true_rig
    people = people_of(rig, world.detections) if with_people else None
    return judge_plane(plane, 0.5, np.asarray(rig.centers), people, way_up(rig, people))


@pytest.mark.parametrize("with_people", [True, False])
def test_the_floor_passes(world, with_people):
    found = verdict(world, Plane([0.0, 0, 1], 0.0), with_people=with_people)
    assert found.fault is None
    assert found.cameras_above == 1
    assert np.isnan(found.feet_apart) != with_people


def test_a_table_leaves_the_feet_of_two_cameras_apart(world):
    floor, table = (verdict(world, Plane([0.0, 0, 1], -height)) for height in (0.0, 0.8))
    assert floor.feet_apart < table.feet_apart


@pytest.mark.parametrize(
    ("normal", "offset", "fault"),
    [
        ((0.0, 0, 1), -8.0, "0 % of the cameras"),
        ((0.0, 0, -1), 8.0, "a ceiling, its normal is 1[78]. degrees from the people's upright"),
        ((1.0, 0, 0), 30.0, "a wall, its normal is [89]. degrees from the people's upright"),
    ],
)
def test_each_other_plane_has_its_fault(world, normal, offset, fault):
    assert re.search(fault, verdict(world, Plane(list(normal), offset)).fault)


def test_people_stand_up_and_so_do_cameras(world):
    rig = world.true_rig
    for people in (people_of(rig, world.detections), None):
        assert np.degrees(np.arccos(way_up(rig, people)[2])) < 5


def test_few_people_say_nothing(world):
    assert people_of(world.true_rig, None) is None
    assert people_of(world.true_rig, world.detections[: FEWEST_DETECTIONS - 1]) is None
