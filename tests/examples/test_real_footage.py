"""The example of real footage: its score against a direct one, and all of its stages."""

import dataclasses

import numpy as np
import pytest

import catfree as cf
from catfree.adapters import MultiViewSequence
from catfree.evaluation import detection_metrics, tracking_metrics
from catfree.geometry._similarity import Similarity, transform_scene
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def world():
    return make_world("ring6", 0, frames=20, people=6)


@pytest.fixture(scope="module")
def truth(world):
    return MultiViewSequence(
        "ring6", world.detections, world.true_rig, world.true_scene, world.ground_truth,
        np.arange(20), tuple("abcdef"),
    )  # fmt: skip


@pytest.fixture
def example(load_example):
    return load_example("real_footage")


def outcome_of(world, scene):
    found = cf.localize(world.detections, scene)
    return cf.RunOutcome(found, world.detections, scene, None, tuple("abcdef"), np.arange(20))


def test_the_true_rig_is_scored_as_it_stands(world, truth, example):
    outcome = outcome_of(world, world.true_scene)
    found, rows = example.score(outcome, truth), outcome.localization.tracks.to_rows()
    direct = detection_metrics(world.ground_truth, rows, range(20), threshold=0.5)
    assert found.moda == pytest.approx(direct.moda)
    assert found.recall == pytest.approx(direct.recall)
    assert found.idf1 == pytest.approx(tracking_metrics(world.ground_truth, rows, range(20)).idf1)
    assert found.scale == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(found.camera_error, 0, atol=1e-4)  # of float32


def test_frame_and_scale_of_the_rig_do_not_matter(world, truth, example):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = transform_scene(Similarity(2.0, turn, np.array([3.0, -1, 0])), world.true_scene)
    moved = dataclasses.replace(moved, metric=False)
    found = example.score(outcome_of(world, moved), truth)
    assert found.scale == pytest.approx(0.5)
    np.testing.assert_allclose(found.camera_error, 0, atol=1e-4)  # of float32
    assert found.moda == pytest.approx(
        example.score(outcome_of(world, world.true_scene), truth).moda, abs=2.0
    )


def test_campus_from_video_to_scores(shared, example, tmp_path, monkeypatch, capsys):
    folder = shared / "data" / "real" / "epfl_campus4"
    if not folder.is_dir():
        pytest.skip("needs shared/data/real/epfl_campus4")
    videos = [str(folder / f"campus4-c{camera}.mp4") for camera in range(3)]
    options = ["--truth", str(folder / "campus.json"), "--stride", "10", "--end", "500"]
    monkeypatch.setattr("sys.argv", ["real_footage.py", *videos, *options, "--out", str(tmp_path)])
    example.main()
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("3 cameras, 50 instants")
    assert [line.split(":")[0] for line in said[1:]] == [
        "foreground, rig from people",
        "foreground, given rig",
    ]
    assert "MODA" in said[2]
    assert (tmp_path / "foreground_given_rig" / "report.html").is_file()
