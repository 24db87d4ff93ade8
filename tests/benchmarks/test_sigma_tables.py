"""Tables of camera removal, sigma, blocks, unseen rigs and alignment, on tiny twins."""

import csv
import dataclasses
import io
import itertools

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, strategies as st

import catfree as cf
from benchmarks.paper import camera_removal, heldout, leave_one_out, sigma_curve, unseen_rig
from benchmarks.paper.command import Options
from benchmarks.paper.scoring import Score, localize, score
from benchmarks.paper.sequences import twin
from catfree.evaluation import detection_metrics

TINY = Options(seeds=(0,), frames=6)
PAPER = (("paper", cf.Settings.paper()),)


@pytest.fixture(autouse=True)
def one_method(monkeypatch):
    """Use only the paper's method, which compiles faster."""
    for module in (camera_removal, sigma_curve, heldout, leave_one_out, unseen_rig):
        monkeypatch.setattr(module, "METHODS", PAPER)


@pytest.fixture(scope="module")
def wildtrack():
    return twin("WildTrack", 0, 6)


def rows_of(table):
    return list(csv.reader(io.StringIO(table.csv())))


def test_the_first_cameras_keep_their_boxes_and_their_place(wildtrack):
    part = camera_removal.first_cameras(wildtrack, 3)
    assert camera_removal.first_cameras(wildtrack, 7) is wildtrack
    assert part.scene.rig.camera_count == 3
    np.testing.assert_array_equal(part.scene.rig.centers, wildtrack.scene.rig.centers[:3])
    expected = wildtrack.detections.box[wildtrack.detections.camera < 3]
    np.testing.assert_array_equal(part.detections.box, expected)
    assert part.scene.extent == wildtrack.scene.extent


@pytest.mark.slow
def test_fewer_cameras_never_know_better(wildtrack):
    sigmas, cameras = zip(
        *(
            camera_removal.true_geometry(camera_removal.first_cameras(wildtrack, k))
            for k in range(2, 8)
        ),
        strict=True,
    )
    for fewer, more in itertools.pairwise(sigmas):
        assert (more <= fewer * (1 + 1e-4)).all()
    assert (np.diff(cameras, axis=0) >= 0).all()
    assert np.isinf(sigmas[0][cameras[0] < 2]).all()


@pytest.mark.slow
def test_sigma_at_a_person_is_that_of_the_map(wildtrack):
    x, y = wildtrack.ground_truth[0, 2:]
    small = 1e-3
    around = (x - small, x + small, y - small, y + small)
    cell = cf.coverage(wildtrack.true_scene, around, resolution=3 * small)
    sigma, cameras = camera_removal.true_geometry(wildtrack)
    assert cell.cameras[0, 0] == cameras[0]
    assert float(cell.sigma[0, 0]) == pytest.approx(sigma[0], rel=1e-3)


@pytest.mark.slow
def test_camera_removal_has_a_row_a_number_of_cameras_and_a_verdict():
    table = camera_removal.table(TINY)
    rows = rows_of(table)
    assert [row[1] for row in rows[1:]] == ["2", "3", "4", "5", "6", "7"]
    sigma = [float(row[2]) for row in rows[1:]]
    assert sigma == sorted(sigma, reverse=True)
    assert [float(row[3]) for row in rows[1:]] == [76.4, 31.9, 31.2, 20.3, 18.2, 15.2]
    assert len(table.verdicts) == 1
    assert "reproduced**" in table.verdicts[0]


@pytest.mark.slow
def test_two_cameras_are_scored_in_the_gauge_of_all(wildtrack):
    found = localize(wildtrack, cf.Settings.paper())
    whole = camera_removal.score_in_gauge(found, wildtrack, wildtrack)
    assert whole.moda == pytest.approx(score(found, wildtrack, tracking=False).moda)


@given(seed=st.integers(0, 500), count=st.integers(3, 12))
def test_correlations_are_those_of_scipy(seed, count):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=count), rng.integers(0, 5, count).astype(float)
    y[0] += 0.5  # never constant
    pearson, spearman = sigma_curve.pearson(x, y), sigma_curve.spearman(x, y)
    assert pearson == pytest.approx(scipy.stats.pearsonr(x, y).statistic)
    assert spearman == pytest.approx(scipy.stats.spearmanr(x, y).statistic)


def test_the_papers_own_numbers_give_the_papers_correlation():
    sigma = np.array([76.4, 31.9, 31.2, 20.3, 18.2, 15.2, 36.9, 14.9])
    moda = np.array([-8.51, 47.58, 56.20, 66.81, 81.41, 82.46, 33.37, 75.30])
    pearson = float(sigma_curve.pearson(np.log(sigma), moda))
    assert pearson == pytest.approx(sigma_curve.PAPER_PEARSON, abs=0.005)
    spearman = float(sigma_curve.spearman(sigma, moda))
    assert spearman == pytest.approx(sigma_curve.PAPER_SPEARMAN, abs=0.005)


@pytest.mark.slow
def test_resampled_moda_is_that_of_the_frames(wildtrack):
    metrics = score(localize(wildtrack, cf.Settings.paper()), wildtrack, tracking=False).detection
    drawn = sigma_curve.resampled_moda(metrics, np.random.default_rng(0))
    # Blocks as long as the sequence wrap around: every draw contains each frame once.
    np.testing.assert_allclose(drawn, metrics.moda)


@pytest.mark.slow
def test_the_curve_pools_cameras_and_windows():
    table = sigma_curve.table(TINY)
    settings = [row[2] for row in rows_of(table)[1:]]
    assert settings[:7] == [*(f"{k} cameras" for k in range(2, 8)), "frames 0-19"]
    assert sum("correlation" in setting for setting in settings) == 2
    assert len(table.verdicts) == 2


@pytest.mark.parametrize(
    ("values", "outcome"),
    [
        ((-0.95, -0.92), "**reproduced**"),
        ((-0.95, -0.5), "only under conditions (a)"),
        ((0.1, -0.5), "**not reproduced**"),
    ],
)
def test_the_verdict_on_the_curve_is_computed(values, outcome):
    given_values = dict(
        zip((("a", "paper"), ("b", "paper")), ((v, v) for v in values), strict=True)
    )
    assert outcome in sigma_curve.judge(given_values)[0]


def counted(frames=8):
    rng = np.random.default_rng(0)
    truth = np.column_stack([np.repeat(np.arange(frames), 5), np.tile(np.arange(5), frames)])
    truth = np.column_stack([truth, rng.uniform(0, 20, (len(truth), 2))])
    return Score(detection_metrics(truth, truth[rng.uniform(size=len(truth)) < 0.8]))


def test_blocks_add_up_to_the_whole():
    whole = counted()
    halves = [heldout.part_of(whole, np.arange(4)), heldout.part_of(whole, np.arange(4, 8))]
    assert sum(part.detection.tp for part in halves) == whole.detection.tp
    assert sum(part.detection.fn for part in halves) == whole.detection.fn


def test_blocks_are_the_papers(wildtrack):
    frames = np.arange(0, 720, 5)
    long = dataclasses.replace(wildtrack, frames=frames)
    blocks = heldout.blocks(long)
    assert [start for start, _ in blocks] == [0, 200, 400, 600, None]
    assert [len(part) for _, part in blocks] == [40, 40, 40, 24, 144]
    assert all(start in heldout.PAPER for start, _ in blocks)


def test_held_out_blocks_without_data_are_skipped_and_judged_by_their_order():
    table = heldout.table(Options())
    assert table.rows == []
    assert "Skipped" in table.notes[0]
    theirs = {"true": [40.3, 52.5, 54.7], "estimated": [33.4, 48.2, 50.3]}
    same = heldout.judge({("paper", "true"): [20.0, 30.0, 35.0]}, theirs)
    assert "**reproduced**" in same[0]
    other = heldout.judge({("paper", "true"): [50.0, 30.0, 35.0]}, theirs)
    assert "not reproduced" in other[0]


@pytest.mark.slow
def test_the_alignment_table_refits_without_each_camera():
    table = leave_one_out.table(TINY)
    rows = rows_of(table)[1:]
    assert [row[0] for row in rows] == ["wildtrack twin 0", "multiviewx twin 0", "gmvd6 twin 0"]
    for row in rows:
        assert float(row[7]) <= float(row[3]) + 10
        assert float(row[11]) > 0
    assert "points lost" in table.verdicts[0]
    sequence = twin("WildTrack", 0, 6)
    found = leave_one_out.refits(sequence, "paper")
    assert found.value == pytest.approx(
        score(localize(sequence, cf.Settings.paper()), sequence, tracking=False).moda
    )


@pytest.mark.slow
def test_sequences_of_an_installation_share_cameras_and_differ_in_people():
    first, second = unseen_rig.sequence(0, 3), unseen_rig.sequence(1, 3)
    assert second.scene is first.scene
    np.testing.assert_array_equal(first.true_centres, second.true_centres)
    assert len(first.true_centres) == 8
    assert not np.array_equal(first.ground_truth, second.ground_truth)
    assert unseen_rig.centre_error(first.true_scene, first) == pytest.approx(0, abs=1e-4)
    assert 0.02 < unseen_rig.centre_error(first.scene, first) < 0.4


def test_the_unseen_rig_is_judged_by_the_papers_mean():
    assert "**reproduced**" in unseen_rig.judge("refined", "paper", [72.0, 80.0])
    assert "not reproduced" in unseen_rig.judge("refined", "paper", [60.0])


@pytest.mark.slow
def test_the_unseen_rig_table_has_every_rig_and_says_which_failed(monkeypatch):
    first = unseen_rig.sequence(0, 4)
    made = {"disturbed": first.scene, "refined": first.true_scene, "people alone": None}
    monkeypatch.setattr(unseen_rig, "rigs", lambda first, rounds: made)
    table = unseen_rig.table(Options(seeds=(0,), frames=4))
    assert [row[:3] for row in rows_of(table)[1:]] == [
        ["sequence 1", "disturbed", "paper"],
        ["all pooled", "disturbed", "paper"],
        ["sequence 1", "refined", "paper"],
        ["all pooled", "refined", "paper"],
    ]
    assert any("people alone" in note and "refused" in note for note in table.notes)
    assert len(table.verdicts) == 2
