"""Files in the result folder, and files removed from it."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree._run import _result_folder
from catfree._run._result_folder import (
    numbers_of_files,
    read_results,
    write_results,
    write_rig,
)
from catfree._run._run import RunOutcome, run_stages
from catfree.adapters import SynchronizedVideos, read_mot, read_scene_json
from catfree.adapters.datasets._detection_files import CameraBoxes, read_camera_boxes
from catfree.errors import InvalidInputError, WriteError
from catfree.methods._localize import localize
from catfree.settings import Settings
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Detections, GeoReference

NAMES = ("north", "east", "south")


@given(
    st.sets(st.integers(0, 60), min_size=1),
    st.integers(1, 5),
    st.integers(-9, 9) | st.integers(0, 10**12),
)
def test_numbers_in_files_are_proportional_to_those_of_the_frames(seen, step, start):
    frames = start + step * np.array(sorted(seen))
    for from_one in (False, True):
        numbers = numbers_of_files(frames, from_one=from_one)
        written = np.array([numbers.index(int(frame)) for frame in frames]) + 1
        assert written.min() >= 1
        np.testing.assert_array_equal(np.diff(written) * numbers.step, np.diff(frames))
        if from_one and numbers.step == 1 and frames[0] >= 1:
            np.testing.assert_array_equal(written, frames)
        if not from_one:
            assert written[0] == 1


@cache
def boxes_with_a_gap():
    world = make_world(ring(3, image_size=(640, 360), people=3), frames=12, people=3)
    seen = world.detections
    frame = seen.frame + np.where(seen.frame < 4, 3, 12)  # 3 to 6, and 16 on
    boxes = CameraBoxes(Detections(**(vars(seen) | {"frame": frame})), NAMES)
    return boxes, world.scene


@cache
def outcome_with_a_gap():
    boxes, scene = boxes_with_a_gap()
    return run_stages(boxes, scene=scene)


@pytest.mark.slow
def test_boxes_are_written_with_the_numbers_they_had(tmp_path):
    boxes, outcome = boxes_with_a_gap()[0], outcome_with_a_gap()
    write_results(tmp_path, outcome, pictures=False)
    for camera, name in enumerate(NAMES):
        own = boxes.detections.frame[boxes.detections.camera == camera]
        written = read_mot(tmp_path / "boxes" / f"{name}.txt").frame
        np.testing.assert_array_equal(np.sort(written), np.sort(own))
    tracks = read_mot(tmp_path / "tracks_mot.txt").frame
    np.testing.assert_array_equal(np.sort(tracks), np.sort(outcome.localization.tracks.frame))


@pytest.mark.slow
@pytest.mark.parametrize("writer", ["write_boxes", "write_rig", "write_report"])
def test_an_interrupted_write_over_a_result_leaves_none(tmp_path, monkeypatch, writer):
    outcome = outcome_with_a_gap()
    write_results(tmp_path, outcome, pictures=False)
    read_results(tmp_path)

    def full(*_, **__):
        raise OSError("No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(_result_folder, writer, full)
        with pytest.raises(WriteError):
            write_results(tmp_path, outcome, pictures=False)
    with pytest.raises(InvalidInputError, match=r"localization\.npz"):
        read_results(tmp_path)
    write_results(tmp_path, outcome, pictures=False)
    read_results(tmp_path)


@pytest.mark.slow
def test_numbered_boxes_take_the_names_of_the_scene(tmp_path):
    boxes, scene = boxes_with_a_gap()
    numbered = replace(boxes, camera_names=("C1", "C2", "C3"))
    write_results(tmp_path, run_stages(numbered, scene=scene, scene_names=NAMES), pictures=False)
    assert {path.stem for path in (tmp_path / "boxes").iterdir()} == set(NAMES)
    again, names = read_camera_boxes(tmp_path), read_scene_json(tmp_path / "scene.json")[1]
    assert names == NAMES
    assert run_stages(again, scene=tmp_path / "scene.json").camera_names == NAMES
    assert run_stages(numbered, scene=scene).camera_names == numbered.camera_names
    moved = run_stages(numbered, scene=scene, scene_names=("C3", "C1", "C2"))
    assert moved.camera_names == numbered.camera_names


@pytest.mark.slow
def test_the_report_lists_the_overlay_among_the_files(tmp_path):
    outcome = outcome_with_a_gap()
    for overlay in (False, True):
        write_results(tmp_path, outcome, pictures=False, overlay=overlay)
        report = (tmp_path / "report.md").read_text()
        assert ("`overlay.webm`" in report.partition("## Files")[2]) == overlay


def outcome_with_footage(folder):
    world = make_world(ring(3, image_size=(160, 90), people=3), frames=4, people=3)
    folders = [folder / name for name in NAMES]
    for place in folders:
        place.mkdir(parents=True)
        for frame in range(4):
            cv2.imwrite(str(place / f"{frame}.png"), np.full((90, 160, 3), 99, np.uint8))
    found = localize(world.detections, world.scene, Settings.paper())
    videos = SynchronizedVideos(folders)
    return RunOutcome(found, world.detections, world.scene, None, NAMES, np.arange(4), videos)


def files_of(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_run_leaves_what_it_leaves_in_an_empty_folder(tmp_path):
    outcome, out = outcome_with_footage(tmp_path / "videos"), tmp_path / "out"
    origin = GeoReference(47.0, 8.0)
    placed = replace(outcome, scene=replace(outcome.scene, georeference=origin))
    other = replace(placed, camera_names=("north", "west", "southwest"))
    write_results(out, other, videos=other.videos)
    (out / "overlay.webm").write_bytes(b"people")
    (out / "pictures" / "boxes.jpg").write_bytes(b"people")
    assert files_of(out) >= {
        "tracks.geojson",
        "boxes/west.txt",
        "pictures/views.jpg",
        "pictures/instants/000000.jpg",
        "pictures/ground_grid.jpg",
        "rig/colmap/cameras.txt",
    }
    foreign = {"notes.txt", "boxes/C9.txt", "pictures/me.jpg", "pictures/instants/a1.jpg"}
    for name in foreign:
        (out / name).write_text("mine")
    fresh = tmp_path / "fresh"
    for folder in (out, fresh):
        write_results(folder, outcome, videos=outcome.videos, blur=True, pictures=False)
    assert files_of(out) == files_of(fresh) | foreign
    assert not any(path.suffix in (".jpg", ".png", ".webm") for path in fresh.rglob("*"))


@pytest.mark.slow
def test_boxes_beside_a_rig_are_not_taken_for_those_of_a_run(tmp_path):
    _, scene = boxes_with_a_gap()
    write_rig(tmp_path, scene, ("a", "b", "c"))
    (tmp_path / "boxes").mkdir()
    (tmp_path / "boxes" / "a.txt").write_text("mine")
    write_results(tmp_path, outcome_with_a_gap(), pictures=False)
    assert (tmp_path / "boxes" / "a.txt").read_text() == "mine"


@pytest.mark.slow
def test_gates_are_drawn_in_the_radius_of_the_run(tmp_path, monkeypatch):
    world = make_world(ring(3, image_size=(1280, 720), people=6), frames=8, people=6)
    settings = Settings.paper()
    wide = replace(settings.selection, suppression_radius=2 * settings.selection.suppression_radius)
    settings, shown = replace(settings, selection=wide), []
    found = localize(world.detections, world.scene, settings)
    monkeypatch.setattr(
        "catfree._run._result_folder.save_plot", lambda ax, path: shown.append(ax) or path
    )
    outcome = RunOutcome(found, world.detections, world.scene, None, NAMES, np.arange(8))
    write_results(tmp_path, outcome, settings)
    line = shown[-1].lines[0].get_xdata()[0]
    radius = wide.suppression_radius * float(world.scene.extent)
    np.testing.assert_allclose(line, found.thresholds.tau_sigma / radius)
