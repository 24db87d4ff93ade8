"""Invariance of the evidence method to the scene's pose, cameras that see no one, and numbering."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.calibration._confident_people import confident_people
from catfree.geometry import Similarity, transform_scene
from catfree.methods.evidence import solve
from catfree.methods.evidence.learn._noise import crowding
from catfree.settings import EvidenceSettings
from catfree.synthetic import World, make_world

turns = st.floats(-3.1, 3.1)


@cache
def crowd() -> World:
    """Simulate enough people to learn every parameter, with a disturbed rig."""
    return make_world("wildtrack", 0, frames=10, people=20)


@cache
def found() -> cf.Tracks:
    return cf.localize(crowd().detections, crowd().scene).tracks


def with_cameras(scene: cf.Scene, count: int, *, registered: bool) -> cf.Scene:
    """Append cameras to the scene: unknown ones, or ones that look at the sky."""
    rig = scene.rig
    up = np.asarray(scene.ground.normal, np.float64)
    side = np.cross(up, [0.3, 0.5, 0.1])
    side /= np.linalg.norm(side)
    R = np.stack([side, np.cross(up, side), up])
    t = -R @ np.asarray(rig.centers)[0]
    K = np.asarray(rig.K)[0]
    if not registered:
        K, R, t = (np.full_like(value, np.nan) for value in (K, R, t))

    def more(values, one):
        return np.concatenate([np.asarray(values), np.repeat(np.asarray(one)[None], count, 0)])

    longer = cf.Rig(
        more(rig.K, K),
        more(rig.R, R),
        more(rig.t, t),
        more(rig.image_size, rig.image_size[0]),
        registered=more(rig.registered, registered),
    )
    return cf.Scene(longer, scene.ground, scene.extent, scene.metric)


def assert_same(one: cf.Tracks, two: cf.Tracks, scale: float | int = 1) -> None:
    assert len(one) == len(two)
    np.testing.assert_array_equal(one.frame, two.frame)
    np.testing.assert_allclose(scale * one.sigma, two.sigma, rtol=1e-4)
    np.testing.assert_allclose(one.existence, two.existence, atol=1e-4)


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(turns, st.lists(turns, min_size=3, max_size=3), st.floats(0.01, 100.0))
def test_a_crowd_turns_with_its_scene(about_vertical, rotation, scale):
    normal = np.asarray(crowd().scene.ground.normal)
    turn = Rotation.from_rotvec(rotation) * Rotation.from_rotvec(about_vertical * normal)
    similarity = Similarity(scale, turn.as_matrix(), np.array([3.0, -5.0, 2.0]) * scale)
    moved = cf.localize(crowd().detections, transform_scene(similarity, crowd().scene)).tracks
    assert_same(found(), moved, scale)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), turns, st.integers(1, 80))
def test_crowding_has_no_grid(seed, turn, count):
    rng = np.random.default_rng(seed)
    position, frame = rng.uniform(-8, 8, (count, 2)), rng.integers(0, 5, count)
    R = Rotation.from_euler("z", turn).as_matrix()[:2, :2]
    order = rng.permutation(count)
    moved = (position @ R.T + rng.uniform(-3, 3, 2))[order]
    assert crowding(moved, frame[order]) == pytest.approx(crowding(position, frame), rel=1e-9)


def test_crowding_by_hand():
    # One place is used in two frames, and another, far away, only in the second: two discs
    # of four square units, and one and a half people a frame.
    position = np.array([[0.0, 0.0], [0.0, 0.0], [50.0, 0.0]])
    assert crowding(position, np.array([0, 1, 1])) == pytest.approx(1.5 / 8, rel=0.05)


def test_ground_that_several_use_counts_once():
    # The intersection of two discs of area 4 whose centers lie on each other's rim.
    step = 2 / np.sqrt(np.pi)
    position = np.array([[0.0, 0.0], [step, 0.0]])
    shared = 4 * (2 / 3 - np.sqrt(3) / (2 * np.pi))
    assert crowding(position, np.zeros(2, int)) == pytest.approx(2 / (8 - shared), rel=0.05)


@pytest.mark.slow
def test_crowding_of_a_uniform_crowd_is_its_density():
    rng = np.random.default_rng(0)
    position, frame = rng.uniform(0, 40, (16000, 2)), np.repeat(np.arange(100), 160)
    edge = 4 * 40 * 2 / np.sqrt(np.pi)  # a step beyond the outermost
    assert crowding(position, frame) == pytest.approx(160 / (40**2 + edge), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 6])
def test_cameras_that_see_nobody_have_no_say(count):
    for registered in (False, True):
        scene = with_cameras(crowd().scene, count, registered=registered)
        assert_same(found(), cf.localize(crowd().detections, scene).tracks)


@pytest.mark.slow
def test_beside_two_cameras_a_third_without_boxes_has_no_say():
    world = make_world("ring4", 1, frames=25, people=5)
    boxes = world.detections[world.detections.camera < 2]
    scene = cf.Scene(world.scene.rig.select([0, 1]), world.scene.ground, world.scene.extent)
    alone = cf.localize(boxes, scene).tracks
    for registered in (False, True):
        longer = with_cameras(scene, 1, registered=registered)
        assert_same(alone, cf.localize(boxes, longer).tracks)


@pytest.mark.slow
def test_confident_people_do_not_depend_on_unknown_cameras():
    few = confident_people(crowd().detections, crowd().scene, EvidenceSettings()).member
    longer = with_cameras(crowd().scene, 9, registered=False)
    more = confident_people(crowd().detections, longer, EvidenceSettings()).member
    assert len(few) > 20
    np.testing.assert_array_equal(more[:, : few.shape[1]], few)
    assert (more[:, few.shape[1] :] == -1).all()


@cache
def numbered_from(first: int) -> cf.Tracks:
    """Return the crowd without embeddings, with frames numbered from `first`."""
    boxes = crowd().detections
    later = cf.Detections(boxes.frame + first, boxes.camera, boxes.box, boxes.score)
    return cf.localize(later, crowd().scene).tracks


@pytest.mark.slow
@pytest.mark.parametrize("first", [-(2**40), 2**52, 2**53, 2**62])
def test_frames_may_be_numbered_from_anywhere(first):
    one, two = numbered_from(0), numbered_from(first)
    np.testing.assert_array_equal(one.frame, two.frame - first)
    np.testing.assert_allclose(one.position, two.position, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("before", [31, 64])
def test_a_camera_of_a_high_number_sees_each_person_once(before):
    """Two boxes of one camera are two people, whatever the camera's number."""
    world = make_world("ring6", 1, frames=6, people=10)
    boxes = world.detections
    twice = np.repeat(np.arange(len(boxes)), 2)
    longer = with_cameras(world.scene, before, registered=False)
    count = world.scene.rig.camera_count
    order = np.r_[count : count + before, 0:count]
    later = cf.Scene(longer.rig.select(order), longer.ground, longer.extent)
    members = [
        (
            solve(
                cf.Detections(boxes.frame[twice], boxes.camera[twice] + shift, boxes.box[twice]),
                scene,
            ).groups.member
            >= 0
        ).sum()
        for scene, shift in ((world.scene, 0), (later, before))
    ]
    assert members[0] == members[1] > len(boxes)


@pytest.mark.slow
def test_identical_boxes_are_told_apart_by_looks_in_any_order():
    world = make_world("ring4", 2, frames=12, people=8)
    boxes = world.detections
    looks = np.maximum(np.asarray(boxes.embedding), 0)
    looks[:, 0] = 0  # the first entries of features are often equal
    other = looks[np.random.default_rng(0).permutation(len(looks))]
    twins = cf.Detections(
        *(np.concatenate([value] * 2) for value in (boxes.frame, boxes.camera, boxes.box)),
        embedding=np.concatenate([looks, other]),
    )
    one, two = (cf.localize(d, world.scene).tracks for d in (twins, twins[::-1]))
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.supporting_cameras, two.supporting_cameras)


def test_nobody_has_existence_probabilities_of_length_zero():
    nobody = cf.localize(crowd().detections[:0], crowd().scene).tracks
    assert nobody.existence is not None
    assert nobody.existence.shape == (0,)
