"""Arguments of the command line as settings, videos, scenes and truth."""

import contextlib
import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from catfree import cli
from catfree.adapters import write_scene_json
from catfree.adapters.datasets import _scene_files
from catfree.cli._inputs import (
    Unit,
    folder_of_results,
    open_boxes,
    open_detector,
    open_embedder,
    open_reconstructor,
    open_scene,
    open_videos,
    require_files,
    require_other_folder,
    settings_of,
)
from catfree.errors import CatFreeError, InvalidInputError
from catfree.settings import Settings
from catfree.synthetic import make_layout


def test_methods_are_named():
    assert settings_of("default") == Settings()
    assert settings_of("paper") == Settings.paper()
    assert settings_of("evidence") == Settings(method="evidence")


def test_units_are_those_of_the_reader():
    assert get_args(Unit) == get_args(_scene_files.Unit)


def test_one_video_is_too_few(tmp_path):
    with pytest.raises(InvalidInputError, match="at least 2 videos, got 1"):
        open_videos((tmp_path,))


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Write folders of videos, image folders and box files, of two cameras each."""
    monkeypatch.chdir(tmp_path)
    for camera in "ab":
        for name in (f"videos/{camera}.mp4", f"images/{camera}/0.png", f"boxes/{camera}.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text("1,-1,10,10,20,50,0.9,-1,-1,-1\n")
    (tmp_path / "empty").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("paths", "sentence"),
    [
        ("videos", "folder of videos .* one per camera: videos/a.mp4 videos/b.mp4"),
        ("images", "image folders.* one per camera: images/a images/b"),
        ("videos images/a", "folder of videos"),
        ("boxes", "boxes holds files that end like boxes, not like a video. Give the"),
        ("boxes/a.txt boxes/b.txt", r"a.txt ends like a file of boxes \(.txt\), not like a video"),
        ("boxes/a.txt videos/a.mp4", r"a.txt ends like a file of boxes \(.txt\), but videos"),
        ("images/a", "at least 2 videos, got 1"),
        ("empty", "at least 2 videos, got 1"),
        ("none.mp4 videos/a.mp4", "Camera 0: There is no video file"),
        ("none.mp4", "Camera 0: There is no video file"),
    ],
)
def test_what_is_no_video_is_said(folders, paths, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        require_files(tuple(map(Path, paths.split())))


def test_videos_and_image_folders_are_videos(folders):
    require_files((Path("videos/a.mp4"), Path("images/b")))


@pytest.mark.parametrize(
    ("paths", "named"),
    [
        ("videos", "videos/a.mp4 videos/b.mp4"),
        ("images", "images/a images/b"),
        ("videos/a.mp4 videos/b.mp4", "videos/a.mp4 videos/b.mp4"),
        ("images/a images/b", "images/a images/b"),
        ("empty", None),
        ("none.txt", None),
    ],
)
def test_what_takes_videos_is_said_where_boxes_are_wanted(folders, paths, named):
    pytest.importorskip("pyarrow")
    with pytest.raises(CatFreeError) as caught:
        open_boxes(tuple(map(Path, paths.split())))
    ending = f"are for catfree run and catfree calibrate, one per camera: {named}."
    assert str(caught.value).endswith(ending) == (named is not None)


def test_boxes_beside_videos_are_boxes(folders):
    for camera in "ab":
        (folders / "videos" / f"{camera}.txt").write_text("1,-1,10,10,20,50,0.9,-1,-1,-1\n")
    assert open_boxes((Path("videos"),)).camera_names == ("a", "b")
    (folders / "videos" / "a.txt").write_text("1,-1,ten\n")
    with pytest.raises(CatFreeError, match=r"a\.txt") as caught:
        open_boxes((Path("videos"),))
    assert "catfree run" not in str(caught.value)


def test_sizes_that_boxes_state_are_not_replaced(tmp_path):
    image = {"id": 1, "file_name": "C1/1.png", "width": 640, "height": 360}
    box = {"image_id": 1, "category_id": 1, "bbox": [1, 1, 5, 9]}
    path = tmp_path / "boxes.json"
    path.write_text(json.dumps({"images": [image], "annotations": [box]}))
    assert open_boxes((path,), image_size=(640, 360)).image_size.tolist() == [[640, 360]]
    with pytest.raises(InvalidInputError, match="another size than --image-size"):
        open_boxes((path,), image_size=(320, 180))


def test_what_is_not_given_is_not_opened():
    for opened in (open_detector, open_embedder, open_reconstructor):
        assert opened(None) is None
    assert open_scene(None) == (None, None)


def test_a_unit_is_that_of_a_scene():
    with pytest.raises(InvalidInputError, match=r"--unit ft is the unit of a --scene.*meters"):
        open_scene(None, "ft")


def test_scenes_of_both_formats(tmp_path):
    scene = make_layout("ring4", 0).scene
    scene.save(tmp_path / "scene.npz")
    write_scene_json(tmp_path / "scene.json", scene, ["a", "b", "c", "d"])
    for name, called in (("scene.npz", None), ("scene.json", ("a", "b", "c", "d"))):
        opened, names = open_scene(tmp_path / name)
        np.testing.assert_allclose(opened.rig.t, scene.rig.t)
        assert names == called


def test_results_are_not_written_beside_their_boxes(tmp_path, monkeypatch, capsys):
    pytest.importorskip("tyro")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "boxes"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.txt").write_text("1,-1,1,1,5,9,1\n")
    (tmp_path / "link").symlink_to("boxes")
    for out in ("boxes", str(folder), "link", "boxes/../boxes"):
        for boxes in (["boxes"], ["boxes/a.txt", "boxes/b.txt"]):
            for command in ("localize", "calibrate"):
                assert cli.main([command, *boxes, "--out", out]) == 1
                assert f"--out is {out}, the folder of the boxes" in capsys.readouterr().err
    assert len(list(folder.iterdir())) == 2
    require_other_folder(folder / "results", (folder,))


def test_a_folder_of_results_is_left_only_with_results(tmp_path):
    for folder in (tmp_path / "new", tmp_path):
        with contextlib.suppress(ValueError), folder_of_results(folder):
            assert folder.is_dir()
            raise ValueError
    assert list(tmp_path.parent.glob(tmp_path.name)) == [tmp_path]
    assert not (tmp_path / "new").exists()
    with folder_of_results(tmp_path / "new"):
        (tmp_path / "new" / "tracks.csv").touch()
    assert (tmp_path / "new" / "tracks.csv").exists()
