"""Links of results: the boxes of each position, and how fast people walk."""

from functools import cache

import jax
import numpy as np
import pytest
from hypothesis import given, settings as hypothesis_settings, strategies as st

import catfree as cf
from catfree import Detections, Origin, Scene, Settings
from catfree.synthetic import make_world
from tests.known_sequences import sequence_of

pytestmark = pytest.mark.slow

METHODS = {"evidence": Settings(), "paper": Settings.paper()}
BOTH = pytest.mark.parametrize("method", METHODS)
CAMERAS = 6


@cache
def world():
    with jax.enable_x64(True):
        return make_world("ring6", seed=1, frames=12, people=10)


@cache
def found(method: str) -> cf.Localization:
    with jax.enable_x64(True):
        return cf.localize(world().detections, world().scene, METHODS[method])


@BOTH
def test_support_is_of_the_frame_and_the_camera(method):
    tracks, seen = found(method).tracks, world().detections
    row, camera = np.nonzero(tracks.support >= 0)
    boxes = tracks.support[row, camera]
    assert tracks.support.shape == (len(tracks), CAMERAS)
    assert len(boxes) > 2 * len(tracks)
    np.testing.assert_array_equal(seen.frame[boxes], tracks.frame[row])
    np.testing.assert_array_equal(seen.camera[boxes], camera)


@BOTH
def test_a_detection_shows_one_person(method):
    localization = found(method)
    tracks, identity = localization.tracks, localization.identity
    row, camera = np.nonzero(tracks.support >= 0)
    boxes = tracks.support[row, camera]
    assert len(np.unique(boxes)) == len(boxes)
    assert identity.shape == (len(world().detections),)
    np.testing.assert_array_equal(identity[boxes], tracks.track_id[row])
    assert (np.delete(identity, boxes) == -1).all()


@BOTH
def test_boxes_of_one_track_show_one_person(method):
    """The evidence method links all of them; the paper's method links most."""
    identity, truth = found(method).identity, world().identities
    for track in np.unique(identity[identity >= 0]):
        mine = identity == track
        most = np.unique(truth[mine], return_counts=True)[1].max()
        assert most == mine.sum() if method == "evidence" else most > mine.sum() / 2


def test_cameras_are_counted_by_their_boxes():
    tracks = found("evidence").tracks
    np.testing.assert_array_equal((tracks.support >= 0).sum(1), tracks.supporting_cameras)
    gap = tracks.origin == Origin.INTERPOLATED
    assert (tracks.support[gap] == -1).all()
    # The paper's positions may share a ray, which counts only for the nearer one.
    tracks = found("paper").tracks
    assert ((tracks.support >= 0).sum(1) <= tracks.supporting_cameras).all()


@BOTH
def test_boxes_that_take_no_part_belong_to_nobody(method):
    """Interspersed boxes below the confidence shift no row and have no identity."""
    boxes, rng = world().detections, np.random.default_rng(0)
    weak = rng.permutation(len(boxes) + 50) >= len(boxes)
    at = np.cumsum(~weak) - 1
    columns = {name: v if v is None else v[at] for name, v in vars(boxes).items()}
    columns["score"] = np.where(weak, 0.0, columns["score"])
    with jax.enable_x64(True):
        more = cf.localize(Detections(**columns), world().scene, METHODS[method])
    np.testing.assert_array_equal(more.identity[~weak], found(method).identity)
    assert (more.identity[weak] == -1).all()


# --- order ---------------------------------------------------------------------------------------


def permuted(detections: Detections, scene: Scene, cameras: np.ndarray, rows: np.ndarray):
    """Reorder rows of the input and renumber camera k to cameras[k]."""
    moved = detections[rows]
    columns = vars(moved) | {"camera": cameras[moved.camera]}
    rig = scene.rig.select(np.argsort(cameras))
    return Detections(**columns), Scene(rig, scene.ground, scene.extent, scene.metric)


def assert_the_same(one: cf.Localization, two: cf.Localization, cameras, rows, scale) -> None:
    """Check that tracks agree row for row, with support indexing the first one's detections."""
    a, b = one.tracks, two.tracks
    np.testing.assert_array_equal(a.frame, b.frame)
    np.testing.assert_array_equal(a.track_id, b.track_id)
    np.testing.assert_allclose(a.position, b.position, atol=1e-9 * scale)
    np.testing.assert_allclose(a.velocity, b.velocity, atol=1e-9 * scale)
    support = np.where(b.support >= 0, rows[b.support], -1)[:, cameras]
    np.testing.assert_array_equal(a.support, support)
    np.testing.assert_array_equal(one.identity[rows], two.identity)


@BOTH
@hypothesis_settings(max_examples=5)
@given(st.permutations(range(CAMERAS)), st.integers(0, 2**32 - 1))
def test_the_order_of_cameras_and_boxes_changes_no_number(method, cameras, seed):
    cameras = np.array(cameras)
    rows = np.random.default_rng(seed).permutation(len(world().detections))
    with jax.enable_x64(True):
        moved = permuted(world().detections, world().scene, cameras, rows)
        again = cf.localize(*moved, METHODS[method])
    assert_the_same(found(method), again, cameras, rows, float(world().scene.extent))


@pytest.mark.parametrize(("name", "frames"), [("cmc3", 72), ("wildtrack_0_715", 16)])
def test_the_order_of_real_cameras_changes_no_number(shared, name, frames):
    sequence = sequence_of(shared / "data", name)
    boxes = sequence.detections
    boxes = boxes[np.isin(boxes.frame, np.unique(boxes.frame)[:frames])]
    once = cf.localize(boxes, sequence.scene)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        cameras = rng.permutation(sequence.scene.rig.camera_count)
        rows = rng.permutation(len(boxes))
        again = cf.localize(*permuted(boxes, sequence.scene, cameras, rows))
        assert_the_same(once, again, cameras, rows, float(sequence.scene.extent))


# --- velocity ------------------------------------------------------------------------------------


def straight_walk(step: int) -> tuple[Detections, Scene, np.ndarray, np.ndarray]:
    """Simulate five people who walk straight through the middle at 0.6 m per `step` frames.

    Returns:
        The boxes; the scene, in meters; (F, 5, 2) where they are; (5, 2) velocity per frame number.
    """
    rig, rng = world().true_rig, np.random.default_rng(0)
    angle = 2 * np.pi * np.arange(5) / 5
    ahead = np.stack([np.cos(angle), np.sin(angle)], -1)
    beside = np.stack([-np.sin(angle), np.cos(angle)], -1)
    time = np.arange(12)
    place = 1.5 * beside + 0.6 * (time - 5.5)[:, None, None] * ahead
    rows = []
    for frame, camera, person in np.ndindex(len(time), rig.camera_count, 5):
        K, R, t = (np.asarray(values, np.float64)[camera] for values in (rig.K, rig.R, rig.t))
        ends = np.array([[*place[frame, person], 0.0], [*place[frame, person], 1.75]]) @ R.T + t
        pixel = ends @ K.T
        (u, bottom), (_, top) = pixel[:, :2] / pixel[:, 2:]
        tall = bottom - top
        box = np.array([u - 0.2 * tall, top, u + 0.2 * tall, bottom])
        inside = (box[:2] > 0).all() and (box[2:] < rig.image_size[camera] - 1).all()
        if ends[:, 2].min() > 0.5 and inside:
            rows.append([step * frame, camera, *(box + 0.01 * tall * rng.standard_normal(4))])
    frame, camera, *box = np.array(rows).T
    boxes = Detections(frame.astype(int), camera.astype(int), np.stack(box, -1))
    return boxes, world().true_scene, place, 0.6 * ahead / step


@BOTH
@pytest.mark.parametrize("step", [1, 5])
def test_velocities_are_those_of_people_who_walk_straight_on(method, step):
    boxes, scene, place, velocity = straight_walk(step)
    tracks = cf.localize(boxes, scene, METHODS[method]).tracks
    away = place[tracks.frame // step] - tracks.ground_xy[:, None]
    person = np.linalg.norm(away, axis=-1).argmin(1)
    assert len(tracks) > 40
    assert set(person) == set(range(5))
    offset = tracks.velocity - velocity[person]
    speed = 0.6 / step
    assert np.median(np.linalg.norm(offset, axis=-1)) < 0.2 * speed
    # They also match the changes of the positions.
    for one in np.unique(tracks.track_id):
        own = tracks[tracks.track_id == one]
        if len(own) > 6:
            way = (own.ground_xy[-1] - own.ground_xy[0]) / (own.frame[-1] - own.frame[0])
            assert np.linalg.norm(own.velocity.mean(0) - way) < 0.2 * speed
    # The stated errors have the size of the true ones; the paper's angular noise is that of real
    # boxes, whatever the noise of these.
    known = np.isfinite(tracks.velocity_covariance).all((1, 2))
    inverse = np.linalg.inv(tracks.velocity_covariance[known])
    square = np.einsum("ni,nij,nj->n", offset[known], inverse, offset[known])
    assert square.mean() / 2 < 5
    assert method == "paper" or square.mean() / 2 > 0.1


@BOTH
def test_covariances_of_velocities_are_covariances(method):
    spread = found(method).tracks.velocity_covariance
    spread = spread[np.isfinite(spread).all((1, 2))]
    assert len(spread) > 20
    np.testing.assert_allclose(spread, spread.swapaxes(1, 2), rtol=1e-6, atol=1e-15)
    assert (np.linalg.eigvalsh(spread) > 0).all()


def test_one_instant_has_no_velocity():
    boxes = world().detections
    for settings in METHODS.values():
        tracks = cf.localize(boxes[boxes.frame == 3], world().scene, settings).tracks
        assert np.isnan(tracks.velocity).all()
        assert np.isnan(tracks.velocity_covariance).all()
    assert len(cf.localize(boxes[boxes.frame == 3], world().scene).tracks) > 3


def test_velocity_is_per_frame_number_and_tracks_keep_the_clock():
    boxes = world().detections
    columns = vars(boxes) | {"frame": 10 * boxes.frame + 7}
    for method, settings in METHODS.items():
        columns["clock"] = cf.Clock(2, utc=True)
        with jax.enable_x64(True):
            slow = cf.localize(Detections(**columns), world().scene, settings).tracks
        assert slow.clock == columns["clock"]
        fast = found(method).tracks
        np.testing.assert_allclose(10 * slow.velocity, fast.velocity, rtol=1e-9)
        np.testing.assert_allclose(
            100 * slow.velocity_covariance, fast.velocity_covariance, rtol=1e-9
        )


@BOTH
def test_nobody_is_on_a_clock_too(method):
    boxes = Detections([], [], [], clock=cf.Clock(2))
    assert cf.localize(boxes, world().scene, METHODS[method]).tracks.clock == cf.Clock(2)
