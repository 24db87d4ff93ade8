"""The command that tracks while the cameras record."""

import io
import json
import signal

import numpy as np
import pytest

from catfree import cli
from catfree.adapters import write_anipose_toml, write_scene_json
from catfree.methods.online import Tracker
from catfree.synthetic import make_world

pytest.importorskip("tyro")


def lines_of(world, frames):
    """Return every frame of every camera as a line, five per second."""
    seen = world.detections
    for frame in range(frames):
        for camera, name in enumerate("abcd"):
            boxes = seen.box[(seen.frame == frame) & (seen.camera == camera)].tolist()
            yield json.dumps({"camera": name, "time": frame / 5, "boxes": boxes})


@pytest.mark.slow
@pytest.mark.parametrize("provisional", [True, False])
def test_lines_in_lines_out(provisional, tmp_path, monkeypatch, capsys):
    world = make_world("ring4", frames=12, people=4)
    write_scene_json(tmp_path / "scene.json", world.true_scene, list("abcd"))
    lines = ["nonsense", *lines_of(world, 12)]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    options = ["--scene", str(tmp_path / "scene.json"), "--frame-rate", "5", "--lag", "1"]
    assert cli.main(["watch", *options, *([] if provisional else ["--no-provisional"])]) == 0
    out, aside = capsys.readouterr()
    assert aside.startswith("catfree: warning: Line 1 is left out: 'nonsense' is not JSON")
    records = [json.loads(line) for line in out.splitlines()]
    final = [record for record in records if record["type"] == "final"]
    np.testing.assert_allclose([r["time"] for r in final[-5:]], np.arange(7, 12) / 5)
    assert any(record["type"] == "provisional" for record in records) == provisional


class _InterruptedInUpdate(Tracker):
    """Press Ctrl-C while the fourth instant is computed."""

    def update(self, detections, time, cameras=None):
        if round(time * 5) == 3:
            signal.raise_signal(signal.SIGINT)
        return super().update(detections, time, cameras)


@pytest.mark.slow
def test_an_interruption_while_positions_are_computed_makes_them_final(
    tmp_path, monkeypatch, capsys
):
    world = make_world("ring4", frames=12, people=4)
    write_scene_json(tmp_path / "scene.json", world.true_scene, list("abcd"))
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines_of(world, 12))))
    monkeypatch.setattr("catfree.methods.online.Tracker", _InterruptedInUpdate)
    options = ["--scene", str(tmp_path / "scene.json"), "--frame-rate", "5"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may ignore it
    try:
        assert cli.main(["watch", *options]) == 0
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    times = {
        kind: [record["time"] for record in records if record["type"] == kind]
        for kind in ("provisional", "final")
    }
    np.testing.assert_allclose(times["provisional"], np.arange(4) / 5)
    assert times["final"] == times["provisional"]


def test_who_reads_no_further_ends_it_without_a_word(tmp_path, monkeypatch, capsys):
    write_scene_json(tmp_path / "scene.json", make_world("ring4", frames=2, people=1).scene)

    def closed(text):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("catfree.cli._watch_command.print_text", closed)
    monkeypatch.setattr("catfree.methods.online._watch.watch", lambda *_, **__: [{"type": "final"}])
    words = ["watch", "--scene", str(tmp_path / "scene.json"), "--frame-rate", "5"]
    assert cli.main(words) == 1
    assert capsys.readouterr().err == ""


def test_a_missing_scene_is_one_sentence(tmp_path, capsys):
    code = cli.main(["watch", "--scene", str(tmp_path / "no.json"), "--frame-rate", "5"])
    assert code == 1
    assert "no.json" in capsys.readouterr().err


def test_a_closed_standard_input_is_one_sentence(tmp_path, monkeypatch, capsys):
    scene = make_world("ring4", frames=2, people=1).scene
    path = write_scene_json(tmp_path / "scene.json", scene, list("abcd"))
    monkeypatch.setattr("sys.stdin", None)
    assert cli.main(["watch", "--scene", str(path), "--frame-rate", "5"]) == 1
    assert "Standard input is closed." in capsys.readouterr().err


def test_a_scene_of_another_unit_is_in_meters(tmp_path, monkeypatch):
    scene = make_world("ring4", frames=2, people=1).true_scene
    path = write_anipose_toml(tmp_path / "c.toml", scene.rig, list("abcd"), metres_per_unit=0.01)
    given = []
    monkeypatch.setattr("catfree.methods.online.Tracker", lambda scene, **_: given.append(scene))
    monkeypatch.setattr("catfree.methods.online._watch.watch", lambda *_, **__: [])
    words = ["watch", "--scene", str(path), "--unit", "cm", "--frame-rate", "5"]
    assert cli.main(words) == 0
    np.testing.assert_allclose(given[0].rig.centers, scene.rig.centers, atol=1e-4)
