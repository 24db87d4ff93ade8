import re
import sys

import pytest

pytestmark = pytest.mark.slow


def test_finds_the_cameras_and_scores_all_three_rigs(
    load_example, write_sequence, monkeypatch, capsys
):
    example = load_example("calibrate_from_people")
    path = write_sequence(frames=60, people=12)
    monkeypatch.setattr(sys, "argv", ["calibrate_from_people.py", str(path)])
    example.main()
    text = capsys.readouterr().out
    assert len(re.findall(r"^C\d: center off by", text, re.MULTILINE)) >= 3
    said = re.search(r"scale of the estimated rig: ([\d.]+) .*stated deviation (\d+) %", text)
    scale, percent = map(float, said.groups())
    assert abs(scale - 1) < min(3 * percent / 100, 0.15)
    true_rig, found_rig, _ = (float(score) for score in re.findall(r"MODA.*: +([-\d.]+)", text))
    assert found_rig > true_rig - 15
