import sys

import numpy as np
import pytest

from catfree.adapters import Detector, FittedToCamera, SynchronizedVideos, write_scene_json
from catfree.synthetic._silhouettes import cast_silhouettes

pytestmark = pytest.mark.slow


def test_its_boxes_lie_on_people(load_example, rendered):
    videos, world = rendered
    finder = load_example("bring_your_own_detector").Moving()
    assert isinstance(finder, FittedToCamera)
    footage = SynchronizedVideos(videos)
    bodies = cast_silhouettes(world.walkers, world.true_rig)
    on_somebody = []
    for camera in range(3):
        detector = finder.fit(footage.pictures_of(camera))
        assert isinstance(detector, Detector)
        for frame, image in enumerate(footage.pictures_of(camera)):
            box = detector(image).box
            middle = (box[:, :2] + box[:, 2:]) / 2
            body = bodies.box[(bodies.frame == frame) & (bodies.camera == camera)]
            inside = (middle[:, None] > body[None, :, :2]) & (middle[:, None] < body[None, :, 2:])
            on_somebody.extend(inside.all(-1).any(-1))
    assert len(on_somebody) > len(world.walkers.present)
    assert np.mean(on_somebody) > 0.7


def test_positions_are_printed(load_example, rendered, monkeypatch, tmp_path, capsys):
    videos, world = rendered
    scene = write_scene_json(tmp_path / "scene.json", world.true_scene, ["a", "b", "c"])
    monkeypatch.setattr(sys, "argv", ["bring_your_own_detector.py", *videos, "--scene", str(scene)])
    load_example("bring_your_own_detector").main()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > len(world.walkers.present)
    assert all(line.startswith("frame ") and line.endswith(" m") for line in lines)
