"""A rig from simulated people, and sequences that must not yield a confident wrong one."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.calibration.people import (
    refine_with_correspondences,
    register,
    without_vague_cameras,
)
from catfree.errors import CalibrationError, InvalidInputError
from catfree.geometry import fit_similarity
from catfree.settings import CalibrationSettings
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Detections, Rig, Scene

pytestmark = pytest.mark.slow

RULES = CalibrationSettings()
DETECTOR = DetectorModel(pixel_noise=3.0, embedding_size=0, false_positives=0.5)
SIZE = (1920, 1080)


@pytest.fixture(scope="module")
def world():
    return make_world("ring4", 3, frames=60, people=7, background=1, detector=DETECTOR)


@pytest.fixture(scope="module")
def recovered(world):
    """Calibrate the world; also return the reported stages."""
    stages = []
    found = register(
        world.detections, SIZE, progress=lambda stage, done, total: stages.append(stage)
    )
    return found, stages


def center_errors(calibration, centers):
    """Return center errors after a similarity, stated ones, and the scale."""
    known = calibration.scene.rig.registered
    found = np.asarray(calibration.scene.rig.centers)[known]
    similarity = fit_similarity(found, centers[known])
    moved, scale = np.asarray(similarity(found)), float(similarity.scale)
    variance = np.trace(calibration.center_covariance[known], axis1=1, axis2=2)
    return np.linalg.norm(moved - centers[known], axis=-1), scale * np.sqrt(variance), 1 / scale


def replaced(detections, camera, box=None, frame=None):
    """Replace boxes or frames of one camera."""
    mine = detections.camera == camera
    boxes, frames = detections.box.copy(), detections.frame.copy()
    if box is not None:
        boxes[mine] = box(boxes[mine])
    if frame is not None:
        frames[mine] = frame(frames[mine])
    return Detections(frames, detections.camera, boxes)


def assert_without(detections, camera, centers):
    """Only that camera is flagged, and the others are placed as without its boxes."""
    found = register(detections, SIZE)
    without = register(detections[detections.camera != camera], np.tile(SIZE, (4, 1)))
    assert found.scene.rig.registered.tolist() == [c != camera for c in range(4)]
    assert np.isnan(np.asarray(found.scene.rig.K)[camera]).all()
    assert np.isnan(found.log_likelihood_ratio[camera])
    one, other = (np.asarray(c.scene.rig.K) for c in (found, without))
    np.testing.assert_allclose(one, other, rtol=0.01)
    # The frames may differ: another camera's heading may be fixed.
    one, other = (np.asarray(c.scene.rig.centers) for c in (found, without))
    apart = [np.linalg.norm(at[:, None] - at, axis=-1) for at in (one, other)]
    np.testing.assert_allclose(*apart, atol=0.05)
    np.testing.assert_allclose(one[:, 2], other[:, 2], atol=0.05)
    # As for the whole rig: a decimeter or two.
    assert center_errors(found, centers)[0].mean() < 0.3


def test_a_small_world_is_recovered_in_metres(world, recovered):
    found, stages = recovered
    errors, stated, scale = center_errors(found, world.true_centres)
    assert found.scene.rig.registered.all()
    assert (errors < 3 * stated).all()
    assert errors.mean() < 0.3
    # The crowd of this world is not as tall as assumed, which alone explains the scale.
    tall = world.walkers.height.mean()
    assert abs(scale * tall / RULES.person_height - 1) < min(abs(scale - 1), 0.05)
    assert abs(scale - 1) < 2 * found.scale_sd < 0.2
    assert found.scene.metric
    assert (np.asarray(found.scene.rig.centers)[:, 2] > 0).all()
    focal = np.asarray(found.scene.rig.K)[:, 0, 0] / np.asarray(world.true_rig.K)[:, 0, 0]
    assert np.abs(focal - 1).mean() < 0.05
    assert (found.log_likelihood_ratio > max(RULES.minimum_margin, 25)).all()
    assert (found.association_rate > max(RULES.minimum_association, 0.5)).all()
    assert (found.association_rate <= 1).all()
    assert (found.focal_sd > 0).all()
    assert np.linalg.eigvalsh(found.center_covariance).min() > -1e-9
    assert {"pairs", "growth"} <= set(stages)


def test_the_order_of_boxes_does_not_matter(world, recovered):
    order = np.random.default_rng(0).permutation(len(world.detections))
    one, _ = recovered
    two = register(world.detections[order], SIZE)
    np.testing.assert_array_equal(one.scene.rig.K, two.scene.rig.K)
    np.testing.assert_array_equal(one.scene.rig.t, two.scene.rig.t)


def true_members(world):
    """Return (P, C) rows of the boxes of each person in each frame."""
    real = np.flatnonzero(world.identities >= 0)
    keys, group = np.unique(
        np.stack([world.detections.frame[real], world.identities[real]], -1),
        axis=0,
        return_inverse=True,
    )
    members = np.full((len(keys), 4), -1)
    members[group.reshape(-1), world.detections.camera[real]] = real
    return members


def test_true_correspondences_do_not_harm_a_rig(world, recovered):
    found, _ = recovered
    members = true_members(world)
    refined = refine_with_correspondences(found, world.detections, members)
    before, _, _ = center_errors(found, world.true_centres)
    after, _, _ = center_errors(refined, world.true_centres)
    assert after.mean() < max(1.2 * before.mean(), 0.1)
    assert refined.scene.rig.registered.all()
    with pytest.raises(InvalidInputError, match="members must have shape"):
        refine_with_correspondences(found, world.detections, members[:, :3])


def enlarged(world, found, zoomed):
    """Make boxes, start and focal lengths as if all had one lens, with camera 0 enlarged."""
    focal = np.asarray(world.true_rig.K)[:, 0, 0]
    zoom = focal.mean() / focal * np.array([zoomed, 1.0, 1.0, 1.0])
    middle = np.tile((np.array(SIZE) - 1) / 2, 2)
    boxes = world.detections
    larger = replace(boxes, box=middle + (boxes.box - middle) * zoom[boxes.camera, None])
    rig = found.scene.rig
    K = np.array(rig.K)
    K[:, [0, 1], [0, 1]] *= zoom[:, None]
    scene = Scene.from_rig(Rig(K, rig.R, rig.t, rig.image_size), found.scene.ground, metric=True)
    return larger, replace(found, scene=scene), focal * zoom


@pytest.mark.parametrize(("zoomed", "shared"), [(1.0, True), (1.25, False)])
def test_people_tell_whether_one_focal_length_serves_all(world, recovered, zoomed, shared):
    boxes, start, focal = enlarged(world, recovered[0], zoomed)
    refined = refine_with_correspondences(start, boxes, true_members(world), repeats=60.0)
    assert refined.shared_focal == shared
    ratio = np.asarray(refined.scene.rig.K)[:, 0, 0] / focal
    np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.05)


def test_a_few_people_part_no_focal_lengths(world, recovered):
    boxes, start, focal = enlarged(world, recovered[0], 1.0)
    refined = refine_with_correspondences(start, boxes, true_members(world)[:25], repeats=4.0)
    assert refined.shared_focal
    ratio = np.asarray(refined.scene.rig.K)[:, 0, 0] / focal
    np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.01)


def test_focal_lengths_that_differ_a_little_are_drawn_to_their_mean(world, recovered):
    boxes, start, focal = enlarged(world, recovered[0], 1.12)
    refined = refine_with_correspondences(start, boxes, true_members(world), repeats=60.0)
    ratio = np.asarray(refined.scene.rig.K)[:, 0, 0] / focal
    assert np.abs(np.log(ratio) - np.log(ratio).mean()).max() < 0.05


def test_a_camera_with_a_wider_lens_is_placed(world, recovered):
    boxes, _, focal = enlarged(world, recovered[0], 0.7)
    found = register(boxes, SIZE)
    assert found.scene.rig.registered.all()
    assert not found.shared_focal
    ratio = np.asarray(found.scene.rig.K)[:, 0, 0] / focal
    np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.1)
    error, _, _ = center_errors(found, world.true_centres)
    assert error.max() < 0.5


def test_two_cameras_are_enough(world):
    two = world.detections[world.detections.camera < 2]
    found = register(two, SIZE)
    assert found.scene.rig.registered.tolist() == [True, True]
    assert (found.log_likelihood_ratio > RULES.minimum_margin).all()
    apart, truly_apart = (
        np.linalg.norm(np.subtract(*centers[:2]))
        for centers in (np.asarray(found.scene.rig.centers), world.true_centres)
    )
    np.testing.assert_allclose(apart, truly_apart, rtol=0.1)


def test_a_shuffled_camera_is_flagged(world):
    rng = np.random.default_rng(0)
    frames = np.unique(world.detections.frame)
    other = rng.permutation(frames)
    shuffled = replaced(world.detections, 1, frame=lambda f: other[np.searchsorted(frames, f)])
    assert_without(shuffled, 1, world.true_centres)


def test_a_mirrored_camera_is_flagged(world):
    mirrored = replaced(
        world.detections,
        2,
        box=lambda b: np.stack([1919 - b[:, 2], b[:, 1], 1919 - b[:, 0], b[:, 3]], -1),
    )
    assert_without(mirrored, 2, world.true_centres)


def test_a_camera_that_looks_elsewhere_is_flagged(world):
    elsewhere = make_world("ring4", 9, frames=60, people=7, detector=DETECTOR).detections
    ours, theirs = world.detections, elsewhere[elsewhere.camera == 0]
    kept = ours[ours.camera != 0]
    mixed = Detections(
        np.concatenate([kept.frame, theirs.frame]),
        np.concatenate([kept.camera, theirs.camera]),
        np.concatenate([kept.box, theirs.box]),
    )
    assert_without(mixed, 0, world.true_centres)


def test_a_camera_without_boxes_is_flagged(world):
    found = register(world.detections[world.detections.camera != 3], np.tile(SIZE, (4, 1)))
    assert found.scene.rig.registered.tolist() == [True, True, True, False]


def test_people_who_stand_still_prove_nothing(world):
    first = world.detections[world.detections.frame == 0]
    rng = np.random.default_rng(0)
    box = np.tile(first.box, (60, 1))
    still = Detections(
        np.repeat(np.arange(60), len(first)),
        np.tile(first.camera, 60),
        box + rng.normal(0, 1, box.shape),
    )
    with pytest.raises(CalibrationError, match="No two cameras see the same people: of 6 pairs"):
        register(still, SIZE)


def test_ten_frames_are_too_few(world):
    with pytest.raises(CalibrationError, match="at least 20 frames with boxes, and has 10"):
        register(world.detections[world.detections.frame < 10], SIZE)


def test_boxes_that_never_move_prove_nothing(world):
    box = np.tile([900.0, 400.0, 1000.0, 650.0], (len(world.detections), 1))
    box += world.detections.camera[:, None]  # identical boxes in two cameras are refused
    with pytest.raises(CalibrationError, match="No two cameras see the same people: of 6 pairs"):
        register(Detections(world.detections.frame, world.detections.camera, box), SIZE)


def test_one_person_makes_no_rig_to_be_trusted():
    world = make_world(
        "ring4",
        5,
        frames=60,
        people=1,
        background=0,
        standing=0.0,
        detector=DetectorModel(pixel_noise=3.0, embedding_size=0, false_positives=0.0),
    )
    found = register(world.detections, SIZE)
    # A single path fits many lenses, which the stated deviations show.
    registered = np.flatnonzero(found.scene.rig.registered)
    focal, true_focal = (np.asarray(rig.K)[:, 0, 0] for rig in (found.scene.rig, world.true_rig))
    deviation = found.focal_sd / focal
    error = np.log(focal / true_focal)[registered]
    assert (np.abs(error) < 2 * deviation[registered]).all()
    each = ", ".join(rf"camera {c} to \d+ %" for c in registered)
    with pytest.raises(CalibrationError, match=rf"too uncertain.*{each}"):
        without_vague_cameras(found, RULES)


def test_no_boxes_at_all():
    with pytest.raises(CalibrationError, match="needs 2 cameras"):
        register(Detections([], [], np.zeros((0, 4))), np.tile(SIZE, (3, 1)))


def test_wrong_sizes_and_names_are_named(world):
    with pytest.raises(InvalidInputError, match="image_size has 2 rows"):
        register(world.detections, np.tile(SIZE, (2, 1)))
    with pytest.raises(InvalidInputError, match="image_size must be"):
        register(world.detections, [1920])
    for width in (1920.5, np.nan, 1e30):
        with pytest.raises(InvalidInputError, match=r"image_size\[0\] is .* whole number"):
            register(world.detections, [width, 1080])
    with pytest.raises(InvalidInputError, match="camera_names has 1"):
        register(world.detections, SIZE, camera_names=["left"])
