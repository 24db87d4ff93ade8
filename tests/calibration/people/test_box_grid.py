"""Boxes on a grid of cameras, frames and slots: every uncut box once, and nothing else."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people._box_grid import grid_boxes
from catfree.calibration.people._radial_lens import RadialLenses
from catfree.geometry._person import edge_deviation
from catfree.settings import CalibrationSettings
from catfree.types import Detections

RULES = CalibrationSettings()
SIZE = np.array([[640, 480], [1920, 1080], [800, 600]])
IDEAL = RadialLenses(np.ones(3), np.zeros(3))
FIELDS = ("box", "sd", "valid")

seeds = st.integers(0, 10**6)


def drawn(seed, count=60, frames=7):
    """Draw boxes all over three pictures, some beyond the borders, with frames in steps of five."""
    rng = np.random.default_rng(seed)
    camera = rng.integers(0, 3, count)
    width, height = SIZE[camera].T
    foot = np.column_stack([rng.uniform(0, width), rng.uniform(0, height)])
    tall = rng.uniform(20, 200, count)
    left, right = foot[:, 0] - 0.2 * tall, foot[:, 0] + 0.2 * tall
    box = np.column_stack([left, foot[:, 1] - tall, right, foot[:, 1]])
    return Detections(5 * rng.integers(0, frames, count), camera, box)


def whole(detections):
    """Mark boxes that do not touch the border of their picture."""
    width, height = SIZE[detections.camera].T
    margin = RULES.border * width
    left, top, right, bottom = np.asarray(detections.box).T
    return (
        (left > margin) & (top > margin)
        & (right < width - 1 - margin) & (bottom < height - 1 - margin)
    )  # fmt: skip


@given(seeds)
def test_every_whole_box_is_in_one_slot_of_its_camera_and_frame(seed):
    detections = drawn(seed)
    grid = grid_boxes(detections, SIZE, RULES, IDEAL)
    box = np.asarray(detections.box)
    row = np.lexsort((box[:, 0], box[:, 3], detections.frame, detections.camera))
    row = row[whole(detections)[row]]
    np.testing.assert_array_equal(grid.frames, np.unique(detections.frame))
    camera, time, _ = np.nonzero(grid.valid)
    np.testing.assert_array_equal(detections.camera[row], camera)
    np.testing.assert_array_equal(detections.frame[row], grid.frames[time])
    # Pixels are counted from the middle of the picture.
    left, top, right, bottom = box[row].T
    across, down = ((SIZE[camera] - 1) / 2).T
    edges = np.column_stack([(left + right) / 2 - across, top - down, bottom - down])
    np.testing.assert_allclose(grid.box[grid.valid], edges)
    sd = edge_deviation(bottom - top, RULES.relative_sd, RULES.pixel_sd)
    np.testing.assert_allclose(grid.sd[grid.valid], sd)
    assert (grid.sd > 0).all()


@given(seeds)
def test_the_order_of_the_boxes_says_nothing(seed):
    detections = drawn(seed)
    order = np.random.default_rng(seed).permutation(len(detections))
    plain, mixed = (grid_boxes(d, SIZE, RULES, IDEAL) for d in (detections, detections[order]))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(plain, name), getattr(mixed, name))


@given(seeds, st.integers(0, 2), st.integers(-9, 9))
def test_shifting_moves_one_camera_in_time_and_back(seed, camera, shift):
    grid = grid_boxes(drawn(seed), SIZE, RULES, IDEAL)
    shifted = grid.shifted(camera, shift)
    back = shifted.shifted(camera, -shift)
    for name in FIELDS:
        before, after = getattr(grid, name), getattr(shifted, name)
        np.testing.assert_array_equal(getattr(back, name), before)
        np.testing.assert_array_equal(np.delete(after, camera, 0), np.delete(before, camera, 0))
        time = (np.arange(grid.frame_count) - shift) % grid.frame_count
        np.testing.assert_array_equal(after[camera], before[camera][time])
    np.testing.assert_array_equal(shifted.frames, grid.frames)


@given(seeds, st.integers(1, 9))
def test_some_frames_are_those_frames(seed, most):
    grid = grid_boxes(drawn(seed), SIZE, RULES, IDEAL)
    some = grid.thinned(most)
    assert some.frame_count == min(most, grid.frame_count)
    index = np.searchsorted(grid.frames, some.frames)
    np.testing.assert_array_equal(some.frames, grid.frames[index])
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(some, name), getattr(grid, name)[:, index])


@pytest.mark.parametrize("most", [2, 3, 10])
def test_long_sequences_are_thinned_out_evenly(most):
    frames = 3 * np.arange(10)
    box = np.tile([100.0, 100, 150, 250], (10, 1))
    rules = dataclasses.replace(RULES, maximum_frames=most)
    grid = grid_boxes(Detections(frames, np.zeros(10, int), box), SIZE[:1], rules, IDEAL)
    assert grid.frame_count == most
    assert (grid.frames[0], grid.frames[-1]) == (0, 27)
    assert np.ptp(np.diff(grid.frames)) <= 3
    assert grid.valid.sum() == most


def test_nothing_makes_an_empty_grid():
    nothing = grid_boxes(Detections([], [], np.zeros((0, 4))), SIZE, RULES, IDEAL)
    assert nothing.valid.shape == (3, 0, 1)
