"""Files of a failed run, and messages of the command line about mistakes in its input."""

import importlib
import json
import subprocess
import sys
from functools import cache

import cv2
import numpy as np
import pytest

from catfree import cli
from catfree._run._failed_run import write_failure
from catfree._run._run import Unfinished
from catfree.adapters import SynchronizedVideos, read_mot, write_scene_json
from catfree.errors import CalibrationError
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Detections

pytest.importorskip("tyro")

SIZE, FRAMES = (160, 90), 12


def write_noise(folder, cameras=2):
    """Write folders of pictures without people."""
    paths = []
    for camera in range(cameras):
        path = folder / f"cam{camera}"
        path.mkdir(parents=True)
        still = np.random.default_rng(camera).integers(60, 120, (SIZE[1], SIZE[0], 3))
        for frame in range(FRAMES):
            cv2.imwrite(str(path / f"{frame:02d}.png"), still.astype(np.uint8))
        paths.append(path)
    return paths


@cache
def scene_of_three():
    return make_world(ring(3, image_size=SIZE, people=4), frames=2, people=4).scene


def test_what_the_detector_saw_is_written_with_the_reason(tmp_path):
    videos = SynchronizedVideos(write_noise(tmp_path))
    box = np.array([[10.0, 10, 20, 30], [40, 10, 50, 40], [60, 10, 70, 50]])
    boxes = Detections([3, 3, 5], [0, 1, 0], box, [0.9, 0.8, 0.7])
    error = CalibrationError("Nothing fits.")
    unfinished = Unfinished(videos, boxes, ("Mind the gap.",))
    files = write_failure(tmp_path / "out", error, unfinished)
    assert all(path.is_file() for path in files)
    for name, count in (("cam0", 2), ("cam1", 1)):
        assert len(read_mot(tmp_path / "out" / "boxes" / f"{name}.txt").frame) == count
    np.testing.assert_array_equal(Detections.load(tmp_path / "out" / "detections.npz").box, box)
    assert cv2.imread(str(tmp_path / "out" / "pictures" / "boxes.jpg")) is not None
    text = (tmp_path / "out" / "report.md").read_text()
    order = ["Why this run failed", "Nothing fits.", "## Warnings", "Mind the gap.", "| cam0 | 2 |"]
    places = [text.index(word) for word in order]
    assert places == sorted(places)
    assert "Nothing fits." in (tmp_path / "out" / "report.html").read_text()
    assert write_failure(tmp_path / "none", error, Unfinished(videos)) == []
    assert not (tmp_path / "none").exists()


def test_no_picture_of_people_is_written_unless_wanted(tmp_path):
    videos = SynchronizedVideos(write_noise(tmp_path))
    boxes = Detections([3, 3], [0, 1], np.array([[10.0, 10, 20, 30], [40, 10, 50, 40]]))
    unfinished = Unfinished(videos, boxes)
    write_failure(tmp_path / "out", CalibrationError("No."), unfinished)
    assert (tmp_path / "out" / "pictures" / "boxes.jpg").is_file()
    files = write_failure(tmp_path / "out", CalibrationError("No."), unfinished, pictures=False)
    assert all(path.is_file() for path in files)
    assert list((tmp_path / "out").rglob("*.jpg")) == []
    page = (tmp_path / "out" / "report.html").read_text()
    assert "What the detector saw" in page
    assert "<img" not in page
    assert "data:image" not in page


def test_files_of_an_earlier_run_stay_and_are_named(tmp_path):
    videos = SynchronizedVideos(write_noise(tmp_path))
    boxes = Detections([3, 3], [0, 1], np.array([[10.0, 10, 20, 30], [40, 10, 50, 40]]))
    out = tmp_path / "out"
    write_failure(out, CalibrationError("No."), Unfinished(videos, boxes))
    assert "earlier" not in (out / "report.md").read_text()
    write_scene_json(out / "scene.json", scene_of_three(), ["cam0", "cam1", "cam2"])
    for name in ("tracks.csv", "localization.npz", "boxes/cam2.txt", "notes.txt"):
        (out / name).write_text(name)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    written = write_failure(out, CalibrationError("No."), Unfinished(videos, boxes))
    assert {path: path.read_bytes() for path in before if path not in written} == {
        path: content for path, content in before.items() if path not in written
    }
    # Statements about other boxes do not apply to these.
    said = [out / "missing_pictures.csv", out / "offsets.csv"]
    for path in said:
        path.write_text("frame,camera,offset\n")
    write_failure(out, CalibrationError("No."), Unfinished(videos, boxes))
    assert not any(path.exists() for path in said)
    page = (out / "report.md").read_text()
    listed = "by an earlier run: tracks.csv, localization.npz, scene.json, boxes/cam2.txt."
    assert listed in page
    assert page.index("Why this run failed") < page.index(listed) < page.index("What the detector")
    assert listed in (out / "report.html").read_text()


def test_cameras_that_see_no_feet_are_named(tmp_path):
    videos = SynchronizedVideos(write_noise(tmp_path))
    cut, whole = [10.0, 40, 30, SIZE[1] - 1], [40.0, 10, 50, 40]
    boxes = Detections(
        [1, 2, 3, 1, 2, 3],
        [0, 0, 0, 1, 1, 1],
        np.array([cut, cut, whole, whole, whole, whole]),
        ankles_confirmed=[True, True, True, True, True, False],
    )
    write_failure(tmp_path / "out", CalibrationError("Nothing fits."), Unfinished(videos, boxes))
    text = (tmp_path / "out" / "report.md").read_text()
    assert "in cam0 (33% of the boxes)." in text
    rows = [line.split("|")[-2].strip() for line in text.splitlines() if line.startswith("| cam")]
    assert rows[:3] == ["feet seen", "33%", "67%"]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "calibrate"])
def test_a_failed_command_names_its_report(command, tmp_path, capsys):
    videos = [str(path) for path in write_noise(tmp_path)]
    out = tmp_path / "out"
    assert cli.main([command, *videos, "--out", str(out), "--no-pictures"]) == 1
    assert list(out.rglob("*.jpg")) == []
    said = capsys.readouterr().err
    assert said.strip().splitlines()[-1].endswith(f"is in {out / 'report.html'}.")
    assert "seconds" in said  # the footage table is printed before the work
    assert "needs 2 cameras" in (out / "report.md").read_text()


@pytest.mark.slow
def test_a_scene_in_another_order_is_matched_by_name(tmp_path, capsys):
    videos = write_noise(tmp_path, cameras=3)
    write_scene_json(tmp_path / "scene.json", scene_of_three(), ["cam2", "cam0", "cam1"])
    out = tmp_path / "out"
    words = ["run", *map(str, videos), "--scene", str(tmp_path / "scene.json"), "--out", str(out)]
    assert cli.main([*words, "--no-pictures"]) == 0
    assert "catfree: warning: The scene lists its cameras as cam2" in capsys.readouterr().err
    t = np.asarray(scene_of_three().rig.t)
    written = json.loads((out / "scene.json").read_text())["cameras"]
    assert [camera["name"] for camera in written] == ["cam0", "cam1", "cam2"]
    np.testing.assert_allclose([camera["t"] for camera in written], t[[1, 2, 0]])
    # The most important facts come first.
    lines = [line for line in (out / "report.md").read_text().splitlines() if line]
    assert lines[1] == "## Warnings"
    page = (out / "report.html").read_text()
    assert page.index("<h2>Warnings") < page.index("<h2>Result")


@pytest.mark.slow
@pytest.mark.parametrize("option", ["scene", "detector", "embedder", "reconstructor"])
def test_a_missing_file_is_named_before_anything_is_opened(option, tmp_path):
    videos = [str(path) for path in write_noise(tmp_path)]
    code = (
        "import sys; from catfree.cli import main; code = main(sys.argv[1:])\n"
        "slow = {'cv2', 'onnxruntime', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'slow: {slow}' if slow else code)"
    )
    words = ["run", *videos, f"--{option}", str(tmp_path / "nowhere"), "--out", str(tmp_path / "o")]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == (
        f"catfree: There is no file {tmp_path / 'nowhere'} (--{option}). Check the path."
    )
    assert done.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize(("command", "module"), [("run", "_run"), ("calibrate", "_stages")])
def test_clock_offsets_are_searched_on_request(command, module, tmp_path, monkeypatch):
    asked = []

    def pretend(*_, maximum_offset, **__):
        asked.append(maximum_offset)
        raise CalibrationError("pretended")

    place = importlib.import_module(f"catfree._run.{module}")
    monkeypatch.setattr(place, "calibrate_cameras", pretend)
    videos = [str(path) for path in write_noise(tmp_path)]
    words = [command, *videos, "--out", str(tmp_path / "out"), "--max-offset", "7"]
    assert cli.main(words) == 1
    assert asked == [7]


@pytest.mark.slow
def test_equal_videos_are_refused_before_anybody_looks(tmp_path, capsys):
    paths = write_noise(tmp_path)
    for picture in paths[0].iterdir():
        (paths[1] / picture.name).write_bytes(picture.read_bytes())
    for command in ("run", "calibrate"):
        out = tmp_path / command
        assert cli.main([command, *map(str, paths), "--out", str(out)]) == 1
        assert "are the same recording" in capsys.readouterr().err
        assert not (out / "report.md").exists()
