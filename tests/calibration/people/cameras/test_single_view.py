"""The ground under one camera from its boxes alone, given the focal length."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people._box_grid import BoxGrid, grid_boxes
from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    PAN,
    ROLL,
    TILT,
    X,
    Z,
)
from catfree.calibration.people.cameras._single_view import FEWEST_BOXES, fit_planes
from catfree.settings import CalibrationSettings
from catfree.types import Detections
from tests.calibration.people.boxes_of_rows import boxes_of_rows

RULES = CalibrationSettings()
SIZE = np.array([[1920, 1080]])
FOCAL = 1200.0
IDEAL = RadialLenses(np.array([FOCAL]), np.zeros(1))

cameras = st.tuples(st.floats(0.15, 0.6), st.floats(-0.1, 0.1), st.floats(2.5, 7.0)).map(
    lambda c: np.array([np.log(FOCAL), c[0], c[1], 0.0, 0.0, 0.0, c[2]])
)


def grid_of(camera, seed, count=300, spread=0.0, pixels=0.0):
    """Draw up to `count` boxes of people all over the picture; heights and edges may scatter."""
    rng = np.random.default_rng(seed)
    xy = np.column_stack([rng.uniform(-8, 8, 4 * count), rng.uniform(2, 25, 4 * count)])
    height = RULES.apparent_height * (1 + spread * rng.standard_normal(len(xy)))
    edges = boxes_of_rows(camera, xy, height, RULES.foot_offset)
    edges = edges + pixels * rng.standard_normal(edges.shape)
    half = 0.2 * (edges[:, 2] - edges[:, 1])
    middle = np.tile((SIZE[0] - 1) / 2, 2)
    box = middle + np.column_stack(
        [edges[:, 0] - half, edges[:, 1], edges[:, 0] + half, edges[:, 2]]
    )
    inside = (box[:, :2] > 10).all(1) & (box[:, 2:] < SIZE[0] - 10).all(1)
    box = box[inside][:count]
    # A box that is only a few pixels tall is not of a person.
    box = box[box[:, 3] - box[:, 1] > 8]
    frame = np.arange(len(box)) % 50
    return grid_boxes(Detections(frame, np.zeros(len(box), int), box), SIZE, RULES, IDEAL)


def errors(plane, camera):
    """Return errors of tilt and roll in radians, and of the height as a fraction."""
    return np.abs(
        [plane[TILT] - camera[TILT], plane[ROLL] - camera[ROLL], plane[Z] / camera[Z] - 1]
    )


@pytest.mark.slow
@settings(max_examples=12)
@given(cameras, st.integers(0, 10**6))
def test_exact_boxes_give_the_exact_ground(camera, seed):
    camera[ROLL] = 0  # a prior pulls the roll slightly towards 0
    found = fit_planes(grid_of(camera, seed), 0, FOCAL, RULES)
    assert len(found) >= 1
    assert errors(found[0], camera).max() < 1e-3
    np.testing.assert_array_equal(found[:, [PAN, X, X + 1]], 0)
    np.testing.assert_allclose(found[:, LOG_FOCAL], np.log(FOCAL))


@pytest.mark.slow
@settings(max_examples=12)
@given(cameras, st.integers(0, 10**6))
def test_people_of_all_heights_and_noisy_boxes_give_it_roughly(camera, seed):
    found = fit_planes(grid_of(camera, seed, spread=0.05, pixels=4.0), 0, FOCAL, RULES)
    best = min(found, key=lambda plane: errors(plane, camera).max())
    # A degree or two, and a tenth of the height.
    assert (errors(best, camera) < [0.04, 0.04, 0.1]).all()


@pytest.mark.slow
@settings(max_examples=8)
@given(cameras, st.integers(0, 10**6), st.floats(0.5, 2))
def test_twice_the_picture_and_focal_length_is_the_same_ground(camera, seed, factor):
    grid = grid_of(camera, seed, spread=0.05)
    # People are counted by pixels, so scaling changes the selection.
    scaled = BoxGrid(grid.box * factor, grid.sd * factor, grid.valid, grid.size, grid.frames)
    one, other = (fit_planes(g, 0, f, RULES) for g, f in ((grid, FOCAL), (scaled, factor * FOCAL)))
    assert errors(one[0], other[0]).max() < 0.02


@pytest.mark.slow
@settings(max_examples=8)
@given(cameras, st.integers(0, 10**6))
def test_a_third_of_boxes_without_a_person_is_outvoted(camera, seed):
    grid = grid_of(camera, seed)
    rng = np.random.default_rng(seed)
    wrong = grid.valid & (rng.random(grid.valid.shape) < 0.33)
    tall = rng.uniform(20, 400, grid.valid.shape)
    grid.box[wrong, 1] = (grid.box[..., 2] - tall)[wrong]
    found = fit_planes(grid, 0, FOCAL, RULES)
    assert min(errors(plane, camera).max() for plane in found) < 0.03


@given(st.integers(0, FEWEST_BOXES - 1))
def test_too_few_boxes_are_no_ground(count):
    camera = np.array([np.log(FOCAL), 0.3, 0, 0, 0, 0, 4.0])
    assert fit_planes(grid_of(camera, 0, count), 0, FOCAL, RULES).shape == (0, 7)


def test_people_who_stand_still_count_once():
    camera = np.array([np.log(FOCAL), 0.3, 0, 0, 0, 0, 4.0])
    grid = grid_of(camera, 1, FEWEST_BOXES - 1)
    at = np.tile(np.arange(grid.frame_count), 40)
    often = (part[:, at] for part in (grid.box, grid.sd, grid.valid))
    for_ever = BoxGrid(*often, grid.size, grid.frames[at])
    assert for_ever.valid.sum() > 10 * FEWEST_BOXES
    assert fit_planes(for_ever, 0, FOCAL, RULES).shape == (0, 7)


@pytest.mark.parametrize("kind", ["one size everywhere", "growing upwards", "one row"])
def test_boxes_of_no_ground_give_none_or_a_finite_one(kind):
    rng = np.random.default_rng(0)
    count = 200
    bottom = rng.uniform(300, 1000, count)
    tall = {
        "one size everywhere": np.full(count, 100.0),
        "growing upwards": 300 - 0.25 * bottom,
        "one row": rng.uniform(50, 250, count),
    }[kind]
    bottom = np.full(count, 700.0) if kind == "one row" else bottom
    left = rng.uniform(100, 1700, count)
    box = np.column_stack([left, bottom - tall, left + 0.4 * tall, bottom])
    grid = grid_boxes(Detections(np.arange(count), np.zeros(count, int), box), SIZE, RULES, IDEAL)
    found = fit_planes(grid, 0, FOCAL, RULES)
    assert np.isfinite(found).all()
    if kind == "growing upwards":
        assert len(found) == 0
