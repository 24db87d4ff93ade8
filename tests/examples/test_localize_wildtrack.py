import sys

import matplotlib
import pytest

import catfree as cf
from catfree.adapters import read_uniform_json
from catfree.evaluation import detection_metrics_in_area

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def example(load_example):
    return load_example("localize_wildtrack")


@pytest.fixture(scope="module")
def sequence_file(write_sequence):
    return write_sequence(frames=12, people=6)


@pytest.mark.slow
def test_reports_every_block_the_whole_and_the_filters(example, sequence_file, tmp_path, capsys):
    example.run(sequence_file, "paper", tmp_path)
    text = capsys.readouterr().out
    for part in ("0-160", "200-360", "400-440", "all", "95 % intervals", "tau_sigma", "tau_g"):
        assert part in text
    assert "candidates: " in text
    overall = next(line for line in text.splitlines() if line.split()[:1] == ["all"])
    sequence = read_uniform_json(sequence_file)
    tracks = cf.localize(sequence.detections, sequence.scene, cf.Settings.paper()).tracks
    expected = detection_metrics_in_area(
        sequence.ground_truth, tracks.to_rows(), sequence.evaluation_area, sequence.frames
    ).metrics
    assert overall.split()[1:] == [f"{rate:.2f}" for rate in expected.rates]
    assert {one.name for one in tmp_path.iterdir()} == {
        "bird_eye.png",
        "bird_eye_ten_frames.png",
        "gates.png",
    }


def test_a_missing_file_is_one_sentence(example, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["localize_wildtrack.py", str(tmp_path / "none.json")])
    with pytest.raises(SystemExit, match=r"There is no file .*none\.json: convert"):
        example.main()
