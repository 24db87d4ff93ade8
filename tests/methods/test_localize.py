"""`localize`: equivariance, precision, edge cases, compilation."""

import dataclasses
import logging
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings as hypothesis_settings, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree import Detections, Fate, Rig, Scene, Settings
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry._similarity import Similarity, transform_scene
from catfree.methods.paper._select import suppress_by_frame
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow

PAPER = Settings.paper()
with jax.enable_x64(True):  # makes the scene's rotations exact in float64
    WORLD = make_world("ring6", seed=1, frames=10, people=10)
CAMERAS = 6


def change(settings: Settings, **stages) -> Settings:
    """Replace some fields of some stages of the settings."""
    return dataclasses.replace(
        settings,
        **{
            stage: dataclasses.replace(getattr(settings, stage), **fields)
            for stage, fields in stages.items()
        },
    )


def rows_of(tracks, position) -> np.ndarray:
    """Return frame and position of each row, in an order independent of track numbers."""
    rows = np.column_stack([tracks.frame, position])
    return rows[np.lexsort(np.round(rows.T[::-1], 6))]


def share_of_agreement(tracks, other, position, tolerance: float) -> float:
    """Compute the share of positions with a partner in the other run within the tolerance."""
    paired = 0
    for frame in np.union1d(tracks.frame, other.frame):
        one, two = position[tracks.frame == frame], other.position[other.frame == frame]
        if len(one) and len(two):
            distance = np.linalg.norm(one[:, None] - two[None], axis=-1)
            paired += (distance.min(1) <= tolerance).sum() + (distance.min(0) <= tolerance).sum()
    total = len(tracks) + len(other)
    return paired / total if total else 1.0


def same_identities(tracks, other, moved, tolerance: float) -> float:
    """Compute the share of matched positions whose track agrees with its first position's."""
    partner: dict[int, int] = {}
    agree, total = 0, 0
    for frame in np.intersect1d(tracks.frame, other.frame):
        one = np.flatnonzero(tracks.frame == frame)
        two = np.flatnonzero(other.frame == frame)
        distance = np.linalg.norm(moved[one][:, None] - other.position[two][None], axis=-1)
        for i, j in enumerate(distance.argmin(1)):
            if distance[i, j] <= tolerance:
                a, b = int(tracks.track_id[one[i]]), int(other.track_id[two[j]])
                agree += partner.setdefault(a, b) == b
                total += 1
    return agree / total if total else 1.0


def permuted(detections: Detections, scene: Scene, cameras: np.ndarray, rows: np.ndarray):
    """Reorder rows of the input and renumber camera k to cameras[k]."""
    moved = detections[rows]
    columns = vars(moved) | {"camera": cameras[moved.camera]}
    rig = scene.rig.select(np.argsort(cameras))
    return Detections(**columns), Scene(rig, scene.ground, scene.extent, scene.metric)


@pytest.fixture(scope="module")
def reference():
    with jax.enable_x64(True):
        return cf.localize(WORLD.detections, WORLD.scene, PAPER)


@hypothesis_settings(max_examples=12)
@given(
    st.floats(-3, 3),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(*[st.floats(-100, 100)] * 3),
    st.permutations(range(CAMERAS)),
    st.randoms(),
)
def test_a_similarity_and_any_order_give_the_same_tracks(
    x64, reference, log_scale, quaternion, shift, cameras, random
):
    scale = float(np.exp(log_scale))
    extent = float(WORLD.scene.extent)
    similarity = Similarity(
        scale, Rotation.from_quat(quaternion).as_matrix(), np.array(shift) * extent * scale
    )
    rows = list(range(len(WORLD.detections)))
    random.shuffle(rows)
    moved_scene = transform_scene(similarity, WORLD.scene)
    detections, scene = permuted(WORLD.detections, moved_scene, np.array(cameras), np.array(rows))
    found = cf.localize(detections, scene, PAPER)
    wanted = np.asarray(similarity(reference.tracks.position))
    tolerance = 1e-5 * scale * extent
    assert share_of_agreement(reference.tracks, found.tracks, wanted, tolerance) >= 0.995
    assert same_identities(reference.tracks, found.tracks, wanted, tolerance) >= 0.995
    assert found.candidates.count_by_fate() == reference.candidates.count_by_fate()
    for name in ("tau_sigma", "tau_g"):
        threshold = getattr(reference.thresholds, name)
        np.testing.assert_allclose(getattr(found.thresholds, name), scale * threshold, rtol=1e-6)
    np.testing.assert_allclose(
        np.sort(found.tracks.sigma), scale * np.sort(reference.tracks.sigma), rtol=1e-6
    )


def test_supports_point_at_the_callers_rows(reference):
    """Supporting detections belong to the camera of their column and the frame of their row."""
    candidates, seen = reference.candidates, WORLD.detections
    row, camera = np.nonzero(candidates.support >= 0)
    chosen = candidates.support[row, camera]
    np.testing.assert_array_equal(seen.camera[chosen], camera)
    np.testing.assert_array_equal(seen.frame[chosen], candidates.frame[row])


def test_tracks_are_on_the_ground_and_sorted(reference):
    tracks, ground = reference.tracks, WORLD.scene.ground
    assert len(tracks) > 30
    extent = float(WORLD.scene.extent)
    np.testing.assert_allclose(ground.signed_distance(tracks.position), 0, atol=1e-9 * extent)
    np.testing.assert_allclose(
        tracks.ground_xy, tracks.position @ np.asarray(ground.basis), atol=1e-9 * extent
    )
    order = np.lexsort([tracks.track_id, tracks.frame])
    np.testing.assert_array_equal(order, np.arange(len(tracks)))
    assert len(np.unique(np.column_stack([tracks.frame, tracks.track_id]), axis=0)) == len(tracks)
    np.testing.assert_allclose(
        tracks.sigma, np.sqrt(np.trace(tracks.covariance, axis1=1, axis2=2) / 2), rtol=1e-9
    )


def test_people_are_where_they_are_within_three_stated_deviations(x64, reference):
    tracks, people = reference.tracks, WORLD.walkers.rows(inside_only=False)
    place = np.asarray(WORLD.scene_from_world.inverse()(tracks.position))[:, :2]
    sigma = tracks.sigma / float(WORLD.scene_from_world.scale)
    for frame, xy, deviation in zip(tracks.frame, place, sigma, strict=True):
        away = np.linalg.norm(people[people[:, 0] == frame, 2:] - xy, axis=-1)
        assert away.min() <= 3 * deviation


def test_the_right_rig_finds_no_fewer_people_than_one_that_is_off(x64, reference):
    right = cf.localize(WORLD.detections, WORLD.true_scene, PAPER).tracks
    off = np.asarray(WORLD.scene_from_world.inverse()(reference.tracks.position))[:, :2]
    there, off = (
        cf.evaluation.detection_metrics_in_area(WORLD.ground_truth, rows, WORLD.area).metrics
        for rows in (right.to_rows(), reference.tracks.to_rows(off))
    )
    assert there.moda >= off.moda


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_float32_far_away_is_close_to_float64(reference, scale):
    extent = float(WORLD.scene.extent)
    # A scene of about 20 m, 10 km from the origin.
    shift = scale * extent * np.array([300.0, -400.0, 50.0])
    similarity = Similarity(scale, np.eye(3), shift)
    with jax.enable_x64(True):
        scene = transform_scene(similarity, WORLD.scene)
        wanted = np.asarray(similarity(reference.tracks.position))
    found = cf.localize(WORLD.detections, scene, PAPER)
    # Rays in float32 are exact to 1e-7 rad; decisions at a threshold may differ.
    agreement = share_of_agreement(reference.tracks, found.tracks, wanted, 1e-4 * scale * extent)
    assert agreement >= 0.98


def test_a_rig_of_float32_and_of_jax_arrays(reference):
    rig = WORLD.scene.rig
    narrow = [np.asarray(a, np.float32) for a in (rig.K, rig.R, rig.t)]
    for arrays in (narrow, [jnp.asarray(a) for a in narrow]):
        scene = Scene(
            Rig(arrays[0], arrays[1], arrays[2], rig.image_size),
            WORLD.scene.ground,
            WORLD.scene.extent,
        )
        found = cf.localize(WORLD.detections, scene, PAPER)
        tolerance = 1e-3 * float(scene.extent)
        position = reference.tracks.position
        assert share_of_agreement(reference.tracks, found.tracks, position, tolerance) >= 0.95


# --- edge cases ---------------------------------------------------------------------------------


def first_frames(count: int) -> Detections:
    return WORLD.detections[WORLD.detections.frame < count]


def test_no_detections_at_all():
    found = cf.localize(Detections([], [], []), WORLD.scene, PAPER)
    assert len(found.tracks) == len(found.candidates) == 0
    assert found.thresholds.tau_sigma is None
    assert np.isnan(found.reliability.median_sigma)
    assert found.warnings[0].startswith("There are no boxes, so nobody is found.")


def test_all_scores_below_the_confidence():
    weak = Detections(**(vars(WORLD.detections) | {"score": np.full(len(WORLD.detections), 0.1)}))
    assert len(cf.localize(weak, WORLD.scene, PAPER).candidates) == 0
    for settings in (PAPER, Settings()):
        (warning,) = cf.localize(weak, WORLD.scene, settings).warnings
        none = f"None of the {len(weak)} boxes is used"
        assert warning.startswith(f"{none}: the highest score is 0.1, below the confidence of 0.3")
    trusting = dataclasses.replace(PAPER, confidence=0.05)
    assert len(cf.localize(weak, WORLD.scene, trusting).tracks) > 0


def test_boxes_that_no_setting_or_rig_uses_are_explained():
    seen, scene = WORLD.detections, WORLD.scene
    unsure = Detections(**(vars(seen) | {"ankles_confirmed": np.zeros(len(seen), bool)}))
    strict = change(PAPER, rays={"only_confirmed_ankles": True})
    (warning,) = cf.localize(unsure, scene, strict).warnings
    assert "RaySettings.only_confirmed_ankles" in warning
    apart = dataclasses.replace(scene.rig, registered=np.arange(CAMERAS) < 2)
    other = Scene(apart, scene.ground, scene.extent)
    (warning,) = cf.localize(seen[seen.camera > 1], other, PAPER).warnings
    assert "cameras are not registered" in warning


def test_a_frame_without_detections_ends_tracks_but_not_the_run():
    seen = WORLD.detections[WORLD.detections.frame != 4]
    found = cf.localize(seen, WORLD.scene, change(PAPER, trajectories={"extend": False}))
    assert 4 not in found.tracks.frame
    for track in np.unique(found.tracks.track_id):
        frames = found.tracks.frame[found.tracks.track_id == track]
        assert (frames < 4).all() or (frames > 4).all()


def test_a_single_frame_has_positions_but_no_tracks():
    found = cf.localize(first_frames(1), WORLD.scene, PAPER)
    assert len(found.tracks) == 0
    assert (found.candidates.fate == Fate.TEMPORAL_FILTER).any()
    alone = change(PAPER, trajectories={"enabled": False}, selection={"temporal_frames": 1})
    found = cf.localize(first_frames(1), WORLD.scene, alone)
    assert len(found.tracks) > 0
    assert (found.tracks.track_id == -1).all()


@pytest.mark.parametrize("registered", [0, 1])
def test_fewer_than_two_registered_cameras_is_one_clear_error(registered):
    rig = WORLD.scene.rig
    known = np.arange(CAMERAS) < registered
    few = Rig(rig.K, rig.R, rig.t, rig.image_size, registered=known)
    scene = Scene(few, WORLD.scene.ground, WORLD.scene.extent)
    with pytest.raises(
        InsufficientDataError, match=rf"at least 2 .* has {registered} of {CAMERAS}"
    ):
        cf.localize(WORLD.detections, scene, PAPER)


def test_one_camera_is_one_clear_error():
    scene = Scene(WORLD.scene.rig.select([0]), WORLD.scene.ground, WORLD.scene.extent)
    with pytest.raises(InsufficientDataError, match="at least 2 registered cameras"):
        cf.localize(WORLD.detections[WORLD.detections.camera == 0], scene, PAPER)


def test_a_camera_that_the_rig_does_not_have():
    at = int(np.argmax(WORLD.detections.camera == 5))
    scene = Scene(WORLD.scene.rig.select(range(5)), WORLD.scene.ground, WORLD.scene.extent)
    with pytest.raises(InvalidInputError, match=rf"camera\[{at}\] is 5, but the rig has 5"):
        cf.localize(WORLD.detections, scene, PAPER)


def test_an_unregistered_camera_is_as_good_as_none(reference):
    rig = WORLD.scene.rig
    wrong = [np.array(a) for a in (rig.K, rig.R, rig.t)]
    for array in wrong:
        array[1] = np.nan
    known = np.arange(CAMERAS) != 1
    scene = Scene(
        Rig(wrong[0], wrong[1], wrong[2], rig.image_size, registered=known),
        WORLD.scene.ground,
        WORLD.scene.extent,
    )
    found = cf.localize(WORLD.detections, scene, PAPER)
    assert (found.candidates.support[:, 1] == -1).all()
    assert np.isfinite(found.tracks.position).all()
    without = WORLD.detections[known[WORLD.detections.camera]]
    wanted = cf.localize(without, WORLD.scene, PAPER)
    assert len(wanted.tracks) > 0
    np.testing.assert_array_equal(found.tracks.frame, wanted.tracks.frame)
    np.testing.assert_allclose(found.tracks.position, wanted.tracks.position, atol=1e-4)


def test_two_cameras_and_cameras_without_detections():
    seen = WORLD.detections[np.isin(WORLD.detections.camera, [1, 2])]
    found = cf.localize(seen, WORLD.scene, PAPER)
    assert len(found.tracks) > 0
    assert set(found.tracks.supporting_cameras.tolist()) == {2}


def test_boxes_of_one_camera_only():
    found = cf.localize(WORLD.detections[WORLD.detections.camera == 2], WORLD.scene, PAPER)
    assert len(found.tracks) == len(found.candidates) == 0
    assert "in no frame do two cameras have boxes" in found.warnings[-1]


def test_cameras_that_number_frames_apart_are_told():
    seen = WORLD.detections
    apart = dataclasses.replace(seen, frame=seen.frame + 1000 * seen.camera)
    found = cf.localize(apart, WORLD.scene, PAPER)
    assert "in no frame do two cameras have boxes" in found.warnings[-1]


@pytest.mark.parametrize("without", ["embedding", "ankles_confirmed", "score"])
def test_each_cue_is_optional(without):
    seen = Detections(**(vars(WORLD.detections) | {without: None}))
    assert len(cf.localize(seen, WORLD.scene, PAPER).tracks) > 0


def test_boxes_alone_in_whole_pixels():
    seen = WORLD.detections
    box = np.round(seen.box).astype(int)
    found = cf.localize(Detections(seen.frame, seen.camera, box), WORLD.scene, PAPER)
    assert len(found.tracks) > 0


def test_zero_embeddings_count_as_none():
    nothing = np.zeros((len(WORLD.detections), 4))
    zeros, none = (
        cf.localize(dataclasses.replace(WORLD.detections, embedding=looks), WORLD.scene, PAPER)
        for looks in (nothing, None)
    )
    assert len(zeros.tracks)
    np.testing.assert_array_equal(zeros.tracks.position, none.tracks.position)


def test_doubled_detections_do_not_double_people(reference):
    twice = np.concatenate([np.arange(len(WORLD.detections))] * 2)
    found = cf.localize(WORLD.detections[twice], WORLD.scene, PAPER)
    radius = PAPER.selection.suppression_radius * float(WORLD.scene.extent)
    for frame in np.unique(found.tracks.frame):
        position = found.tracks.position[found.tracks.frame == frame]
        apart = np.linalg.norm(position[:, None] - position[None], axis=-1)
        assert (apart + np.eye(len(apart)) * 2 * radius > radius).all()


def test_lens_distortion_bends_the_rays_back(reference):
    rig = WORLD.scene.rig
    coefficients = np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
    seen = WORLD.detections
    foot = np.empty_like(seen.foot)
    for camera in range(CAMERAS):
        mine = seen.camera == camera
        K = np.asarray(rig.K[camera])
        x, y = ((seen.foot[mine] - K[:2, 2]) / K[[0, 1], [0, 1]]).T
        k1, k2, p1, p2, k3 = coefficients
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        bent = np.column_stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ]
        )
        foot[mine] = bent * K[[0, 1], [0, 1]] + K[:2, 2]
    box = seen.box + (foot - seen.foot)[:, [0, 1, 0, 1]]
    bent_rig = Rig(rig.K, rig.R, rig.t, rig.image_size, np.tile(coefficients, (CAMERAS, 1)))
    scene = Scene(bent_rig, WORLD.scene.ground, WORLD.scene.extent)
    found = cf.localize(Detections(**(vars(seen) | {"box": box})), scene, PAPER)
    position, tolerance = reference.tracks.position, 1e-3 * float(scene.extent)
    assert share_of_agreement(reference.tracks, found.tracks, position, tolerance) >= 0.9


def crowd(cameras: int, frames: int, people: int, seed: int = 0) -> tuple[Detections, Scene]:
    """Make a ring of cameras around standing people, each seen by all, with noise."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, cameras, endpoint=False)
    centers = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.full(cameras, 4.0)])
    forward = -centers / np.linalg.norm(centers, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0, 1])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.tile(np.array([[900.0, 0, 960], [0, 900, 540], [0, 0, 1]]), (cameras, 1, 1))
    rig = Rig(K, R, -np.einsum("cij,cj->ci", R, centers), (1920, 1080))
    place = np.column_stack([rng.uniform(-4, 4, (people, 2)), np.zeros(people)])
    looks = rng.standard_normal((people, 16))
    frame, person, camera = np.meshgrid(
        np.arange(frames), np.arange(people), np.arange(cameras), indexing="ij"
    )
    frame, person, camera = frame.ravel(), person.ravel(), camera.ravel()
    local = np.einsum("nij,nj->ni", R[camera], place[person] - centers[camera])
    pixel = (local[:, :2] / local[:, 2:]) * 900 + [960, 540] + rng.normal(size=(len(frame), 2))
    tall = 1.7 * 900 / local[:, 2]
    box = np.column_stack(
        [pixel[:, 0] - tall / 6, pixel[:, 1] - tall, pixel[:, 0] + tall / 6, pixel[:, 1]]
    )
    embedding = looks[person] + 0.3 * rng.standard_normal((len(frame), 16))
    ground = cf.Plane([0.0, 0, 1], 0.0)
    return Detections(frame, camera, box, embedding=embedding), Scene.from_rig(rig, ground, True)


def test_forty_cameras():
    detections, scene = crowd(40, 3, 5)
    # Every hypothesis is right here, so adaptive gates have nothing to separate.
    found = cf.localize(detections, scene, change(PAPER, selection={"gates": "none"}))
    assert len(found.tracks) == 15
    assert (found.tracks.supporting_cameras >= 35).all()


def test_ten_thousand_detections():
    detections, scene = crowd(CAMERAS, 50, 34)
    assert len(detections) > 10_000
    found = cf.localize(detections, scene, PAPER)
    assert len(found.candidates) > 0
    assert len(np.unique(found.tracks.track_id)) > 17


def test_progress_is_reported_to_the_end():
    calls = []
    cf.localize(WORLD.detections, WORLD.scene, PAPER, lambda *call: calls.append(call))
    assert {"tracklets", "association", "positions", "selection", "trajectories"} <= {
        stage for stage, _, _ in calls
    }
    assert all(0 <= done <= total for _, done, total in calls)
    assert calls[-1] == ("trajectories", 1, 1)


def test_a_sequence_of_another_length_compiles_nothing():
    cf.localize(WORLD.detections, WORLD.scene, PAPER)
    # A sequence without rival hypotheses does not compile their comparison.
    frame, place = np.array([0, 0, 1]), np.zeros((3, 2), np.float32)
    for ranks in (1, 2):
        suppress_by_frame(frame, place, np.ones((3, ranks), np.float32), np.ones(3, bool), 0.5)
    other = make_world(WORLD.layout, seed=8, frames=13, people=9)
    compiled: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            compiled.append(record.getMessage())

    listener, logger = Listener(), logging.getLogger("jax")
    logger.addHandler(listener)
    try:
        with jax.log_compiles(True):
            jax.jit(lambda x: x + 12345)(1)  # the listener records compilations
            heard = sum("Finished XLA compilation" in message for message in compiled)
            compiled.clear()
            cf.localize(other.detections, other.scene, PAPER)
    finally:
        logger.removeHandler(listener)
    assert heard == 1
    assert [message for message in compiled if "Finished XLA compilation" in message] == []


@pytest.mark.parametrize("settings", [Settings(), PAPER])
def test_images_of_another_size_are_told(settings):
    """Return the rig for the videos at half the size."""
    rig = WORLD.scene.rig
    small = Rig(rig.K, rig.R, rig.t, rig.image_size // 2)
    scene = dataclasses.replace(WORLD.scene, rig=small)
    warnings = cf.localize(WORLD.detections, scene, settings).warnings
    assert any("have their center outside its image" in warning for warning in warnings)
    warnings = cf.localize(WORLD.detections, WORLD.scene, settings).warnings
    assert not any("have their center outside" in warning for warning in warnings)


@pytest.mark.parametrize("settings", [Settings(), PAPER])
def test_one_video_under_two_names_is_told(settings):
    boxes = WORLD.detections
    names = [f"gate {camera}" for camera in range(WORLD.scene.rig.camera_count)]
    rows = np.flatnonzero(boxes.camera != 2)
    rows = np.concatenate([rows, np.flatnonzero(boxes.camera == 0)[::-1]])
    camera = boxes.camera[rows]
    camera[len(rows) - (boxes.camera == 0).sum() :] = 2
    twice = dataclasses.replace(boxes[rows], camera=camera)
    said = re.compile(
        "Cameras 'gate 0' and 'gate 2' have the same [0-9]+ boxes: one video was read"
    )
    warnings = cf.localize(twice, WORLD.scene, settings, camera_names=names).warnings
    assert any(said.match(warning) for warning in warnings)
    assert not any("read twice" in w for w in cf.localize(boxes, WORLD.scene, settings).warnings)


@pytest.mark.parametrize("settings", [Settings(), PAPER], ids=["evidence", "paper"])
def test_a_frozen_camera_is_told(settings):
    boxes, said = WORLD.detections, "Camera 1 has exactly the same boxes"
    frames = np.unique(boxes.frame)
    picture = np.flatnonzero((boxes.camera == 1) & (boxes.frame == frames[0]))
    rows = np.concatenate([np.flatnonzero(boxes.camera != 1), np.tile(picture, len(frames))])
    frame = boxes.frame[rows]
    frame[boxes.camera[rows] == 1] = np.repeat(frames, len(picture))
    frozen = dataclasses.replace(boxes[rows], frame=frame)
    warnings = cf.localize(frozen, WORLD.scene, settings).warnings
    assert any(warning.startswith(said) for warning in warnings)
    warnings = cf.localize(boxes, WORLD.scene, settings).warnings
    assert not any("exactly the same" in warning for warning in warnings)


@pytest.mark.parametrize("settings", [Settings(), PAPER], ids=["evidence", "paper"])
def test_a_metric_scene_of_higher_cameras_than_people_can_be_seen_from_is_told(settings):
    rig, ground = WORLD.scene.rig, WORLD.scene.ground
    people = cf.localize(WORLD.detections, WORLD.scene, settings)
    factor = 1000 / float(np.max(ground.signed_distance(rig.centers)))  # claims kilometers
    rig = Rig(rig.K, rig.R, rig.t * factor, rig.image_size)
    ground = cf.Plane(ground.normal, ground.offset * factor)
    told = [
        cf.localize(
            WORLD.detections, Scene(rig, ground, WORLD.scene.extent * factor, metric), settings
        )
        for metric in (False, True)
    ]
    sentence = re.compile(r"Camera \d is 1000 m above the ground, but cameras that show people")
    assert not any(map(sentence.match, people.warnings + told[0].warnings))
    assert sum(sentence.match(w) is not None for w in told[1].warnings) == 1
