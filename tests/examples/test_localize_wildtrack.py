import importlib.util
import json
import sys
from pathlib import Path

import matplotlib
import pytest

from catfree.synthetic import make_world

matplotlib.use("Agg")

SCRIPT = Path(__file__).parents[2] / "examples" / "localize_wildtrack.py"


@pytest.fixture(scope="module")
def example():
    specification = importlib.util.spec_from_file_location("localize_wildtrack", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def sequence_file(tmp_path_factory):
    """A small simulated sequence in metres as uniform JSON."""
    world = make_world("ring4", 3, frames=12, people=6)
    rig, seen = world.true_rig, world.detections
    cameras = [
        {
            "name": f"C{c}",
            "K": rig.K[c].tolist(),
            "dist": [0.0] * 5,
            "R": rig.R[c].tolist(),
            "t": rig.t[c].tolist(),
            "width": 1920,
            "height": 1080,
        }
        for c in range(4)
    ]
    frames = []
    for frame in range(12):
        views = {
            f"C{c}": [
                {"box": box.tolist()}
                for box in seen.box[(seen.frame == frame) & (seen.camera == c)]
            ]
            for c in range(4)
        }
        truth = world.ground_truth[world.ground_truth[:, 0] == frame]
        people = [{"id": int(i), "x": x, "y": y} for _, i, x, y in truth.tolist()]
        frames.append({"frame": 40 * frame, "gt": people, "views": views})
    x_min, x_max, y_min, y_max = world.area
    document = {
        "name": "square",
        "units": "m",
        "fps": 5.0,
        "cameras": cameras,
        "frames": frames,
        "evaluation_area": {"x": [x_min, x_max], "y": [y_min, y_max]},
    }
    path = tmp_path_factory.mktemp("sequence") / "square.json"
    path.write_text(json.dumps(document))
    return path


def test_reports_every_block_the_whole_and_the_filters(example, sequence_file, tmp_path, capsys):
    example.run(sequence_file, "paper", tmp_path)
    text = capsys.readouterr().out
    for part in ("0-160", "200-360", "400-440", "all", "95 % intervals", "tau_sigma", "tau_g"):
        assert part in text
    assert "candidates: " in text
    overall = next(line for line in text.splitlines() if line.split()[:1] == ["all"])
    assert float(overall.split()[1]) > 50
    assert {one.name for one in tmp_path.iterdir()} == {
        "bird_eye.png",
        "bird_eye_ten_frames.png",
        "gates.png",
    }


def test_a_missing_file_is_one_sentence(example, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["localize_wildtrack.py", str(tmp_path / "none.json")])
    with pytest.raises(SystemExit, match=r"There is no file .*none\.json: convert"):
        example.main()
