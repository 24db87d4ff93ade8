"""The demo scores honestly: correct results score 100 %, and only videos are used."""

import numpy as np
import pytest

from catfree._run._run import RunOutcome
from catfree.cli import _demo as demo
from catfree.cli._demo import run_demo, score, score_table, truth_in_scene
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.methods.paper._assemble import empty_localization
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Localization, Origin, Plane, Rig, Scene, Tracks

FRAMES = 20


@pytest.fixture(scope="module")
def world():
    return make_world(ring(4, image_size=(320, 180), people=5), frames=FRAMES, people=5)


def answer(world, scale=1.0, registered=None):
    """Make a perfect outcome in its own frame, which is `scale` times as large."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shift = np.array([3.0, -2.0, 0.0])
    rig = world.true_rig
    centers = scale * np.asarray(rig.centers) @ turn.T + shift
    R = np.asarray(rig.R) @ turn.T
    t = -np.einsum("cij,cj->ci", R, centers)
    moved = Rig(rig.K, R, t, rig.image_size, registered=registered)
    scene = Scene.from_rig(moved, Plane(np.array([0.0, 0, 1]), 0.0), metric=True)
    rows = world.walkers.rows(inside_only=False)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    count = len(rows)
    position = scale * np.column_stack([rows[:, 2:], np.zeros(count)]) @ turn.T + shift
    tracks = Tracks(
        frame=rows[:, 0].astype(int),
        track_id=rows[:, 1].astype(int),
        position=position,
        ground_xy=position @ np.asarray(scene.ground.basis, np.float64),
        sigma=np.full(count, 0.1),
        covariance=np.tile(0.01 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.full(count, 4),
        origin=np.full(count, int(Origin.DETECTED)),
    )
    nothing = empty_localization(4)
    count = len(world.detections)
    found = Localization(tracks, nothing.candidates, nothing.thresholds, nothing.reliability, count)
    names = tuple(f"c{camera}" for camera in range(4))
    return RunOutcome(found, world.detections, scene, None, names, np.arange(FRAMES))


@pytest.mark.slow
def test_the_truth_scores_full_marks_in_any_frame(world):
    for result in score(world, answer(world)):
        assert result.detection.moda == pytest.approx(100)
        assert result.tracking.idf1 == pytest.approx(100)
        assert result.hota == pytest.approx(100)
        assert result.tracking.motp == pytest.approx(0, abs=1e-4)
        np.testing.assert_allclose(result.centre_error, 0, atol=1e-4)
        assert result.scale == pytest.approx(1, abs=1e-5)


@pytest.mark.slow
def test_a_wrong_scale_counts_only_after_rigid_alignment(world):
    similar, rigid = score(world, answer(world, scale=1.2))
    assert similar.detection.moda == pytest.approx(100)
    assert similar.scale == pytest.approx(1 / 1.2, rel=1e-5)
    assert rigid.detection.moda < 50
    assert rigid.scale == 1
    assert np.nanmin(rigid.centre_error) > 0.5


@pytest.mark.slow
def test_a_lost_camera_is_told_and_left_out_of_the_alignment(world):
    known = np.array([True, True, False, True])
    outcome = answer(world, registered=known)
    for result in score(world, outcome):
        assert result.detection.moda == pytest.approx(100)
        np.testing.assert_array_equal(np.isfinite(result.centre_error), known)
    table = score_table(score(world, outcome))
    assert ("cameras registered", "3 of 4", "3 of 4") in table.rows


@pytest.mark.slow
def test_truth_is_drawn_where_the_tracks_are(world):
    outcome = answer(world, scale=0.7)
    truth = truth_in_scene(world, outcome.scene)
    tracks = outcome.localization.tracks.to_rows()
    for row in truth[::7]:
        same = (tracks[:, 0] == row[0]) & (tracks[:, 1] == row[1])
        np.testing.assert_allclose(tracks[same][0, 2:], row[2:], atol=1e-4)


@pytest.mark.slow
def test_the_pipeline_gets_the_files_and_nothing_else(tmp_path, monkeypatch):
    """Pictures and report are written, with a given result in place of the pipeline."""
    given, made = [], []
    make = demo.make_demo_world

    def remember(*arguments, **options):
        made.append(make(*arguments, **options))
        return made[-1]

    def pretend(videos, **options):
        given.append((videos, options))
        return answer(made[-1])

    monkeypatch.setattr(demo, "make_demo_world", remember)
    monkeypatch.setattr(demo, "run_stages", pretend)
    _, scores = run_demo(
        tmp_path,
        seed=3,
        cameras=4,
        people=3,
        frames=FRAMES,
        image_size=(320, 180),
        workers=1,
        pictures=False,
    )
    ((videos, options),) = given
    assert set(options) == {"settings", "progress", "workers"}
    assert list(videos) == sorted((tmp_path / "videos").glob("*.mp4"))
    assert scores[0].detection.moda == pytest.approx(100)
    report = (tmp_path / "report.md").read_text()
    assert "Score against the truth" in report
    assert "| MODA (0.5 m) | 100.0 | 100.0 |" in report
    assert "What is easy about this world" in report
    assert "There is no expected MODA below, because the demo" in report


def test_a_demo_that_is_too_short_names_its_own_options(tmp_path):
    size = (64, 36)
    said = (
        "Use longer footage, .* This demo has --cameras 3, --people 2, --frames 4 and --size 64 36:"
    )
    with pytest.raises(InsufficientDataError, match=said):
        run_demo(tmp_path, cameras=3, people=2, frames=4, image_size=size, workers=1)


def test_too_few_cameras_to_align(tmp_path):
    with pytest.raises(InvalidInputError, match="cameras is 2; it must be 3 or more"):
        run_demo(tmp_path, cameras=2)


@pytest.mark.parametrize("size", [(20, 720), (1280, 100_000)])
def test_pictures_that_are_no_videos(tmp_path, size):
    said = f"{size[0]} x {size[1]} pixels; the demo renders 32 to 4096 each way"
    with pytest.raises(InvalidInputError, match=said):
        run_demo(tmp_path / "new", image_size=size)
    assert not (tmp_path / "new").exists()
