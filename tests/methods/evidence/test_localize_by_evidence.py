from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.errors import InsufficientDataError
from catfree.evaluation import detection_metrics
from catfree.methods.evidence import EvidenceSettings, localize_by_evidence
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Fate, Origin
from tests.methods.evidence.evidence_worlds import make_rig, make_scene, walk

EXACT = {"noise": 0.0, "recall": 1.0, "clutter": 0.0}


def moda(truth, result):
    return detection_metrics(truth, result.tracks.to_rows(), threshold=0.5).moda


def assert_found_alone(truth, result):
    """Exactly the true people are found: they stand apart, and four or five cameras see each."""
    metrics = detection_metrics(truth, result.tracks.to_rows(), threshold=0.5)
    assert (metrics.fn, metrics.fp) == (0, 0)


def rows_of(result):
    t = result.tracks
    return np.column_stack([t.frame, t.ground_xy])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("boxes", [EXACT, {}], ids=["exact", "noisy"])
def test_people_who_walk_are_found_and_keep_their_identity(seed, boxes):
    truth, detections, scene = walk(seed=seed, **boxes)
    result = localize_by_evidence(detections, scene)
    assert_found_alone(truth, result)
    assert len(np.unique(result.tracks.track_id)) == 6
    assert (result.tracks.existence > 0.5).all()
    accepted = result.candidates.fate == Fate.ACCEPTED
    assert accepted.sum() == (result.tracks.origin == Origin.DETECTED).sum()


@pytest.mark.slow
def test_true_positions_lie_inside_the_stated_ellipses():
    truth, detections, scene = walk(people=8, frames=20, seed=3, noise=0.02)
    t = localize_by_evidence(detections, scene).tracks
    inside = []
    for frame, xy, covariance in zip(t.frame, t.ground_xy, t.covariance, strict=True):
        there = truth[truth[:, 0] == frame, 2:]
        error = there[np.argmin(np.linalg.norm(there - xy, axis=1))] - xy
        inside.append(error @ np.linalg.solve(covariance, error) < 5.99)
    assert np.mean(inside) > 0.9


@pytest.mark.slow
@settings(max_examples=4)
@given(
    st.floats(0.05, 20),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.lists(st.floats(-50, 50), min_size=3, max_size=3),
)
def test_a_similarity_of_the_scene_is_one_of_the_result(scale, rotation, shift):
    _, detections, scene = walk(frames=6, seed=5)
    rig = scene.rig
    Q, v = Rotation.from_rotvec(rotation).as_matrix(), np.array(shift)
    R = np.asarray(rig.R) @ Q.T
    t = scale * np.asarray(rig.t) - R @ v
    normal = Q @ np.array([0.0, 0.0, 1.0])
    other = cf.Scene(cf.Rig(rig.K, R, t, rig.image_size), cf.Plane(normal, -normal @ v), 18 * scale)
    a, b = (
        localize_by_evidence(detections, scene).tracks,
        localize_by_evidence(detections, other).tracks,
    )
    moved = scale * a.position @ Q.T + v
    order_a = np.lexsort((moved[:, 0].round(4), a.frame))
    order_b = np.lexsort((b.position[:, 0].round(4), b.frame))
    assert len(a) == len(b)
    np.testing.assert_allclose(moved[order_a], b.position[order_b], atol=1e-6 * (scale + 50))
    np.testing.assert_allclose(scale * a.sigma[order_a], b.sigma[order_b], rtol=1e-6)
    np.testing.assert_allclose(scale * a.design_sigma[order_a], b.design_sigma[order_b], rtol=1e-6)
    np.testing.assert_array_equal(a.whole_views[order_a], b.whole_views[order_b])


@pytest.mark.slow
@pytest.mark.parametrize("east", [0.0, 500_000.0])
def test_boxes_in_single_precision_are_measured_in_single_precision(east):
    _, detections, scene = walk(seed=0)
    rig, shift = scene.rig, np.array([east, -10 * east, 0])
    scene = make_scene(cf.Rig(rig.K, rig.R, rig.t - np.asarray(rig.R) @ shift, rig.image_size))
    narrow = replace(detections, box=detections.box.astype(np.float32))
    same = replace(narrow, box=narrow.box.astype(np.float64))
    single, double = (localize_by_evidence(boxes, scene).tracks for boxes in (narrow, same))
    np.testing.assert_array_equal(single.frame, double.frame)
    np.testing.assert_array_equal(single.support, double.support)
    np.testing.assert_allclose(single.ground_xy, double.ground_xy, atol=1e-3)
    np.testing.assert_allclose(single.covariance, double.covariance, rtol=1e-2, atol=1e-6)
    assert (single.sigma != double.sigma).any()  # other digits, so it was computed differently


@pytest.mark.slow
@settings(max_examples=4)
@given(st.randoms(use_true_random=False))
def test_the_order_of_detections_and_cameras_has_no_effect(random):
    _, detections, scene = walk(frames=6, seed=6)
    order = list(range(len(detections)))
    random.shuffle(order)
    cameras = list(range(5))
    random.shuffle(cameras)
    place = np.argsort(cameras)
    shuffled = detections[order]
    renamed = cf.Detections(shuffled.frame, place[shuffled.camera], shuffled.box)
    plain = rows_of(localize_by_evidence(detections, scene))
    other = rows_of(localize_by_evidence(renamed, make_scene(scene.rig.select(cameras))))
    plain, other = (r[np.lexsort(r.T[::-1].round(6))] for r in (plain, other))
    np.testing.assert_allclose(plain, other, atol=1e-7)


@pytest.mark.slow
def test_an_unregistered_camera_has_no_say():
    _, detections, scene = walk(seed=7)
    rig = scene.rig
    K = np.asarray(rig.K).copy()
    K[2] = np.nan
    known = np.arange(5) != 2
    masked = cf.Rig(K, rig.R, rig.t, rig.image_size, registered=known)
    result = localize_by_evidence(detections, make_scene(masked))
    others = detections[detections.camera != 2]
    numbered = np.searchsorted(np.flatnonzero(known), others.camera)
    without = localize_by_evidence(
        cf.Detections(others.frame, numbered, others.box),
        make_scene(rig.select(np.flatnonzero(known))),
    )
    for name in ("frame", "track_id", "position", "covariance", "existence"):
        np.testing.assert_allclose(getattr(result.tracks, name), getattr(without.tracks, name))
    assert len(result.tracks) > 0
    assert (result.candidates.support[:, 2] == -1).all()
    assert result.tracks.whole_views.max() == 4
    assert (result.tracks.design_sigma > 0).all()


@pytest.mark.slow
def test_one_frame_is_enough_for_positions():
    truth, detections, scene = walk(frames=1, seed=8, clutter=0.0)
    assert_found_alone(truth, localize_by_evidence(detections, scene))


@pytest.mark.slow
def test_a_rolled_and_distorted_rig_is_understood():
    truth, detections, scene = walk(seed=9, rig=make_rig(roll=np.deg2rad(20)))
    assert_found_alone(truth, localize_by_evidence(detections, scene))


def test_no_person_on_the_ground_is_an_error_that_says_so():
    _, _, scene = walk(frames=1)
    sky = cf.Detections([0, 0], [0, 1], [[100, 20, 110, 30], [100, 20, 110, 30.0]])
    with pytest.raises(InsufficientDataError, match="2 boxes"):
        localize_by_evidence(sky, scene)


@pytest.mark.slow
def test_a_blind_frame_of_one_camera_is_not_held_against_people():
    truth, detections, scene = walk(people=8, seed=10, clutter=0.0)
    blind = (detections.camera == 1) & (detections.frame == 5)
    assert_found_alone(truth, localize_by_evidence(detections[~blind], scene))


@cache
def poorly_seen():
    """Two boxes in five are missing, and more than half of the others are false."""
    _, detections, scene = walk(frames=6, seed=12, recall=0.6, clutter=5.0)
    return detections, scene, localize_by_evidence(detections, scene)


@cache
def crowd_beyond(people=10):
    """Simulate a crowd with embeddings that leaves the area covered by the rig."""
    detector = DetectorModel(false_positives=3.0)
    world = make_world("gmvd6", 0, frames=8, people=people, detector=detector)
    return world.detections, world.scene, localize_by_evidence(world.detections, world.scene)


def dense_crowd():
    """Simulate people with embeddings who pass so close that motion alone swaps some."""
    return crowd_beyond(30)


# Each ingredient, a world in which it matters, and its effect there.
INGREDIENTS = {
    "use_misses": (poorly_seen, "who"),
    "self_calibrate": (poorly_seen, "who"),
    "residual_field": (poorly_seen, "position"),
    "local_clutter": (poorly_seen, "existence"),
    "use_height": (poorly_seen, "position"),
    "track": (poorly_seen, "who"),
    "use_appearance": (crowd_beyond, "position"),
    "link_by_looks": (dense_crowd, "position"),
    "working_area": (crowd_beyond, "who"),
    "uneven_ground": (poorly_seen, "covariance"),
    "pose_errors": (poorly_seen, "covariance"),
}


def without(name):
    """Track the ingredient's world with and without it."""
    detections, scene, plain = INGREDIENTS[name][0]()
    other = localize_by_evidence(detections, scene, replace(EvidenceSettings(), **{name: False}))
    assert np.isfinite(other.tracks.position).all()
    return in_place(plain.tracks), in_place(other.tracks)


def in_place(tracks):
    """Sort rows by frame and place, because tracks that begin together are numbered by sigma."""
    return tracks[np.lexsort((*tracks.ground_xy.T, tracks.frame))]


def changes(plain, other):
    """Mark differences of more than a hundredth of the usual deviation, or of certainty."""
    if len(plain) != len(other) or (plain.frame != other.frame).any():
        return {"who"}
    sigma = np.median(plain.sigma)
    sizes = {"position": sigma, "covariance": sigma**2, "existence": 1.0}
    return {
        name
        for name, size in sizes.items()
        if np.abs(getattr(plain, name) - getattr(other, name)).max() > 0.01 * size
    }


def test_every_switch_is_an_ingredient():
    switches = [f.name for f in fields(EvidenceSettings) if isinstance(f.default, bool)]
    assert switches == list(INGREDIENTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", INGREDIENTS)
def test_every_ingredient_can_be_switched_off(name):
    assert INGREDIENTS[name][1] in changes(*without(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uneven_ground", "pose_errors"])
def test_doubts_about_ground_and_poses_widen_ellipses_and_nothing_else(name):
    plain, other = without(name)
    pairs = set(zip(plain.track_id.tolist(), other.track_id.tolist(), strict=True))
    assert len(pairs) == len(set(plain.track_id)) == len(set(other.track_id))
    np.testing.assert_array_equal(plain.position, other.position)
    np.testing.assert_array_equal(plain.existence, other.existence)
    added = np.linalg.eigvalsh(plain.covariance - other.covariance)
    assert added.min() > -1e-12  # both are squares of floats of magnitude one
    assert added.max(1).min() > 0


@pytest.mark.slow
def test_outside_the_working_area_people_are_found_but_not_reported():
    plain, other = without("working_area")
    there = {tuple(row) for row in np.column_stack([other.frame, other.ground_xy])}
    assert {tuple(row) for row in np.column_stack([plain.frame, plain.ground_xy])} < there


@pytest.mark.slow
def test_looks_tell_people_apart():
    truth, detections, scene = walk(people=9, frames=8, seed=13, noise=0.03)
    rng = np.random.default_rng(0)
    looks = rng.standard_normal((40, 16))
    looks = looks[rng.integers(0, 40, len(detections))]
    plain = localize_by_evidence(detections, scene)
    random = cf.Detections(detections.frame, detections.camera, detections.box, embedding=looks)
    # Uninformative embeddings are detected and ignored.
    assert moda(truth, localize_by_evidence(random, scene)) > moda(truth, plain) - 3
