"""The tables of `benchmarks/paper`: rendering, verdicts and computation, on tiny twins."""

import csv
import dataclasses
import importlib
import io

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from benchmarks.paper import claims, coverage, sequences
from benchmarks.paper.command import Options
from benchmarks.paper.scoring import Score, ground_rows, localize, pool, score_rows
from benchmarks.paper.sequences import TWINS, real, scenarios, twin, without_embeddings
from benchmarks.paper.staged import localize_staged
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BF, BK, BS, BT, I, K, Q, changed
from catfree.evaluation import Interval, detection_metrics
from catfree.geometry._similarity import transform_scene

pytestmark = pytest.mark.slow

TINY = Options(seeds=(0,), frames=5)
TWIN_COLUMNS = ["WildTrack twin", "MultiviewX twin", "GMVD twin"]


def test_a_table_as_markdown_and_csv():
    table = Table("T", ["name", "a|b"], [("x", 1.25), ("y", None)], ["A note."], ["A claim."])
    assert table.markdown() == (
        "## T\n\n| name | a\\|b |\n|---|---|\n| x | 1.2 |\n| y |  |\n\n"
        "- A note.\n\n**Claims**\n\n- A claim.\n"
    )
    assert table.csv() == "name,a|b\nx,1.25\ny,\n"


def test_an_interval_has_three_columns_as_csv_and_one_as_markdown():
    table = Table("T", ["name", "MODA"], [("x", Interval(1.0, 3.5, 2.25)), ("y", "-")])
    assert table.csv() == "name,MODA,MODA low,MODA high\nx,2.25,1.0,3.5\ny,-,,\n"
    assert "| x | 2.2 [1.0, 3.5] |" in table.markdown()


@given(st.lists(st.tuples(st.text(), st.floats(allow_nan=False)), max_size=5))
def test_csv_keeps_every_cell(rows):
    rows = [(text.replace("\r", ""), number) for text, number in rows]
    read = list(csv.reader(io.StringIO(Table("T", ["text", "number"], rows).csv())))
    assert read[0] == ["text", "number"]
    assert [(text, float(number)) for text, number in read[1:]] == rows


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        Table("T", ["a", "b"], [("x",)])


def test_a_table_is_written_twice(tmp_path):
    table = Table("T", ["a"], [(1,)])
    table.write(tmp_path / "new", "t")
    assert (tmp_path / "new" / "t.md").read_text() == table.markdown()
    assert (tmp_path / "new" / "t.csv").read_text() == table.csv()


def scored(found: list[tuple[int, int]]) -> Score:
    """Make a score of frames with (true positives, misses), no false positives."""
    truth, predicted = [], []
    for frame, (hits, misses) in enumerate(found):
        truth += [[frame, person, 10.0 * person, 0.0] for person in range(hits + misses)]
        predicted += truth[len(truth) - hits - misses : len(truth) - misses]
    return Score(
        detection_metrics(np.array(truth), np.array(predicted).reshape(-1, 4), range(len(found)))
    )


FRAMES = st.lists(st.integers(0, 4).map(lambda hits: (hits, 4 - hits)), min_size=4, max_size=12)


@given(FRAMES, st.randoms(use_true_random=False))
def test_the_difference_is_that_of_moda_and_changes_sign(one, random):
    other = random.sample(one, len(one))
    first, second = scored(one), scored(other)
    forth, back = claims.difference(first, second), claims.difference(second, first)
    assert forth.value == pytest.approx(first.moda - second.moda)
    assert forth.value == pytest.approx(-back.value)
    assert (forth.low, forth.high) == pytest.approx((-back.high, -back.low))
    itself = claims.difference(first, first)
    assert (itself.low, itself.value, itself.high) == (0, 0, 0)


def test_differences_of_different_frames_are_refused():
    with pytest.raises(ValueError, match="different frames"):
        claims.difference(scored([(4, 0)] * 4), scored([(4, 0)] * 5))


def test_pooled_scores_add_their_counts():
    one, two = scored([(4, 0)] * 4), scored([(2, 2)] * 4)
    assert pool([one, two]).moda == pytest.approx(75.0)
    low, high, value = pool([one, two]).intervals.moda
    assert low <= value <= high
    assert low < high


BETTER, WORSE, UNSURE = Interval(1, 3, 2), Interval(-3, -1, -2), Interval(-1, 2, 1)


@pytest.mark.parametrize(
    ("gains", "verdict"),
    [
        ({"A": BETTER, "B": UNSURE}, claims.REPRODUCED),
        ({"A": BETTER, "B": WORSE, "C": UNSURE}, claims.CONDITIONAL),
        ({"A": WORSE, "B": UNSURE}, claims.NOT_REPRODUCED),
        ({"A": UNSURE, "B": Interval(0, 0, 0)}, claims.OPEN),
        ({}, claims.UNTESTED),
    ],
)
def test_a_verdict_follows_from_the_intervals(gains, verdict):
    sentence = claims.higher("It helps", gains)
    assert sentence.startswith(f"It helps: **{verdict}**")
    for place, gain in gains.items():
        assert f"{place} ({gain.value:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}])" in sentence
    assert ("open on" in sentence) == any(gain.low <= 0 <= gain.high for gain in gains.values())


def test_only_a_sure_loss_is_harm():
    assert f"**{claims.REPRODUCED}**" in claims.not_lower("No harm", {"A": BETTER, "B": UNSURE})
    assert f"**{claims.CONDITIONAL}**" in claims.not_lower("No harm", {"A": BETTER, "B": WORSE})
    assert f"**{claims.NOT_REPRODUCED}**" in claims.not_lower("No harm", {"B": WORSE})


def test_a_change_within_the_tolerance_is_none():
    gains = {"A": Interval(-1, 1, -0.4), "B": Interval(-1, 2, 0.6)}
    assert f"**{claims.REPRODUCED}**" in claims.alike("No effect", gains, 0.6)
    assert f"**{claims.CONDITIONAL}**" in claims.alike("No effect", gains, 0.5)
    assert f"**{claims.NOT_REPRODUCED}**" in claims.alike("No effect", gains, 0.3)


def test_the_papers_value_inside_or_outside_our_worlds():
    said = claims.within("MODA", {"A": 82.0, "B": 60.0}, {"A": [80, 84], "B": [70, 75]})
    assert said == (
        "MODA: **reproduced only under conditions**: on A (82.0 inside 80.0 to 84.0); "
        "not on B (60.0 below 70.0 to 75.0)."
    )


def test_missing_data_is_one_sentence(capsys, tmp_path):
    assert list(real(tmp_path)) == []
    assert list(scenarios(tmp_path)) == []
    assert list(real(tmp_path)) == []
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        f"Skipped: no real sequences in {tmp_path}.",
        f"Skipped: no scenarios in {tmp_path}.",
    ]


@pytest.mark.parametrize("made", TWINS, ids=lambda made: made.layout)
def test_twins_have_bystanders_groups_and_people_who_stand(made):
    sequence = twin(made.paper, 0, 4)
    assert sequence.world is not None
    assert sequence.true_scene is not None
    walkers = sequence.world.walkers
    assert walkers.background.any()
    assert np.bincount(walkers.group).max() > 1
    speed = np.linalg.norm(walkers.velocity, axis=-1)[walkers.inside]
    assert 0.05 < np.mean(speed < 0.2) < 0.6
    assert not sequence.scene.metric
    assert sequence.true_scene.metric
    assert sequence.identified
    bare = without_embeddings(sequence)
    assert bare.detections.embedding is None
    np.testing.assert_array_equal(bare.detections.box, sequence.detections.box)


def test_the_truth_scores_one_hundred():
    sequence = twin("WildTrack", 0, 4)
    assert score_rows(sequence.ground_truth, sequence).moda == 100


@pytest.fixture
def four_cameras(monkeypatch):
    """Make twins of four cameras and six people: one shape to compile for."""
    small = tuple(dataclasses.replace(made, layout="ring4", people=6) for made in TWINS)
    monkeypatch.setattr(sequences, "TWINS", small)


VARIANTS = {
    **{"BT": BT, "BS": BS, "BK": BK, "BF": BF, "Q": Q, "K": K, "I": I},
    "single ray": changed(BT, triangulation={"estimator": "single_ray"}),
    "best pair": changed(BT, triangulation={"estimator": "best_pair"}),
    "no trajectories": changed(BT, trajectories={"enabled": False}),
}


@pytest.mark.usefixtures("four_cameras")
@pytest.mark.parametrize("name", VARIANTS)
def test_remembered_stages_change_nothing(name):
    sequence = twin("WildTrack", 0, 5)
    wanted = cf.localize(sequence.detections, sequence.scene, VARIANTS[name])
    found = localize_staged(sequence, sequence.scene, VARIANTS[name])
    assert len(wanted.tracks) > 0
    for field, value in vars(wanted.tracks).items():
        np.testing.assert_array_equal(getattr(found.tracks, field), value, err_msg=field)
    np.testing.assert_array_equal(found.candidates.fate, wanted.candidates.fate)
    assert found.thresholds.tau_sigma == wanted.thresholds.tau_sigma
    assert found.thresholds.tau_g == wanted.thresholds.tau_g


@pytest.mark.usefixtures("four_cameras")
def test_the_gauge_of_a_scene_does_not_change_the_score():
    sequence = twin("WildTrack", 0, 5)
    assert sequence.world is not None
    assert sequence.true_scene is not None
    moved = transform_scene(sequence.world.scene_from_world, sequence.true_scene, metric=False)
    elsewhere = dataclasses.replace(sequence, scene=moved)
    rows = ground_rows(localize(sequence, BT, true_rig=True).tracks, sequence, sequence.true_scene)
    again = ground_rows(localize(elsewhere, BT).tracks, elsewhere)
    assert len(rows) > 0
    np.testing.assert_allclose(again, rows, atol=2e-3)  # float32 in a gauge of another size


@given(
    st.lists(st.tuples(st.booleans(), st.integers(0, 5)), min_size=2, max_size=12).filter(
        lambda pairs: len({right for right, _ in pairs}) == 2
    )
)
def test_the_area_under_the_curve_counts_ordered_pairs(pairs):
    right = np.array([right for right, _ in pairs])
    distance = np.array([float(distance) for _, distance in pairs])
    wins = np.sign(distance[~right][:, None] - distance[right][None])
    expected = (wins + 1).mean() / 2
    assert coverage.area_under_curve(right, distance) == pytest.approx(expected)


def test_the_nearest_row_is_of_the_same_frame():
    points = np.array([[0, 0, 0.0, 0.0], [1, 0, 0.0, 0.0], [2, 0, 0.0, 0.0]])
    others = np.array([[0, 0, 3.0, 4.0], [1, 0, 0.3, 0.4], [1, 1, 9.0, 9.0]])
    np.testing.assert_allclose(coverage.nearest(points, others), [5.0, 0.5, np.inf])


EXPECTED = {
    "twins": ["property", "WildTrack", "paper", "MultiviewX", "GMVD", "GMVD c2"],
    "gates": ["Variant", *TWIN_COLUMNS, "Mean twins", "WildTrack, rough ground"],
    "gates_unseen": ["Variant", "GMVD c2 paper", "GMVD c2 twin", "seed 0"],
    "baselines": ["Variant", *TWIN_COLUMNS, "Mean paper"],
    "score_stage": ["Variant", *TWIN_COLUMNS, "GMVD c2 twin"],
    "lineage": ["Variant", "Settings", *TWIN_COLUMNS],
    "trajectory_rules": ["Variant", *TWIN_COLUMNS],
    "quantile": ["Variant", *TWIN_COLUMNS],
    "coverage": ["Stage", *TWIN_COLUMNS],
    "failure": ["Apart", "Filter", "0-10°", "75-90°"],
    "main_results": ["Data", "Method", "MODA", "MODP", "Precision", "Recall", "IDF1", "HOTA"],
    "runtime": ["Data", "Method", "Frames", "Boxes", "Total", "association"],
}


@pytest.mark.usefixtures("four_cameras")
@pytest.mark.parametrize(
    "name",
    list(EXPECTED),
)
def test_a_table_on_tiny_twins(name):
    module = importlib.import_module(f"benchmarks.paper.{name}")
    made = module.table(TINY, 2000) if name == "failure" else module.table(TINY)
    assert [column for column in EXPECTED[name] if column not in made.columns] == []
    labels = [str(row[0]) for row in made.rows]
    if name not in ("twins", "failure", "runtime"):
        assert [label for label in module.PAPER if label not in labels] == []
    assert all(sentence.count("**") == 2 for sentence in made.verdicts)
    assert made.markdown().count("\n|") == len(made.rows) + 2
