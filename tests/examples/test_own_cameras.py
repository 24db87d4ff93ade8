import sys

import pytest

from catfree.adapters import write_scene_json

pytestmark = pytest.mark.slow


def test_from_videos_to_a_report(load_example, rendered, monkeypatch, tmp_path, capsys):
    videos, world = rendered
    scene = write_scene_json(tmp_path / "scene.json", world.true_scene, ["a", "b", "c"])
    out = tmp_path / "results"
    arguments = [*videos, "--scene", str(scene), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["own_cameras.py", *arguments])
    load_example("own_cameras").main()
    assert "tracks; see" in capsys.readouterr().out
    rows = (out / "tracks.csv").read_text().splitlines()
    # Most frames have people; a background of 20 pictures hides people who hardly move.
    assert len(rows) > len(world.walkers.present)
    assert (out / "report.html").is_file()
    assert any((out / "cache").iterdir())
