"""Cells of the ground in front of a camera."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence.observe._boxes import prepare_boxes
from catfree.methods.evidence.observe._ground_cells import CELLS, ground_cell
from catfree.methods.evidence.observe._measurement import measure_boxes, start_noise
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from tests.methods.evidence.evidence_worlds import HEIGHT, make_rig, make_scene, walk

VIEWS = ground_views(make_scene(make_rig(4)), HEIGHT)

cells_of = jax.jit(jax.vmap(ground_cell))


@given(st.integers(0, 10**6))
def test_cells_are_squares_ahead_and_aside_of_each_camera(seed):
    rng = np.random.default_rng(seed)
    camera = rng.integers(0, 4, 30)
    ahead, aside = rng.uniform(-20, 150, 30), rng.uniform(-80, 80, 30)
    forward = VIEWS.heading[camera]
    right = np.column_stack([forward[:, 1], -forward[:, 0]])
    place = VIEWS.station[camera] + ahead[:, None] * forward + aside[:, None] * right
    cell = cells_of(*map(jnp.asarray, (place, VIEWS.station[camera], forward)))
    found = np.stack(np.divmod(np.asarray(cell), CELLS), -1)
    # Points outside the map are in the nearest cell.
    expected = np.floor(np.column_stack([ahead + 8, aside + CELLS // 2])).clip(0, CELLS - 1)
    near_a_line = np.abs(np.column_stack([ahead, aside]) % 1 - 0.5).max(1) > 0.5 - 1e-4
    np.testing.assert_array_equal(found[~near_a_line], expected[~near_a_line])


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_box_with_a_pinhole_of_its_own_is_in_the_map_of_its_camera():
    rig, rules = make_rig(4), EvidenceSettings()
    _, detections, scene = walk(6, 3, rig=rig)
    # A fisheye with little distortion: boxes still look like people.
    lens = ["pinhole", "fisheye", "pinhole", "fisheye"]
    mixed = replace(rig, distortion=np.zeros((4, 5)), lens=lens)
    scene = replace(scene, rig=mixed)
    boxes = prepare_boxes(detections, mixed, rules)
    views, noise = ground_views(scene, HEIGHT, boxes), start_noise(4, rules)
    measured = measure_boxes(boxes, views, noise, rules)
    valid = np.flatnonzero(measured.valid)
    own = boxes.view[valid] >= 4
    assert own.sum() > 10
    assert (~own).sum() > 10
    place, _ = mean_and_covariance(measured.info[valid], float(noise.spread))
    camera = boxes.camera[valid]
    away, forward = place[:, :2] - VIEWS.station[camera], VIEWS.heading[camera]
    right = np.column_stack([forward[:, 1], -forward[:, 0]])
    ahead, aside = (away * forward).sum(1), (away * right).sum(1)
    expected = np.floor(np.column_stack([ahead + 8, aside + CELLS // 2]))
    found = np.stack(np.divmod(np.asarray(measured.cell)[valid], CELLS), -1)
    near_a_line = np.abs(np.column_stack([ahead, aside]) % 1 - 0.5).max(1) > 0.5 - 1e-6
    np.testing.assert_array_equal(found[~near_a_line], expected[~near_a_line])
