"""The quick form of the studies: every quantity varies as stated, and files are complete."""

import csv
import dataclasses

import matplotlib
import numpy as np
import pytest

import catfree as cf
from benchmarks.studies import appearance, frames, misses, noise, rig, sweep, tilt
from benchmarks.studies.all import STUDIES

matplotlib.use("Agg")


def heights(sequence):
    return np.median(sequence.detections.height)


def test_noise_moves_boxes_and_nothing_else():
    still, moved = noise.noisy(0, 0, 6), noise.noisy(5, 0, 6)
    np.testing.assert_array_equal(still.ground_truth, moved.ground_truth)
    np.testing.assert_array_equal(still.scene.rig.R, moved.scene.rig.R)
    assert heights(moved) == pytest.approx(heights(still), rel=0.1)
    assert not np.array_equal(still.detections.box[:50], moved.detections.box[:50])


def test_misses_take_away_that_share_of_the_boxes():
    # For a thousand boxes and a few false ones, three standard errors are below 0.05.
    all_found, half = misses.missing(0, 1, 6), misses.missing(45, 1, 6)
    assert len(half.detections) / len(all_found.detections) == pytest.approx(0.55, abs=0.1)


@pytest.mark.parametrize("percent", [0, 43, 80, 100])
def test_quality_is_one_minus_the_ratio_of_the_expected_distances(percent):
    model = appearance.looking_model(percent)
    own = model.view + model.camera + model.noise
    total = model.common + model.identity + own
    same, other = own / total, (own + model.identity) / total
    assert total == pytest.approx(1)
    assert same / other == pytest.approx(1 - percent / 100)


def test_the_default_quality_is_the_models():
    default, wanted = sweep.DetectorModel(), appearance.looking_model(100 * 0.3 / 0.7)
    assert dataclasses.asdict(wanted) == pytest.approx(dataclasses.asdict(default))


@pytest.mark.slow
def test_rig_and_ground_are_off_by_what_the_axis_says():
    for study in (rig, tilt):
        assert study.STUDY.values[0] == 0
    flat, steep = tilt.tilted(0, 0, 2).scene.ground, tilt.tilted(4, 0, 2).scene.ground
    assert np.rad2deg(np.arccos(flat.normal @ steep.normal)) == pytest.approx(4, abs=1e-3)
    right, wrong = rig.wrong_rig(0, 0, 2).scene.rig, rig.wrong_rig(2, 0, 2).scene.rig
    turn = wrong.R @ right.R.transpose(0, 2, 1)
    angle = np.rad2deg(np.arccos((np.trace(turn, axis1=1, axis2=2) - 1) / 2))
    np.testing.assert_allclose(angle, 2, atol=1e-3)


@pytest.mark.slow
def test_windows_share_their_scored_middle():
    short, long = frames.window(8, 0, 6), frames.window(32, 0, 6)
    np.testing.assert_array_equal(short.frames, long.frames)
    assert len(np.unique(short.detections.frame)) == 8
    assert len(np.unique(long.detections.frame)) == 32
    common = long.detections[np.isin(long.detections.frame, short.frames)]
    np.testing.assert_array_equal(common.box, short.detections.box)


@pytest.mark.slow
def test_claimed_and_true_errors_are_in_metres_whatever_the_gauge(monkeypatch):
    """Make a result from the truth, displaced by 10 cm, with a sigma of 20 cm."""
    sequence = sweep.simulate(0, 3, rig_error=sweep.RigError(0, 0, 0, 0, 0))
    scene, truth = sequence.scene, sequence.ground_truth
    align = cf.evaluation.align_centres(scene.rig.centers, sequence.true_centres)
    world = np.column_stack([truth[:, 2] + 0.1, truth[:, 3], np.zeros(len(truth))])
    position = np.asarray(align.inverse()(world), np.float64)
    sigma = 0.2 / float(align.scale)
    count = len(truth)
    tracks = cf.Tracks(
        frame=truth[:, 0].astype(int),
        track_id=truth[:, 1].astype(int),
        position=position,
        ground_xy=position @ np.asarray(scene.ground.basis),
        sigma=np.full(count, sigma),
        covariance=np.tile(sigma**2 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.full(count, 3),
        origin=np.zeros(count, int),
    )
    found = type("Found", (), {"tracks": tracks})
    monkeypatch.setattr(sweep.cf, "localize", lambda *_: found)
    result = sweep.measure(sequence, cf.Settings())
    assert result["moda"] > 99  # people within 10 cm of the border may leave the area
    assert result["error_m"] == pytest.approx(0.1, abs=1e-3)
    assert result["claimed_error_m"] == pytest.approx(0.2 * np.sqrt(2 * np.log(2)), abs=1e-3)
    assert result["coverage_percent"] == 100


@pytest.mark.slow
def test_a_quick_study_writes_its_table_and_its_figure(tmp_path, capsys):
    sweep.main(tilt.STUDY, ["--quick", "--out", str(tmp_path)])
    with (tmp_path / "tilt.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(tilt.STUDY.quick)
    assert {row["method"] for row in rows} == set(sweep.METHODS)
    paper, evidence = (
        [float(row["moda"]) for row in rows if row["method"] == method] for method in sweep.METHODS
    )
    assert (np.array(evidence) > paper).all()
    assert (tmp_path / "tilt.png").stat().st_size > 10_000
    assert "tilt 2: MODA paper" in capsys.readouterr().out


@pytest.mark.slow
def test_a_figure_can_hold_values_without_any_pair(tmp_path):
    nothing = {
        "moda": 0.0,
        "error_m": np.nan,
        "claimed_error_m": np.nan,
        "coverage_percent": np.nan,
    }
    records = [
        {"study": "noise", "value": value, "seed": 0, "method": method} | nothing
        for value in (0.0, 1.0)
        for method in sweep.METHODS
    ]
    sweep.draw(noise.STUDY, records, tmp_path / "empty.png")
    assert (tmp_path / "empty.png").exists()


def test_every_study_has_its_own_name_and_ascending_values():
    assert len({study.name for study in STUDIES}) == len(STUDIES) == 6
    for study in STUDIES:
        assert list(study.values) == sorted(study.values)
        assert 2 <= len(study.quick) < len(study.values)
