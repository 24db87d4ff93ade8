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
    settings_of,
)
from catfree.errors import InvalidInputError
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
