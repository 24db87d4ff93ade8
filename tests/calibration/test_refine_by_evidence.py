"""The refinement's loop with the evidence method: its properties, then its gain."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from catfree.calibration._refine import Refinement, refine
from catfree.calibration._refine_by_evidence import RUN, in_runs
from catfree.evaluation import align_centres
from catfree.geometry import Similarity, transform_scene
from catfree.synthetic import DetectorModel, RigError, World, make_world
from catfree.types import Detections, Scene
from tests.calibration.partial_scene import without_camera

pytestmark = pytest.mark.slow

LOOKS = DetectorModel(embedding_size=16)
DEGREE_OFF = RigError(1.0, 0.3, 0.02, 0.5, 0.05)
RIGHT = RigError(0.0, 0.0, 0.0, 0.0, 0.0)


def small_world(error: RigError) -> World:
    return make_world("ring5", 0, frames=30, people=8, rig_error=error, detector=LOOKS)


def centre_error(scene: Scene, world: World) -> float:
    centers = np.asarray(scene.rig.centers)
    moved = np.asarray(align_centres(centers, world.true_centres)(centers))
    return float(np.linalg.norm(moved - world.true_centres, axis=-1).mean())


@pytest.fixture(scope="module")
def disturbed() -> tuple[World, Refinement]:
    """Refine a world whose cameras are off by 1 degree, 0.3 m and 2 %."""
    world = small_world(DEGREE_OFF)
    return world, refine(world.detections, world.scene)


@given(
    frames=st.lists(st.integers(0, 10_000), min_size=1, max_size=300),
    most=st.integers(1, 200),
)
@settings(max_examples=200)
def test_runs_are_few_frames_in_neighbours(frames, most):
    frame = np.array(frames)
    chosen = in_runs(frame, most)
    every, kept = np.unique(frame), np.unique(frame[chosen])
    # Whole frames, at most the allowed number, and all of them if they fit.
    assert not np.isin(frame[~chosen], kept).any()
    assert len(kept) <= most
    if len(every) <= most:
        assert chosen.all()
    else:
        # Each run consists of neighboring frames, and the last run is complete.
        index = np.searchsorted(every, kept)
        runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
        assert min(map(len, runs)) >= min(RUN, most)


def test_halves_the_error_of_a_disturbed_rig(disturbed):
    world, found = disturbed
    assert centre_error(found.scene, world) < 0.5 * centre_error(world.scene, world)


def test_stops_when_the_residual_stops_falling_and_the_best_round_wins(disturbed):
    world, found = disturbed
    assert len(found.residuals) == len(found.people) < 26
    assert found.chosen == np.argmin(found.residuals)
    assert found.residuals[found.chosen] < found.residuals[0]
    again = refine(world.detections, found.scene, rounds=0)
    # The same measure of the returned scene equals that of the trace.
    assert again.residuals[0] == pytest.approx(found.residuals[found.chosen], rel=1e-3)


def test_the_rig_as_a_whole_stays_in_place_and_size(disturbed):
    world, found = disturbed
    before, after = world.scene, found.scene
    extent = float(before.extent)
    assert float(after.extent) == extent
    old, new = (np.asarray(s.rig.centers, np.float64) for s in (before, after))
    np.testing.assert_allclose(new.mean(0), old.mean(0), atol=1e-5 * extent)
    old, new = old - old.mean(0), new - new.mean(0)
    # The best scale of the new centers against the old ones is 1.
    assert (old * new).sum() == pytest.approx((new**2).sum(), rel=1e-4)
    turn = np.einsum("cji,cjk->cik", np.asarray(before.rig.R), np.asarray(after.rig.R))
    mean = Rotation.from_matrix(turn).mean().as_rotvec()
    np.testing.assert_allclose(mean, 0, atol=1e-4)


def test_a_right_rig_stays():
    world = small_world(RIGHT)
    found = refine(world.detections, world.scene)
    assert found.residuals[found.chosen] <= found.residuals[0]
    moved = np.asarray(found.scene.rig.centers) - np.asarray(world.scene.rig.centers)
    # Boxes are only as exact as people and detector: centimeters in a ring of 20 m.
    assert np.linalg.norm(moved, axis=-1).max() < 0.01 * float(world.scene.extent)
    turn = Rotation.from_matrix(
        np.asarray(found.scene.rig.R) @ np.asarray(world.scene.rig.R).transpose(0, 2, 1)
    )
    assert np.degrees(turn.magnitude()).max() < 0.5


def test_order_of_cameras_does_not_matter(disturbed):
    world, found = disturbed
    order = np.array([3, 0, 4, 1, 2])
    place = np.argsort(order)
    boxes = world.detections
    shuffled = Detections(
        boxes.frame, place[boxes.camera], boxes.box, boxes.score, boxes.ankles_confirmed,
        boxes.embedding,
    )  # fmt: skip
    given_scene = world.scene
    scene = Scene(given_scene.rig.select(order), given_scene.ground, given_scene.extent)
    again = refine(shuffled, scene)
    assert again.chosen == found.chosen
    np.testing.assert_allclose(again.residuals, found.residuals, rtol=1e-3)
    expected = np.asarray(found.scene.rig.centers)[order]
    atol = 1e-3 * float(given_scene.extent)
    np.testing.assert_allclose(np.asarray(again.scene.rig.centers), expected, atol=atol)


def test_similarity_of_the_scene_moves_the_result(disturbed):
    world, _ = disturbed
    turn = Rotation.from_euler("xyz", [1.0, 2.0, 3.0]).as_matrix()
    moved = Similarity(7.0, turn, np.array([5.0, -3.0, 2.0]))
    here = refine(world.detections, world.scene, rounds=1)
    there = refine(world.detections, transform_scene(moved, world.scene), rounds=1)
    # In a rig this wrong a few people are barely certain, which rounding may change.
    np.testing.assert_allclose(there.residuals, here.residuals, rtol=1e-2)
    expected = np.asarray(moved(np.asarray(here.scene.rig.centers)))
    atol = 1e-3 * 7 * float(world.scene.extent)
    np.testing.assert_allclose(np.asarray(there.scene.rig.centers), expected, atol=atol)


def test_a_camera_that_is_not_registered_stays_out(disturbed):
    world, _ = disturbed
    scene, known = without_camera(world.scene, 2)
    found = refine(world.detections, scene, rounds=2)
    assert found.chosen > 0
    assert np.isnan(np.asarray(found.scene.rig.t)[2]).all()
    assert np.isfinite(np.asarray(found.scene.rig.t)[known]).all()
    np.testing.assert_array_equal(np.asarray(found.scene.rig.K)[2], np.asarray(scene.rig.K)[2])


def test_edges_that_the_image_border_cuts_do_not_stop_it(disturbed):
    world, _ = disturbed
    boxes, rig = world.detections, world.scene.rig
    box = np.array(boxes.box)
    cut = np.random.default_rng(0).random(len(box)) < 0.05
    box[cut, 3] = np.asarray(rig.image_size)[boxes.camera[cut], 1]
    found = refine(replace(boxes, box=box), world.scene)
    assert found.residuals[1] < 0.5 * found.residuals[0]
    assert centre_error(found.scene, world) < 0.6 * centre_error(world.scene, world)


def test_a_rig_on_a_map_stays_where_it_is():
    world = make_world("ring5", seed=0, frames=16, people=6)
    here, east = world.true_scene, np.array([4.5e5 + 0.3, 5.2e6 + 0.7, 100.0])
    rig, plane = here.rig, here.ground
    centers = np.asarray(rig.centers, np.float64) + east
    there = replace(
        here,
        rig=replace(rig, t=-np.einsum("cij,cj->ci", np.asarray(rig.R, np.float64), centers)),
        ground=replace(plane, offset=np.asarray(plane.offset - plane.normal @ east)),
    )
    near, far = (refine(world.detections, scene).scene for scene in (here, there))
    moved = np.asarray(far.rig.centers) - east - np.asarray(near.rig.centers)
    assert np.abs(moved).max() < 1e-3
