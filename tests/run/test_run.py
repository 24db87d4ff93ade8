"""From pictures to tracks: stages work together, resume after a kill, fail with one sentence."""

import multiprocessing
import os
import signal
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

import catfree as cf
from catfree._run import (
    _cache as cache_module,
    _input_checks as input_checks,
    _stages as stages_module,
)
from catfree._run._cache import StageCache, content_hash
from catfree._run._result_folder import write_results
from catfree._run._run import run, run_stages
from catfree._run.detection._cached_detection import PIECE, detect_with_cache
from catfree._run.detection._camera_detectors import CameraDetectors
from catfree.adapters import (
    BackgroundDetector,
    ColorEmbedder,
    FrameDetections,
    SynchronizedVideos,
)
from catfree.adapters.datasets._detection_files import CameraBoxes, read_camera_boxes
from catfree.calibration import KnownCamera, remove_offsets
from catfree.errors import (
    CalibrationError,
    CatFreeError,
    InsufficientDataError,
    InvalidInputError,
)
from catfree.methods._localize import localize
from catfree.settings import CalibrationSettings, EvidenceSettings, Settings
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Clock, Detections, Scene
from tests.known_calibration import calibration_of

FRAMES, CAMERAS, SIZE = 2 * PIECE + 5, 3, (320, 180)


@cache
def small_world():
    return make_world(ring(CAMERAS, image_size=SIZE, people=4), frames=FRAMES, people=4)


class ReadsItsPicture:
    """A detector for pictures whose first pixel contains frame and camera."""

    def __init__(self, detections, *, dies_at=None, score=0.9, name="reads its picture"):
        self.detections, self.dies_at, self.score = detections, dies_at, score
        self.fingerprint = name
        self.calls = 0

    def __call__(self, image):
        self.calls += 1
        if self.calls == self.dies_at:
            os.kill(os.getpid(), signal.SIGKILL)
        frame, camera, _ = (int(value) for value in image[0, 0])
        rows = (self.detections.frame == frame) & (self.detections.camera == camera)
        box = self.detections.box[rows]
        return FrameDetections(box, np.full(len(box), self.score))


def detect(videos, detector, embedder=None, cache=None, **options):
    with CameraDetectors(videos, detector, cache, **options) as cameras:
        return detect_with_cache(cameras, embedder)


class Unused:
    """A reconstructor that is never called."""

    fingerprint = "unused"

    def __call__(self, images):
        raise AssertionError("called")


def write_pictures(folder, world, frames=FRAMES, size=SIZE):
    """Draw noise whose first pixel contains frame and camera, in red and green."""
    rng = np.random.default_rng(0)
    for camera in range(CAMERAS):
        (folder / f"camera {camera}").mkdir(parents=True)
        for frame in range(frames):
            image = rng.integers(0, 255, (size[1] // 8, size[0] // 8, 3), np.uint8)
            image = cv2.resize(image, size)
            image[0, 0] = (0, camera, frame)  # blue, green, red
            cv2.imwrite(str(folder / f"camera {camera}/{frame:03d}.png"), image)
    return [folder / f"camera {camera}" for camera in range(CAMERAS)]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return write_pictures(tmp_path_factory.mktemp("pictures"), small_world())


def same_content(one, other):
    return content_hash(one) == content_hash(other)


@pytest.mark.slow
def test_run_is_detection_and_localization_with_a_known_scene(pictures, tmp_path):
    world = small_world()
    detector, stages = ReadsItsPicture(world.detections), []
    outcome = run_stages(
        pictures,
        detector,
        scene=world.scene,
        settings=Settings.paper(),
        cache_dir=tmp_path,
        progress=lambda stage, done, total: stages.append(stage),
    )
    assert detector.calls == FRAMES * CAMERAS
    assert len(outcome.detections) == len(world.detections)
    alone = localize(outcome.detections, world.scene, Settings.paper())
    assert same_content(outcome.localization, alone)
    assert same_content(outcome.scene, world.scene)
    assert outcome.calibration is None
    assert outcome.camera_names == ("camera 0", "camera 1", "camera 2")
    assert len(outcome.localization.tracks) > 0
    assert stages[0] == "detect"

    # Everything is cached: no detection, and the same result.
    again = ReadsItsPicture(world.detections)
    found = run(pictures, again, scene=world.scene, settings=Settings.paper(), cache_dir=tmp_path)
    assert same_content(found, outcome.localization)
    assert again.calls == 0


@pytest.mark.slow
def test_a_camera_that_fails_halfway_takes_nobody_with_it(tmp_path):
    """Missing pictures are not evidence."""
    frames, half, size = 60, 30, (640, 360)
    world = make_world(ring(CAMERAS, image_size=size, people=4), frames=frames, people=4)
    folders = write_pictures(tmp_path, world, frames, size)
    for late in sorted(folders[1].glob("*.png"))[half:]:
        late.unlink()
    detector = ReadsItsPicture(world.detections)
    outcome = run_stages(folders, detector, scene=world.scene)
    assert detector.calls == 2 * frames + half
    silent = [[frame, 1] for frame in range(half, frames)]
    assert outcome.videos.silent.tolist() == silent
    tracks = outcome.localization.tracks
    alone = localize(outcome.detections, world.scene, silent=silent).tracks
    np.testing.assert_array_equal(tracks.position, alone.position)
    late = (tracks.frame >= half).sum()
    assert late > 0.8 * (world.ground_truth[:, 0] >= half).sum()
    unsaid = localize(outcome.detections, world.scene).tracks
    assert late >= (unsaid.frame >= half).sum()
    (said,) = [text for text in outcome.warnings if "'camera 1' has no picture of" in text]
    assert f"has no picture of {frames - half} of {frames} instants" in said
    for _ in range(2):
        cached = run(folders, detector, scene=world.scene, cache_dir=tmp_path / "cache")
        assert same_content(cached, outcome.localization)
    # Videos opened by the caller deliver the instants they were opened with.
    complete = run(SynchronizedVideos(folders), detector, scene=world.scene)
    assert complete.tracks.frame.max() < half


@pytest.mark.slow
def test_cameras_are_calibrated_from_instants_that_all_show(tmp_path, monkeypatch):
    world = small_world()
    folders = write_pictures(tmp_path, world)
    for late in sorted(folders[1].glob("*.png"))[FRAMES // 2 :]:
        late.unlink()
    given = []

    def note(detections, *args, **options):
        given.append(detections)
        raise CalibrationError("that is enough")

    monkeypatch.setattr(stages_module, "register", note)
    with pytest.raises(CalibrationError, match="that is enough"):
        run(folders, ReadsItsPicture(world.detections))
    assert given[0].frame.max() < FRAMES // 2


@pytest.mark.slow
def test_pieces_from_the_cache_are_what_one_pass_gives(pictures, tmp_path):
    world, videos = small_world(), SynchronizedVideos(pictures)
    embedder = ColorEmbedder()
    whole = detect(videos, ReadsItsPicture(world.detections), embedder)
    stages = StageCache(tmp_path)
    assert same_content(
        whole, detect(videos, ReadsItsPicture(world.detections), embedder, cache=stages)
    )
    # A piece in the middle is lost, so only that piece is detected again.
    lost = sorted(tmp_path.glob("boxes-*"))[0]
    lost.unlink()
    detector = ReadsItsPicture(world.detections)
    assert same_content(whole, detect(videos, detector, embedder, cache=stages))
    assert detector.calls in (PIECE * CAMERAS, (FRAMES - 2 * PIECE) * CAMERAS)
    # Without an embedder the cached boxes suffice, with no detection.
    detector = ReadsItsPicture(world.detections)
    bare = detect(videos, detector, cache=stages)
    assert detector.calls == 0
    assert bare.embedding is None
    np.testing.assert_array_equal(bare.box, whole.box)


class Grows(ColorEmbedder):
    """Return rows of another length after the first piece."""

    def __init__(self):
        self.calls = 0

    def __call__(self, image, box):
        self.calls += 1
        return np.ones((len(box), 3 if self.calls <= PIECE * CAMERAS else 4))


@pytest.mark.slow
def test_answers_are_checked_over_all_pieces(pictures, tmp_path):
    world, videos = small_world(), SynchronizedVideos(pictures)
    for options in ({}, {"cache": StageCache(tmp_path)}):
        with pytest.raises(InvalidInputError, match=r"Grows, called for camera .*\(\d+, 3\)"):
            detect(videos, ReadsItsPicture(world.detections), Grows(), **options)


@pytest.mark.slow
def test_other_content_is_never_reused(pictures, tmp_path):
    world, stages = small_world(), StageCache(tmp_path)
    videos = SynchronizedVideos(pictures)
    detect(videos, ReadsItsPicture(world.detections), cache=stages)
    for other_videos, name in (
        (videos, "other weights"),
        (SynchronizedVideos(pictures, start=1), "reads its picture"),
        (SynchronizedVideos(pictures[::-1]), "reads its picture"),
    ):
        detector = ReadsItsPicture(world.detections, name=name)
        detect(other_videos, detector, cache=stages)
        assert detector.calls == other_videos.frame_count * CAMERAS


def _detect_until_killed(paths, folder, dies_at):
    detector = ReadsItsPicture(small_world().detections, dies_at=dies_at)
    detect(SynchronizedVideos(paths), detector, ColorEmbedder(), cache=StageCache(folder))


def _die_before_the_rename(paths, folder):
    def replace(source, target):
        os.kill(os.getpid(), signal.SIGKILL)

    os.replace = replace
    _detect_until_killed(paths, folder, None)


def killed(function, *arguments):
    process = multiprocessing.get_context("spawn").Process(target=function, args=arguments)
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(pictures, tmp_path):
    world, videos = small_world(), SynchronizedVideos(pictures)
    whole = detect(videos, ReadsItsPicture(world.detections), ColorEmbedder())
    assert killed(_die_before_the_rename, pictures, tmp_path)
    assert [p for p in tmp_path.glob("*.npz") if not p.name.startswith(".")] == []
    assert killed(_detect_until_killed, pictures, tmp_path, (PIECE + 3) * CAMERAS)
    detector = ReadsItsPicture(world.detections)
    resumed = detect(videos, detector, ColorEmbedder(), cache=StageCache(tmp_path))
    assert detector.calls == (FRAMES - PIECE) * CAMERAS
    assert same_content(whole, resumed)


@pytest.mark.slow
def test_pieces_without_people_agree_with_one_pass(pictures, tmp_path):
    videos = SynchronizedVideos(pictures)
    seen = small_world().detections
    for some in (seen[seen.frame < 3], seen[:0]):
        folder = tmp_path / str(len(some))
        name = f"sees {len(some)}"
        whole = detect(videos, ReadsItsPicture(some, name=name), ColorEmbedder())
        pieces = detect(
            videos, ReadsItsPicture(some, name=name), ColorEmbedder(), cache=StageCache(folder)
        )
        assert same_content(whole, pieces)


@pytest.mark.slow
def test_every_way_through_the_stages_keeps_the_clock(pictures, tmp_path):
    world, videos = small_world(), SynchronizedVideos(pictures, frame_rate=5)
    outcomes = [
        cf.run_stages(videos, ReadsItsPicture(world.detections), scene=world.scene, cache_dir=place)
        for place in (None, tmp_path / "cache", tmp_path / "cache")
    ]
    cf.write_results(tmp_path / "out", outcomes[0], pictures=False)
    found = [one.localization.tracks for one in outcomes]
    found.append(cf.read_results(tmp_path / "out")[0].tracks)
    found.append(cf.adapters.read_tracks_csv(tmp_path / "out" / "tracks.csv"))
    found.append(cf.adapters.read_tracks_parquet(tmp_path / "out" / "tracks.parquet"))
    assert [tracks.clock for tracks in found] == [cf.Clock(5)] * 6
    assert [one.detections.clock for one in outcomes] == [cf.Clock(5)] * 3
    assert len(found[0])
    report = (tmp_path / "out" / "report.md").read_text()
    assert "Frame 0 is at 0.000 s, and there are 5 per second." in report
    assert "dropped frames" in report
    assert "There are no times for the frames of camera" in report


@pytest.mark.slow
def test_damaged_footage_is_kept_up_to_the_damage(tmp_path):
    world = small_world()
    paths = write_pictures(tmp_path / "pictures", world)
    (paths[1] / f"{PIECE + 4:03d}.png").write_bytes(b"no picture")
    videos = SynchronizedVideos(paths, on_error="keep")
    detector = ReadsItsPicture(world.detections)
    found = detect(videos, detector, cache=StageCache(tmp_path / "cache"))
    assert videos.interruption is not None
    assert found.frame.max() == PIECE + 3
    # The incomplete piece is not stored as complete.
    again = ReadsItsPicture(world.detections)
    assert same_content(found, detect(videos, again, cache=StageCache(tmp_path / "cache")))
    assert again.calls == 4 * CAMERAS
    # With and without a cache, the run ends there.
    for place in (None, tmp_path / "cache"):
        outcome = run_stages(videos, detector, scene=world.scene, cache_dir=place)
        np.testing.assert_array_equal(outcome.frames, np.arange(PIECE + 4))
        said = [text for text in outcome.warnings if "before the damage" in text]
        assert len(said) == 1
        assert f"{PIECE + 4} of {FRAMES} instants: Camera 1 ('camera 1')" in said[0]


@pytest.mark.slow
def test_wrong_input_is_one_sentence(pictures, tmp_path):
    world = small_world()
    detector = ReadsItsPicture(world.detections)
    with pytest.raises(InvalidInputError, match="There are 2 videos for 3 cameras"):
        run(pictures[:2], detector, scene=world.scene)
    rig = world.scene.rig
    other = type(rig)(rig.K, rig.R, rig.t, (640, 360))
    with pytest.raises(InvalidInputError, match=r"^Camera 'camera 0' has.*320 x 180.*640 x 360"):
        run(pictures, detector, scene=Scene(other, world.scene.ground, world.scene.extent))
    with pytest.raises(InvalidInputError, match="not both"):
        run(pictures, detector, reconstructor=Unused(), scene=world.scene)
    nameless = ReadsItsPicture(world.detections, name="")
    with pytest.raises(InvalidInputError, match="ReadsItsPicture has no fingerprint"):
        run(pictures, nameless, scene=world.scene, cache_dir=tmp_path)


@pytest.mark.slow
def test_videos_must_be_a_list_with_videos(pictures):
    for videos in ([], str(pictures[0])):
        with pytest.raises(InvalidInputError, match=r"^videos must list one video file"):
            run(videos)


@pytest.mark.slow
def test_nobody_to_calibrate_from(pictures):
    nobody = ReadsItsPicture(small_world().detections[:0])
    with pytest.raises((CalibrationError, InsufficientDataError)):
        run(pictures, nobody)


@pytest.mark.slow
def test_doubtful_boxes_do_not_calibrate(pictures):
    doubtful = ReadsItsPicture(small_world().detections, score=0.5)
    with pytest.raises((CalibrationError, InsufficientDataError)):
        run(pictures, doubtful)


@pytest.mark.slow
def test_the_calibration_gets_the_settings_of_the_run(pictures, monkeypatch):
    given = []

    def begin(detections, image_size, settings, **options):
        given.append(settings)
        return made_up_calibration([0, 0, 0])

    def finish(begun, detections, settings, **options):
        given.append((detections, settings))
        raise CalibrationError("pretended")

    monkeypatch.setattr(stages_module, "register", begin)
    monkeypatch.setattr(stages_module, "refine_registered", finish)
    detector = ReadsItsPicture(small_world().detections, score=0.5)
    rules = Settings(
        calibration_confidence=0.4,
        calibration=CalibrationSettings(person_height=1.2, maximum_frames=7),
        evidence=EvidenceSettings(passes=2),
    )
    drawn_tight = replace(rules, calibration=replace(rules.calibration, box_slack=0.01))
    for settings, slack, states in (
        (rules, CalibrationSettings.box_slack, False),
        (rules, 0.0, True),
        (drawn_tight, 0.01, True),
    ):
        if states:
            detector.box_slack = 0.0
        with pytest.raises(CalibrationError, match="pretended"):
            run(pictures, detector, settings=settings)
        detections, found = given[-1]
        assert len(detections) == len(small_world().detections)
        assert found.confidence == 0.4
        assert given[-2] == found.calibration
        assert found.evidence == rules.evidence
        assert found.calibration == replace(settings.calibration, box_slack=slack)


def test_a_full_disk_stops_the_run_with_a_sentence(pictures, tmp_path, monkeypatch):
    def full(path, kind, arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache_module, "save_arrays", full)
    world = small_world()
    with pytest.raises(CatFreeError, match=r"No space left on device.*Free some space"):
        run(pictures, ReadsItsPicture(world.detections), scene=world.scene, cache_dir=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_detections_type_is_what_users_get(pictures):
    found = detect(SynchronizedVideos(pictures, end=2), ReadsItsPicture(small_world().detections))
    assert isinstance(found, Detections)
    assert set(found.frame) <= {0, 1}


class Interrupts(ReadsItsPicture):
    """A detector interrupted by Ctrl-C."""

    def __call__(self, image):
        if self.calls == (PIECE + 1) * CAMERAS:
            raise KeyboardInterrupt
        return super().__call__(image)


@pytest.mark.slow
def test_ctrl_c_leaves_finished_pieces_in_the_cache(pictures, tmp_path):
    world, videos = small_world(), SynchronizedVideos(pictures)
    with pytest.raises(KeyboardInterrupt):
        detect(videos, Interrupts(world.detections), cache=StageCache(tmp_path))
    detector = ReadsItsPicture(world.detections)
    detect(videos, detector, cache=StageCache(tmp_path))
    assert detector.calls == (FRAMES - PIECE) * CAMERAS


@pytest.mark.slow
def test_learned_backgrounds_are_kept(tmp_path):
    rng = np.random.default_rng(0)
    for camera in range(2):
        (tmp_path / str(camera)).mkdir()
        empty = rng.integers(90, 110, (90, 160, 3)).astype(np.uint8)
        for frame in range(10):
            image = empty.copy()
            image[30:70, 10 * frame : 10 * frame + 14] = 250  # a person walks by
            cv2.imwrite(str(tmp_path / f"{camera}/{frame}.png"), image)
    videos = SynchronizedVideos([tmp_path / "0", tmp_path / "1"])
    stages, fits = StageCache(tmp_path / "cache"), []

    def count(stage, done, total):
        fits.append((stage, total))

    first = CameraDetectors(videos, BackgroundDetector(), stages, count).fitted
    assert fits == [("fit", 20)] * 20
    next(iter(stages.folder.glob("background-*"))).unlink()
    fits.clear()
    again = CameraDetectors(videos, BackgroundDetector(), stages, count).fitted
    assert fits == [("fit", 10)] * 10  # one camera
    for camera, (one, other) in enumerate(zip(first, again, strict=True)):
        assert one.fingerprint == other.fingerprint
        for image in videos.pictures_of(camera):
            np.testing.assert_array_equal(one(image).box, other(image).box)
            np.testing.assert_array_equal(one(image).score, other(image).score)
    assert sum(len(first[0](image)) for image in videos.pictures_of(0)) > 0


def made_up_calibration(offset):
    return calibration_of(small_world().scene, frame_offset=np.array(offset))


@pytest.mark.slow
def test_a_calibration_killed_in_its_second_half_keeps_the_first(pictures, tmp_path, monkeypatch):
    steps = []

    def begin(*arguments, **options):
        steps.append("begin")
        return made_up_calibration([0, 0, 0])

    def finish(begun, *arguments, **options):
        steps.append("finish")
        if steps.count("finish") == 1:
            raise KeyboardInterrupt
        return begun

    monkeypatch.setattr(stages_module, "register", begin)
    monkeypatch.setattr(stages_module, "refine_registered", finish)
    detector = ReadsItsPicture(small_world().detections)
    with pytest.raises(KeyboardInterrupt):
        run(pictures, detector, settings=Settings.paper(), cache_dir=tmp_path)
    for _ in range(2):
        run(pictures, detector, settings=Settings.paper(), cache_dir=tmp_path)
    assert steps == ["begin", "finish", "finish"]


@pytest.mark.slow
def test_clock_offsets_are_removed_and_stated(pictures, tmp_path, monkeypatch):
    world = small_world()
    asked = []

    def pretend(*_, maximum_offset, **__):
        asked.append(maximum_offset)
        return made_up_calibration([0, -10, 0])

    begun = made_up_calibration([0, 0, 0])
    monkeypatch.setattr(stages_module, "register", lambda *_, **__: begun)
    monkeypatch.setattr(stages_module, "refine_registered", pretend)
    settings = Settings.paper()
    outcome = run_stages(
        pictures, ReadsItsPicture(world.detections), settings=settings, maximum_offset=12
    )
    assert asked == [12]
    # Before the late camera began, the others locate people without it.
    np.testing.assert_array_equal(outcome.frames, np.arange(FRAMES))
    assert outcome.videos.silent.tolist() == [[frame, 1] for frame in range(10)]
    moved = remove_offsets(world.detections, np.array([0, -10, 0]))
    moved = moved[moved.frame < FRAMES]
    assert len(outcome.detections) == len(moved)
    alone = localize(outcome.detections, world.scene, settings)
    np.testing.assert_array_equal(outcome.localization.tracks.position, alone.tracks.position)
    assert outcome.warnings == (
        "Camera 'camera 1' was found to have started about 10 frames after the others; its clock "
        "was corrected by that.",
    )
    # The outcome's pictures are those in which its boxes were found.
    frame, images = next(outcome.videos.instants_from(10))
    assert [frame, *(image[0, 0, 0] for image in images)] == [10, 10, 0, 10]
    # The results record it for later use of boxes and videos.
    write_results(tmp_path, outcome, settings, pictures=False)
    boxes = read_camera_boxes(tmp_path)
    assert boxes.offsets == outcome.videos.offsets == (0, -10, 0)
    np.testing.assert_array_equal(boxes.silent, outcome.silent)
    localized = run_stages(boxes, scene=tmp_path / "scene.json", settings=settings)
    assert localized.offsets == boxes.offsets
    again = run_stages(boxes, settings=settings, maximum_offset=12)
    assert again.offsets == (0, -20, 0)


@pytest.mark.slow
def test_boxes_that_are_no_people_explain_a_failed_calibration(pictures):
    world = small_world()
    low = world.detections.box * 1.0
    low[:, 3] = low[:, 1] + 20
    confetti = Detections(world.detections.frame, world.detections.camera, low)
    with pytest.raises(CalibrationError, match=r"not people.* is 20 px\. Pass a detector"):
        run(pictures, ReadsItsPicture(confetti))


@pytest.mark.slow
def test_videos_in_another_order_give_the_same_people(pictures):
    world = small_world()
    names = ("camera 0", "camera 1", "camera 2")
    settings = Settings.paper()
    given, other = (
        run_stages(
            paths,
            ReadsItsPicture(seen),
            scene=world.scene,
            scene_names=names,
            settings=settings,
        )
        for paths, seen in (
            (pictures, world.detections),
            (pictures[::-1], world.detections),
        )
    )
    assert given.warnings == ()
    assert len(other.warnings) == 1
    np.testing.assert_array_equal(other.scene.rig.t, np.asarray(given.scene.rig.t)[::-1])


@pytest.mark.slow
@pytest.mark.parametrize("settings", [Settings(), Settings.paper()], ids=["evidence", "paper"])
def test_refined_cameras_are_those_of_refine(settings, tmp_path):
    world = make_world("ring5", 3, frames=12)
    boxes = CameraBoxes(world.detections, tuple("abcde"), np.asarray(world.scene.rig.image_size))
    refined = cf.refine(world.detections, world.scene, settings).scene
    assert not same_content(refined, world.scene)
    expected = localize(world.detections, refined, settings).tracks
    for _ in range(2):  # computed, and from the cache
        found = run_stages(
            boxes, scene=world.scene, settings=settings, refine=True, cache_dir=tmp_path
        )
        assert same_content(found.scene, refined)
        assert same_content(found.localization.tracks, expected)
    given = run_stages(boxes, scene=world.scene, settings=settings)
    assert same_content(given.scene, world.scene)


@pytest.mark.slow
def test_cameras_of_a_reconstruction_are_adjusted_to_the_people(pictures, monkeypatch):
    world = small_world()
    monkeypatch.setattr("catfree._run._run.reconstruct", lambda *_, **__: world.scene)
    detector, settings = ReadsItsPicture(world.detections), Settings.paper()
    found = run_stages(pictures, detector, reconstructor=Unused(), settings=settings)
    refined = cf.refine(found.detections, world.scene, settings).scene
    assert not same_content(refined, world.scene)
    assert same_content(found.scene, refined)


def test_cameras_that_share_nobody_stay_as_given():
    scene = small_world().scene
    boxes = Detections([0, 1], [0, 1], [[100.0, 20, 140, 120], [100.0, 20, 140, 120]])
    given = CameraBoxes(boxes, ("a", "b", "c"), np.asarray(scene.rig.image_size))
    found = run_stages(given, scene=scene, refine=True)
    assert same_content(found.scene, scene)
    assert found.warnings[0].startswith("The cameras were not adjusted to the people. No person")


@pytest.mark.parametrize("name", ["embedder", "reconstructor"])
def test_what_needs_images_is_refused_with_boxes(name):
    boxes = CameraBoxes(small_world().detections, ("a", "b", "c"))
    with pytest.raises(InvalidInputError, match=f"The {name} needs images, and boxes have none"):
        run_stages(boxes, **{name: Unused()})


def test_anchors_are_for_cameras_found_from_people():
    known = [KnownCamera(0, height=4.0)]
    with pytest.raises(InvalidInputError, match="found from people"):
        run_stages(["a.mp4", "b.mp4"], scene=small_world().scene, anchors=known)


@pytest.mark.slow
def test_a_misspelled_anchor_is_told_before_detection(pictures):
    detector = ReadsItsPicture(small_world().detections)
    with pytest.raises(InvalidInputError, match="camera 'nord', but the cameras are"):
        run(pictures, detector, anchors=[KnownCamera("nord", height=4.0)])
    assert not detector.calls


@pytest.mark.slow
def test_anchors_change_a_calibration_from_the_cache(pictures, tmp_path, monkeypatch):
    found = replace(made_up_calibration([0, 0, 0]), scene=small_world().true_scene)
    monkeypatch.setattr(stages_module, "register", lambda *a, **k: found)
    monkeypatch.setattr(stages_module, "refine_registered", lambda *a, **k: found)
    videos = SynchronizedVideos(pictures)
    boxes = Detections([0], [0], [[0.0, 0, 9, 20]])
    height = 2 * float(np.asarray(found.scene.rig.centers)[0, 2])
    for known in ((), (KnownCamera(0, height=height, height_sd=0.01),)):
        got = stages_module.calibrate_cameras(
            videos, None, boxes, cf.Settings(), anchors=known, cache=StageCache(tmp_path / "cache")
        )
        assert len(got.anchors) == 2 * len(known)
    assert "but 1.70 m" in got.contradictions[0]


def test_a_failed_calibration_says_how_many_instants_were_left_out():
    boxes = Detections([0, 1], [0, 1], [[0.0, 0, 40, 100], [0.0, 0, 40, 100]])
    for silent, said in (((), False), (((1, 0), (2, 0), (2, 1)), True)):
        given = CameraBoxes(
            boxes, ("a", "b"), np.full((2, 2), 640), np.array(silent, np.int64).reshape(-1, 2)
        )
        with pytest.raises(CalibrationError) as error:
            stages_module.calibrate_cameras(given, None, boxes, cf.Settings())
        text = "2 instants that some camera does not show were left out."
        assert str(error.value).endswith(text) == said


def test_a_camera_that_could_not_be_placed_is_told_the_shift_with_which_it_fits(monkeypatch):
    calibration = made_up_calibration([0] * CAMERAS)
    rig = calibration.scene.rig
    registered = np.arange(CAMERAS) != 1
    missing = cf.Rig(rig.K, rig.R, rig.t, rig.image_size, registered=registered)
    scene = Scene(missing, calibration.scene.ground, calibration.scene.extent)
    calibration = replace(calibration, scene=scene)
    boxes = Detections([0], [0], [[0.0, 0, 9, 20]], clock=Clock(5))
    given = CameraBoxes(boxes, tuple("abcdefgh"[:CAMERAS]))
    for offset, by, when in (
        (-10, "10 frames (2.0 s)", "after"),
        (1, "1 frame (0.2 s)", "before"),
        (0, "", None),
    ):
        late = calibration if offset else None
        if late is not None:
            late = replace(late, frame_offset=np.where(np.arange(CAMERAS) == 1, offset, 0))
        monkeypatch.setattr(input_checks, "place_late_camera", lambda *_, late=late: late)
        said = input_checks.calibration_warnings(calibration, boxes, given, Settings())
        expected = (
            f"Camera 'b' could not be placed, but would fit if it had started about {by} {when} "
            f"the others. If so, change the frame numbers of 'b' by {-offset:+d}."
        )
        assert said == ((expected,) if offset else ())
