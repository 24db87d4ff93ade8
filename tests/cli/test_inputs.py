"""What the words of the command line become: settings, videos, scenes, truth."""

import numpy as np
import pytest

from catfree.adapters import write_scene_json
from catfree.cli._inputs import (
    open_detector,
    open_embedder,
    open_reconstructor,
    open_scene,
    open_videos,
    read_truth,
    settings_of,
)
from catfree.errors import FileFormatError, InvalidInputError
from catfree.settings import Settings
from catfree.synthetic import make_layout


def test_methods_are_named():
    assert settings_of("default") == Settings()
    assert settings_of("paper") == Settings.paper()
    assert settings_of("evidence") == Settings(method="evidence")


def test_one_video_is_too_few(tmp_path):
    with pytest.raises(InvalidInputError, match="at least 2 videos, got 1"):
        open_videos((tmp_path,))


def test_what_is_not_given_is_not_opened():
    for opened in (open_detector, open_embedder, open_reconstructor):
        assert opened(None) is None
    assert open_scene(None) == (None, None)


def test_scenes_of_both_formats(tmp_path):
    scene = make_layout("ring4", 0).scene
    scene.save(tmp_path / "scene.npz")
    write_scene_json(tmp_path / "scene.json", scene, ["a", "b", "c", "d"])
    for name, called in (("scene.npz", None), ("scene.json", ("a", "b", "c", "d"))):
        opened, names = open_scene(tmp_path / name)
        np.testing.assert_allclose(opened.rig.t, scene.rig.t)
        assert names == called


@pytest.mark.parametrize("identity", ["id", "track_id"])
def test_truth_and_tracks_are_read_alike(identity, tmp_path):
    truth = tmp_path / "truth.csv"
    truth.write_text(f"x,frame,y,{identity}\n \n1.5,0,2.5,7\n3,1,4,8\n")
    np.testing.assert_array_equal(read_truth(truth), [[0, 7, 1.5, 2.5], [1, 8, 3, 4]])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("frame,x,y\n0,1,2\n", "no column 'id'"),
        ("", "no column 'frame'"),
        ("frame,id,x,y\n0,1,here,2\n", "here"),
        ("frame,id,x,y\n0,1,2,3\n\n0,1,2\n", r"truth\.csv: line 4 has 3 columns instead of 4"),
        ("frame,id,x,y\n0,1,1,5,2,5\n", "line 2 has 6 columns.*decimals with a point"),
        ("frame,id,x,y\n", "has a header but no rows"),
        ("frame,id,x,y\n0,1,2,3\n1,1,nan,3\n", r"truth\.csv: x in line 3 is 'nan'"),
        ("frame,id,x,y\n0.5,1,2,3\n", "frame in line 2 is '0.5', not a whole number"),
        ("frame,id,x,y\n0,,2,3\n", "id in line 2 is '', not a whole number"),
        ("frame,id,x,y\n0,1,2," + "3" * 200_000, "line 2 is not CSV"),
    ],
)
def test_truth_that_is_none_is_refused(text, sentence, tmp_path):
    truth = tmp_path / "truth.csv"
    truth.write_text(text)
    with pytest.raises(FileFormatError, match=sentence):
        read_truth(truth)
