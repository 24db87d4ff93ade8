"""Mistakes in the input of a run: fatal ones raise, others give warnings."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree._run._input_checks import (
    clock_warnings,
    footage_warnings,
    lost_footage,
    order_like,
    require_distinct_videos,
    scene_of,
    tiny_boxes,
    without_offsets,
)
from catfree._run._result_folder import write_rig
from catfree._run._run import run_stages
from catfree.adapters import (
    NamedRig,
    SceneSource,
    SynchronizedVideos,
    read_scene,
    write_scene_json,
)
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.adapters.video import _video_sources
from catfree.calibration import Refinement, remove_offsets
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.methods import localize
from catfree.settings import CalibrationSettings, Settings
from catfree.synthetic import make_layout, make_world
from catfree.synthetic._layouts import ring
from catfree.types import Clock, Detections


def write_video(path, count, seed=0, fps=5.0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (64, 48))
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        writer.write(rng.integers(0, 255, (48, 64, 3)).astype(np.uint8))
    writer.release()
    return path


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Write cameras a, b and c with 40 frames, and one of half the length."""
    folder = tmp_path_factory.mktemp("clips")
    paths = {name: write_video(folder / f"{name}.avi", 40, at) for at, name in enumerate("abc")}
    return paths | {"half": write_video(folder / "half.avi", 20, 9)}


def test_equal_files_of_two_names_are_refused(clips, tmp_path):
    copy = tmp_path / "copy.avi"
    copy.write_bytes(clips["a"].read_bytes())
    videos = SynchronizedVideos([clips["a"], clips["b"], copy])
    with pytest.raises(
        InvalidInputError,
        match=r"Cameras 0 and 2 are the same recording.*a\.avi "
        r"and .*copy\.avi are equal byte for byte",
    ):
        require_distinct_videos(videos)
    require_distinct_videos(SynchronizedVideos([clips["a"], clips["b"]]))


def write_images(folder, names, seed=0, suffix="png"):
    folder.mkdir()
    for number, name in enumerate(names):
        picture = np.random.default_rng([seed, number]).integers(0, 255, (8, 8, 3))
        cv2.imwrite(str(folder / f"{name}.{suffix}"), picture.astype(np.uint8))
    return folder


@given(
    first=st.integers(0, 120),
    step=st.integers(1, 25),
    count=st.integers(3, 8),
    gap=st.integers(1, 6),
    name=st.sampled_from(["{:06d}", "C2_{}", "{}"]),
)
def test_a_gap_in_the_numbers_of_images_is_named(tmp_path_factory, first, step, count, gap, name):
    numbers = [first + step * number for number in range(count)]
    folder = tmp_path_factory.mktemp("images")
    whole = write_images(folder / "whole", [name.format(number) for number in numbers])
    assert footage_warnings(SynchronizedVideos([whole])) == ()
    lost = min(gap, count - 2)
    left = numbers[:lost] + numbers[lost + 1 :] + [numbers[-1] + step]
    cut = write_images(folder / "cut", [name.format(number) for number in left])
    (said,) = footage_warnings(SynchronizedVideos([whole, cut], fewest_cameras=2))
    before, after = (f"{name.format(left[at])}.png" for at in (lost - 1, lost))
    assert f"'cut' has no image number {numbers[lost]} in {cut}: after {before} comes" in said
    assert after in said
    times = "".join(f"{at},{at / 5}\n" for at in range(count))
    (cut / "timestamps.csv").write_text("frame_id,timestamp_s\n" + times)
    assert footage_warnings(SynchronizedVideos([cut])) == ()


@pytest.mark.parametrize("names", [["0", "7", "11"], ["a", "b"], ["1_1", "2_1", "x"], ["5"]])
def test_images_without_even_numbers_lack_none(names, tmp_path):
    folder = write_images(tmp_path / "images", names)
    assert footage_warnings(SynchronizedVideos([folder])) == ()


def test_equal_folders_of_two_names_are_refused(tmp_path):
    one = write_images(tmp_path / "one", range(9))
    two = write_images(tmp_path / "two", [f"image {number}" for number in range(9)])
    with pytest.raises(InvalidInputError, match="same recording"):
        require_distinct_videos(SynchronizedVideos([one, two]))


@pytest.mark.parametrize("suffix", ["png", "bmp"])
def test_different_recordings_are_not_read(clips, tmp_path, monkeypatch, suffix):
    """Also for folders, including images of equal size, and for files of equal size."""
    folders = [write_images(tmp_path / name, range(40), at, suffix) for at, name in enumerate("ab")]
    files = [tmp_path / "a.avi", tmp_path / "b.avi"]
    size = max(clips[name].stat().st_size for name in "ab")
    for file in files:
        file.write_bytes(clips[file.stem].read_bytes().ljust(size, b"\0"))
    read = []
    monkeypatch.setattr(_video_sources, "hash_file", read.append)
    for paths in (folders, files):
        require_distinct_videos(SynchronizedVideos(paths))
    assert not read


@given(order=st.permutations(range(3)))
def test_videos_in_any_order_find_their_cameras_by_name(clips, order):
    scene = make_layout("ring4", 0).scene
    scene = type(scene)(scene.rig.select([0, 1, 2]), scene.ground, scene.extent, scene.metric)
    names = ["a", "b", "c"]
    videos = SynchronizedVideos([clips[names[at]] for at in order])
    ordered, said = order_like(scene, names, videos.camera_names)
    np.testing.assert_array_equal(ordered.rig.t, np.asarray(scene.rig.t)[list(order)])
    assert bool(said) == (list(order) != [0, 1, 2])
    assert all("matched by name" in sentence for sentence in said)


def test_cameras_of_the_scene_without_boxes_are_named():
    scene = make_layout("ring4", 0).scene
    fewer, said = order_like(scene, ["a", "b", "c", "d"], ["a", "d"], "boxes")
    np.testing.assert_array_equal(fewer.rig.t, np.asarray(scene.rig.t)[[0, 3]])
    assert said == (
        "There are no boxes of these cameras of the scene, so they are not used: b, c.",
    )
    for kind in ("videos", "boxes"):
        with pytest.raises(InsufficientDataError, match=f"needs {kind} of at least 2 .* a, c, d"):
            order_like(scene, ["a", "b", "c", "d"], ["b"], kind)


def test_names_that_do_not_fit_are_told_and_default_ones_are_not(clips):
    scene = make_layout("ring4", 0).scene
    scene = type(scene)(scene.rig.select([0, 1]), scene.ground, scene.extent, scene.metric)
    videos = SynchronizedVideos([clips["a"], clips["b"]])
    same, (said,) = order_like(scene, ["a", "north"], videos.camera_names)
    assert same is scene
    assert "names its cameras a, north, the videos are a, b" in said
    with pytest.raises(InvalidInputError, match=r"cameras b, north, .* a, b, which are not all"):
        order_like(scene, ["b", "north"], videos.camera_names)
    assert order_like(scene, ["C1", "C2"], videos.camera_names) == (scene, ())
    # Videos whose files are named like default cameras have these names.
    same, (said,) = order_like(scene, ["north", "south"], ["C1", "C2"])
    assert same is scene
    assert "the videos are C1, C2: they were matched in the order given" in said
    assert order_like(scene, ["north", "south"], ["C1", "C2"], "boxes") == (scene, ())


def test_a_part_of_the_scene_is_found_by_name_alone(clips):
    scene = make_layout("ring4", 0).scene
    videos = SynchronizedVideos([clips["b"], clips["a"]])
    part, said = order_like(scene, ["x.png", "a.png", "b.png", "y.png"], videos.camera_names)
    np.testing.assert_array_equal(part.rig.t, np.asarray(scene.rig.t)[[2, 1]])
    assert "matched by name" in said[0]
    assert "no videos of these cameras of the scene, so they are not used: x.png, y.png." in said[1]
    for names in (["x", "y", "z", "w"], ["C1", "C2", "C3", "C4"]):
        with pytest.raises(InvalidInputError, match="but there are videos of b, a, which are"):
            order_like(scene, names, videos.camera_names)
    # Boxes with numbered cameras belong to the first cameras.
    assert order_like(scene, ["x", "y", "z", "w"], ["C1", "C2"], "boxes") == (scene, ())


def test_a_short_video_says_what_is_lost(clips):
    videos = SynchronizedVideos([clips["a"], clips["half"], clips["b"]])
    (said,) = lost_footage(videos)
    assert "'half' ends early: 20 instants (4.0 s) after it, which 2 other cameras show" in said
    assert lost_footage(SynchronizedVideos([clips["a"], clips["b"]])) == ()
    # Data that was not requested is not lost.
    assert lost_footage(SynchronizedVideos([clips["a"], clips["half"]], end=20)) == ()


@given(height=st.floats(5, 300), count=st.integers(1, 9))
def test_boxes_are_people_above_the_noise_of_their_edges(height, count):
    box = np.tile([10.0, 10.0, 20.0, 10.0 + height], (count, 1))
    boxes = Detections(np.arange(count), np.zeros(count, int), box)
    said = tiny_boxes(boxes, CalibrationSettings())
    if height < 28:
        assert f"median height of {count} boxes is {height:.0f} px. Pass a detector" in said[0]
    if height > 30:
        assert said == ()
    # A ten times more exact detector can measure smaller ones.
    exact = replace(CalibrationSettings(), pixel_sd=0.4)
    assert tiny_boxes(boxes, exact) == ()


def test_corrected_clocks_show_the_same_pictures(clips):
    videos = SynchronizedVideos([clips["a"], clips["b"]], stride=2)
    corrected = videos.without_offsets([0, -6])
    assert corrected.offsets == (0, -6)
    np.testing.assert_array_equal(corrected.frames, np.arange(6, 40, 2))
    before = dict(videos)
    for tick, images in corrected:
        np.testing.assert_array_equal(images[0], before[tick][0])
        np.testing.assert_array_equal(images[1], before[tick - 6][1])
    assert corrected.fingerprint != videos.fingerprint
    boxes = Detections(videos.frames, np.ones(20, int), np.tile([0.0, 0, 1, 2], (20, 1)))
    same, moved = without_offsets(videos, boxes, np.array([0, -6]))
    assert same.fingerprint == corrected.fingerprint
    np.testing.assert_array_equal(moved.frame, np.arange(6, 40, 2))
    with pytest.raises(InsufficientDataError, match="no instant is in all 2 videos"):
        videos.without_offsets([0, -60])


def clocks_said(detections, scene, settings):
    boxes = CameraBoxes(detections, ("north", "east", "south", "west")[: scene.rig.camera_count])
    found = localize(detections, scene, settings)
    return clock_warnings(found, detections, scene, boxes, settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "camera", "by"), [("evidence", 1, -10), ("evidence", 2, 8), ("paper", 1, -10)]
)
def test_a_late_camera_is_named_with_its_offset(method, camera, by):
    world = make_world("ring4", 0, frames=80, people=10)
    settings = Settings.paper() if method == "paper" else Settings()
    offset = np.zeros(4, np.int64)
    offset[camera] = -by
    late = replace(remove_offsets(world.detections, offset), clock=Clock(5.0))
    late = late[(late.frame >= max(0, by)) & (late.frame < 80 + min(0, by))]
    (said,) = clocks_said(late, world.scene, settings)
    name, when = ("north", "east", "south", "west")[camera], "before" if by > 0 else "after"
    assert f"'{name}' seems to have started about {abs(by)} frames ({abs(by) / 5:.1f} s)" in said
    assert f"{when} the others" in said
    assert f"If so, change the frame numbers of '{name}' by {-by:+d}." in said
    # Frame numbers may have any step.
    sparse = replace(late, frame=5 * late.frame + 3)
    assert f"about {5 * abs(by)} frames" in clocks_said(sparse, world.scene, settings)[0]


@pytest.mark.slow
def test_nothing_is_said_of_clocks_that_fit_or_cannot_be_judged():
    world = make_world("ring4", 0, frames=60, people=10)
    right = world.detections
    first = right[right.frame == 0]
    still = Detections(
        np.repeat(np.arange(60), len(first)), np.tile(first.camera, 60), np.tile(first.box, (60, 1))
    )
    for boxes in (right, right[right.frame < 2], right[:0], still):
        assert clocks_said(boxes, world.scene, Settings()) == ()


def test_a_scene_comes_from_whatever_has_one(tmp_path):
    scene = make_layout("ring4", 0).scene
    refined = Refinement(scene, np.zeros(1), 0, np.zeros(1, int))
    assert isinstance(refined, SceneSource)
    named_rig = NamedRig(scene.rig, ("a", "b", "c", "d"))
    assert isinstance(named_rig, SceneSource)
    found, names = scene_of(named_rig, None)
    assert found is not None
    assert (found.rig, names) == (scene.rig, named_rig.names)
    np.testing.assert_array_equal(found.ground.normal, [0, 0, 1])
    assert scene_of(None, None) == (None, None)
    assert scene_of(scene, ["a"]) == (scene, ["a"])
    assert scene_of(refined, None) == (scene, None)
    named = SimpleNamespace(scene=scene, camera_names=("a", "b", "c", "d"))
    assert scene_of(named, None) == (scene, named.camera_names)
    assert scene_of(named, ["d", "c", "b", "a"]) == (scene, ["d", "c", "b", "a"])
    path = write_scene_json(tmp_path / "scene.json", scene, ["a", "b", "c", "d"])
    for source in (path, str(path)):
        read, names = scene_of(source, None)
        assert names == ("a", "b", "c", "d")
        assert read is not None
        np.testing.assert_array_equal(read.rig.K, scene.rig.K)
        assert scene_of(source, ["d", "c", "b", "a"])[1] == ["d", "c", "b", "a"]
    with pytest.raises(InvalidInputError, match="scene must be a Scene, got int"):
        scene_of(SimpleNamespace(scene=3), None)  # type: ignore[arg-type]


@pytest.mark.slow
def test_boxes_of_smaller_images_than_those_of_the_scene_are_refused():
    world = make_world(ring(3, image_size=(640, 360), people=3), frames=12, people=3)
    names, size = ("north", "east", "south"), np.tile([640, 360], (3, 1))
    small = np.where(np.arange(3)[:, None] == 1, size // 2, size)
    assert run_stages(CameraBoxes(world.detections, names, size), scene=world.scene).warnings == ()
    with pytest.raises(InvalidInputError, match="'east' has images of 320 x 180 px, but of 640 x"):
        run_stages(CameraBoxes(world.detections, names, small), scene=world.scene)


def test_warnings_of_boxes_name_cameras_as_the_user_does():
    world = make_world(ring(3, image_size=(640, 360), people=3), frames=12, people=3)
    names, seen = ("north", "east", "south"), world.detections
    dead = run_stages(CameraBoxes(seen[seen.camera != 1], names), scene=world.scene)
    assert dead.warnings[0].startswith("Camera 'east' has 0 of the")
    boxes = CameraBoxes(seen, names, silent=np.array([[seen.frame[0], seen.camera[0]]]))
    with pytest.raises(InvalidInputError, match=f"camera {names[seen.camera[0]]!r} has no picture"):
        run_stages(boxes, scene=world.scene)


@pytest.mark.parametrize("names", [("C1", "C3"), ("C3", "north"), ("north", "south")])
def test_cameras_without_boxes_get_names_of_their_own(names, tmp_path):
    """A camera is numbered by its place in the scene, in which another may have this name."""
    world = make_world(ring(3, image_size=(640, 360), people=3), frames=12, people=3)
    boxes = CameraBoxes(world.detections[world.detections.camera < 2], names)
    outcome = run_stages(boxes, scene=world.scene)
    assert outcome.camera_names[:2] == names
    write_rig(tmp_path, world.scene, outcome.camera_names)
    assert read_scene(tmp_path / "scene.json")[1] == outcome.camera_names
