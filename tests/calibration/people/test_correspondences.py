"""Bundle adjustment of given groups: exact boxes keep the rig, and missing edges have no effect."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people import AnchorCheck
from catfree.calibration.people._correspondences import refine_with_correspondences
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    adjust_people_bundle,
    weak_prior,
)
from catfree.errors import InvalidInputError
from catfree.settings import CalibrationSettings
from catfree.synthetic import make_layout
from catfree.types import Detections
from tests.calibration.people.boxes_of_rows import boxes_of_rows
from tests.known_calibration import calibration_of

SETTINGS = CalibrationSettings()
PEOPLE = 80


def cameras() -> np.ndarray:
    """Return (4, 7) log focal, tilt, roll, heading and position of cameras around a square."""
    angle = np.arange(4) * np.pi / 2
    place = np.stack([9 * np.cos(angle), 9 * np.sin(angle), np.full(4, 4.0)], -1)
    focal, tilt, roll = np.full(4, np.log(1100.0)), np.full(4, 0.4), np.zeros(4)
    return np.column_stack([focal, tilt, roll, angle + np.pi / 2, place])


def measured(rng: np.random.Generator) -> tuple[BoxMeasurements, np.ndarray]:
    """Make exact boxes of people of usual height whom all cameras see; also return the cameras."""
    parameters = cameras()
    person, camera = np.repeat(np.arange(PEOPLE), 4), np.tile(np.arange(4), PEOPLE)
    xy = rng.uniform(-3, 3, (PEOPLE, 2))
    height = np.full(PEOPLE, SETTINGS.apparent_height)
    box = boxes_of_rows(parameters[camera], xy[person], height[person], SETTINGS.foot_offset)
    return BoxMeasurements(person, camera, box, np.full(box.shape, 3.0)), parameters


def adjusted(measurements: BoxMeasurements, parameters: np.ndarray) -> np.ndarray:
    found = adjust_people_bundle(
        measurements,
        parameters,
        None,
        weak_prior(measurements.camera, parameters, parameters[:, 0], SETTINGS),
        SETTINGS,
        focal_spread=np.inf,
        iterations=20,
    )
    assert np.isfinite(found.covariance).all()
    return found.parameters


@pytest.mark.slow
def test_exact_boxes_keep_the_rig():
    boxes, parameters = measured(np.random.default_rng(0))
    np.testing.assert_allclose(adjusted(boxes, parameters), parameters, atol=1e-3)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([np.nan, np.inf]), st.floats(-300, 300))
def test_an_edge_without_a_deviation_says_nothing_however_wrong(seed, silent, error):
    rng = np.random.default_rng(seed)
    boxes, parameters = measured(rng)
    edge = rng.random(len(boxes.box)) < 0.15
    boxes.sd[edge, 2] = silent
    boxes.box[edge, 2] += error
    np.testing.assert_allclose(adjusted(boxes, parameters), parameters, atol=5e-3)


def test_a_rig_that_is_off_comes_back():
    rng = np.random.default_rng(1)
    boxes, parameters = measured(rng)
    off = parameters.copy()
    off[:, 4:] += rng.normal(scale=0.1, size=(4, 3))
    found = adjusted(boxes, off)
    apart = lambda p: np.linalg.norm(p[:, None, 4:] - p[None, :, 4:], axis=-1)  # noqa: E731
    error = np.abs(apart(found) - apart(parameters)).max()
    assert error < 0.2 * np.abs(apart(off) - apart(parameters)).max()


RIG = calibration_of(make_layout("ring4", 0).scene)
GROUPS = np.arange(4 * 30).reshape(30, 4)
BOX = [800.0, 400.0, 840.0, 500.0]
BOXES = Detections(np.repeat(np.arange(30), 4), np.tile(np.arange(4), 30), np.tile(BOX, (120, 1)))


def test_a_rig_that_anchors_hold_is_not_refined():
    check = AnchorCheck(None, "people", (0.0,), (0.1,), 1.0, True, "As expected.")
    with pytest.raises(InvalidInputError, match="was fitted to anchors"):
        refine_with_correspondences(replace(RIG, anchors=(check,)), BOXES, GROUPS)


@pytest.mark.parametrize(
    ("members", "box_sd", "sentence"),
    [
        (GROUPS[:, :3], None, r"members must have shape \(n, 4\)"),
        (GROUPS[0], None, "members must have shape"),
        (GROUPS + 0.5, None, r"members\[0, 0\] is 0.5; it must be a whole number"),
        (GROUPS, np.ones(120), r"box_sd must have shape \(120, 3\)"),
        (GROUPS, np.ones((119, 3)), "box_sd must have shape"),
    ],
)
def test_groups_and_deviations_of_another_form_are_refused(members, box_sd, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        refine_with_correspondences(RIG, BOXES, members, box_sd=box_sd)
