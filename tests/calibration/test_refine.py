"""Refining a rig with people: the adjustment against independent computations, then the rounds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from catfree.calibration._adjusted_cameras import moved_rig
from catfree.calibration._bundle_adjustment import (
    STEP_SD,
    _noise,
    adjust,
    project_directions,
)
from catfree.calibration._refine import ground_under_people, refine
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.evaluation import align_centres
from catfree.geometry import CanonicalFrame, Similarity, transform_scene
from catfree.geometry._least_squares import HUBER
from catfree.settings import Settings
from catfree.synthetic import RigError, make_layout, make_world
from catfree.types import Detections, Rig, Scene
from tests.calibration.partial_scene import without_camera

pytestmark = pytest.mark.slow

seeds = st.integers(0, 2**31 - 1)
PAPER = Settings.paper()
STILL = np.zeros((4, 7))


def small_problem(seed: int, *, noise: float = 0.0, people: int = 12):
    """Make a ring of cameras in units of its extent, people on the ground, and their boxes."""
    rng = np.random.default_rng(seed)
    layout = make_layout("ring4", seed % 5)
    extent = float(layout.scene.extent)
    rig = CanonicalFrame.of(layout.scene).rig(layout.rig)
    points = np.column_stack([rng.uniform(-6, 6, (people, 2)), rng.normal(0, 0.1, people)]) / extent
    pixel = project_directions(rig, points[:, None] - rig.centers)
    pixel += noise * rng.normal(size=pixel.shape)
    weight = rng.uniform(0.2, 1, (people, 4)) * (rng.uniform(size=(people, 4)) < 0.9)
    pixel[weight == 0] = np.nan
    return rng, rig, points, (pixel, weight)


def test_finds_the_minimum_that_scipy_finds():
    rng, rig, points, sightings = small_problem(3, noise=2.0, people=6)
    start = moved_rig(rig, np.column_stack([rng.normal(0, 0.01, (4, 6)), rng.normal(0, 0.02, 4)]))
    found = adjust(*sightings, start, STILL, points, iterations=50)
    seen, weight = sightings
    root = np.sqrt(weight)[..., None] / _noise(seen, weight, start, points)
    precision = 1 / STEP_SD
    K, centers = np.asarray(start.K), np.asarray(start.centers)

    def residuals(state: np.ndarray) -> np.ndarray:
        step = state[:28].reshape(4, 7)
        R = Rotation.from_rotvec(step[:, :3]).as_matrix() @ start.R
        point = state[28:].reshape(-1, 1, 3) - centers - step[:, 3:6]
        x, y, depth = np.einsum("cij,pcj->ipc", R, point)
        ideal = np.stack([x, y], -1) / depth[..., None] * np.exp(step[:, 6, None])
        pixel = np.einsum("cij,pcj->pci", K[:, :2, :2], ideal) + K[:, :2, 2]
        error = np.nan_to_num((seen - pixel) * root)
        length = np.linalg.norm(error, axis=-1)
        k = HUBER
        loss = np.where(length > k, k * (2 * length - k), length**2)
        tie = step * precision
        return np.concatenate([np.sqrt(loss).ravel(), tie.ravel()])

    def with_found(points: np.ndarray) -> np.ndarray:
        return residuals(np.concatenate([found.ravel(), points]))

    best = least_squares(residuals, np.concatenate([np.zeros(28), points.ravel()]))
    assert least_squares(with_found, best.x[28:]).cost <= best.cost * (1 + 1e-4)


def test_exact_sightings_bring_the_cameras_back():
    # A weak tie, because the prior penalizes every error of the start.
    rng, rig, points, sightings = small_problem(1, people=60)
    wrong = moved_rig(rig, np.column_stack([rng.normal(0, 0.01, (4, 6)), np.zeros(4)]))
    found = adjust(*sightings, wrong, STILL, points, iterations=40)
    true, before = rig.centers, wrong.centers
    centers = moved_rig(wrong, found).centers
    after = np.asarray(align_centres(centers, true)(centers))
    assert (
        np.linalg.norm(after - true, axis=-1).mean()
        < 0.1 * np.linalg.norm(before - true, axis=-1).mean()
    )


def test_nobody_seen_leaves_the_cameras_alone():
    _, rig, points, (pixel, weight) = small_problem(0)
    found = adjust(pixel, np.zeros_like(weight), rig, STILL, points, iterations=10)
    np.testing.assert_allclose(found, 0, atol=1e-12)


@given(seed=seeds, outliers=st.integers(0, 15))
@settings(max_examples=15)
def test_ground_follows_the_feet_of_most_people(seed, outliers):
    rng = np.random.default_rng(seed)
    true = rng.normal(0, [0.01, 0.02, 0.02])
    xy = rng.uniform(-0.4, 0.4, (100, 2))
    z = true[0] + xy @ true[1:] + rng.normal(0, 0.001, 100)
    z[:outliers] += rng.uniform(0.02, 0.2, outliers)
    found = ground_under_people(np.column_stack([xy, z]))
    np.testing.assert_allclose(found, true, atol=0.0025)


def test_people_in_a_row_leave_the_slope_across_alone():
    line = np.column_stack([np.linspace(-0.4, 0.4, 50), np.zeros(50), np.full(50, 0.01)])
    found = ground_under_people(line)
    np.testing.assert_allclose(found, [0.01, 0, 0], atol=1e-5)


def centre_error(scene: Scene, world) -> float:
    centers = np.asarray(scene.rig.centers)
    moved = np.asarray(align_centres(centers, world.true_centres)(centers))
    return float(np.linalg.norm(moved - world.true_centres, axis=-1).mean())


@pytest.fixture(scope="module")
def disturbed():
    """Refine a crowded world whose cameras are off by 1 degree, 0.3 m and 2 %."""
    world = make_world("multiviewx", 1, frames=40, rig_error=RigError(1.0, 0.3, 0.02))
    return world, refine(world.detections, world.scene, PAPER, rounds=4)


def test_halves_the_error_of_a_disturbed_rig(disturbed):
    world, found = disturbed
    assert centre_error(found.scene, world) < 0.5 * centre_error(world.scene, world)


def test_trace_holds_every_round_and_the_best_one_wins(disturbed):
    world, found = disturbed
    assert found.residuals.shape == found.people.shape == (5,)
    assert found.chosen == np.argmin(found.residuals)
    again = refine(world.detections, found.scene, PAPER, rounds=0)
    # The residual of the returned scene is the last one of the trace.
    assert again.residuals[0] == pytest.approx(found.residuals[found.chosen], rel=0.02)
    assert again.chosen == 0
    assert again.scene is found.scene


def test_keeps_scale_principal_points_and_extent(disturbed):
    world, found = disturbed
    before, after = world.scene, found.scene
    np.testing.assert_array_equal(
        np.asarray(after.rig.K)[:, :2, 2], np.asarray(before.rig.K)[:, :2, 2]
    )
    assert after.extent == before.extent
    spread = [np.linalg.norm(np.ptp(np.asarray(s.rig.centers), axis=0)) for s in (before, after)]
    assert spread[1] == pytest.approx(spread[0], rel=0.02)


def test_ground_fits_the_people_after_refinement(disturbed):
    world, found = disturbed
    to_world = align_centres(np.asarray(found.scene.rig.centers), world.true_centres)
    normal = np.asarray(to_world.rotation) @ np.asarray(found.scene.ground.normal)
    assert np.degrees(np.linalg.norm(normal[:2])) < 0.5


def test_similarity_of_the_scene_moves_the_result():
    world = make_world("gmvd6", 0, frames=6, rig_error=RigError(1.0, 0.3, 0.02))
    turn = Rotation.from_euler("xyz", [1.0, 2.0, 3.0]).as_matrix()
    moved = Similarity(7.0, turn, np.array([5.0, -3.0, 2.0]))
    here = refine(world.detections, world.scene, PAPER, rounds=1)
    there = refine(world.detections, transform_scene(moved, world.scene), PAPER, rounds=1)
    np.testing.assert_allclose(there.residuals, here.residuals, rtol=1e-3)
    expected = np.asarray(moved(np.asarray(here.scene.rig.centers)))
    extent = float(here.scene.extent) * 7
    np.testing.assert_allclose(np.asarray(there.scene.rig.centers), expected, atol=2e-3 * extent)


def test_a_camera_that_is_not_registered_stays_out():
    world = make_world("ring5", 0, frames=8, rig_error=RigError(1.0, 0.3, 0.02))
    scene, known = without_camera(world.scene, 2)
    found = refine(world.detections, scene, PAPER, rounds=2)
    assert np.isnan(np.asarray(found.scene.rig.t)[2]).all()
    assert np.isfinite(np.asarray(found.scene.rig.t)[known]).all()
    np.testing.assert_array_equal(np.asarray(found.scene.rig.K)[2], np.asarray(scene.rig.K)[2])


@pytest.mark.parametrize("method", [PAPER, Settings()], ids=["paper", "evidence"])
def test_what_cannot_be_refined_is_refused(method):
    world = make_world("ring4", 0, frames=3, people=4)
    rig = world.scene.rig
    two = Rig(rig.K, rig.R, rig.t, rig.image_size, registered=np.arange(4) < 2)
    with pytest.raises(InsufficientDataError, match="only 2 of 4 cameras"):
        refine(world.detections, Scene(two, world.scene.ground, world.scene.extent), method)
    with pytest.raises(InvalidInputError, match="the rig has 3 cameras"):
        refine(world.detections, Scene(rig.select([0, 1, 2]), world.scene.ground, 1.0), method)
    with pytest.raises(InsufficientDataError, match="None of the 0 boxes"):
        refine(world.detections[:0], world.scene, method)
    by_few = r"No person is (confidently )?seen by 3 cameras"
    with pytest.raises(InsufficientDataError, match=by_few):
        refine(world.detections[world.detections.camera < 2], world.scene, method)


def test_a_camera_given_twice_is_refused():
    world = make_world("ring4", seed=0, frames=20, people=5)
    boxes = world.detections[world.detections.camera != 1]
    again = boxes[boxes.camera == 0]
    twice = Detections.concatenate([boxes, replace(again, camera=again.camera + 1)])
    with pytest.raises(InvalidInputError, match=r"Cameras 0 and 1 have the same .* boxes"):
        refine(twice, world.scene)
