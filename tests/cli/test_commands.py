"""The command line: every command works, and every failure is one sentence."""

import contextlib
import csv
import dataclasses
import inspect
import json
import os
import re
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

import catfree
from catfree import cli
from catfree._coverage import coverage
from catfree._run._report import (
    THRESHOLD_NAMES,
    describe_acceptance,
    describe_cameras,
    describe_reliability,
)
from catfree._run._result_folder import read_results, write_results
from catfree._run._run import RunOutcome
from catfree.adapters import (
    read_anipose_toml,
    read_colmap,
    read_mot,
    read_scene_json,
    read_tracks_csv,
    write_scene_json,
    write_tracks_csv,
)
from catfree.cli._terminal import print_result
from catfree.errors import CatFreeError, InvalidInputError
from catfree.methods._localize import localize
from catfree.methods.paper._assemble import empty_localization
from catfree.settings import Settings
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Detections, Scene, Thresholds, Tracks
from catfree.types._writing import ABANDONED_AFTER
from catfree.viz.page._blocks import (
    Folded,
    Heading,
    Notice,
    Paragraph,
    Picture,
    Table,
    Verdicts,
    Video,
    to_html,
    to_markdown,
)
from tests.known_calibration import calibration_of

commands = pytest.importorskip("catfree.cli._commands")
COMMANDS = commands.COMMANDS

FRAMES, SIZE = 30, (1280, 720)


@pytest.fixture(scope="module")
def world():
    return make_world(ring(3, image_size=SIZE, people=6), frames=FRAMES, people=6)


@pytest.fixture(scope="module")
def outcome(world):
    found = localize(world.detections, world.scene, Settings.paper())
    names = ("north side", "east", "south")
    return RunOutcome(found, world.detections, world.scene, None, names, np.arange(FRAMES))


@pytest.fixture(scope="module")
def results(outcome, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    write_results(folder, outcome, Settings.paper())
    return folder


def one_sentence(capsys):
    """Return the single line on standard error, which names the program, without traceback."""
    error = capsys.readouterr().err.strip()
    assert error.startswith("catfree: ")
    assert "\n" not in error
    assert "Traceback" not in error
    return error


@pytest.mark.slow
def test_every_file_of_the_results_can_be_read_again(results, outcome):
    tracks = read_tracks_csv(results / "tracks.csv")
    np.testing.assert_array_equal(tracks.position, outcome.localization.tracks.position)
    scene, names = read_scene_json(results / "scene.json")
    assert names == outcome.camera_names
    np.testing.assert_allclose(scene.rig.t, outcome.scene.rig.t)
    assert set(read_colmap(results / "rig" / "colmap").names) == {"north_side", "east", "south"}
    assert len(read_anipose_toml(results / "rig" / "calibration.toml").names) == 3
    assert (results / "tracks_mot.txt").read_text().count("\n") == len(tracks)
    boxes = [read_mot(results / "boxes" / f"{name}.txt") for name in outcome.camera_names]
    assert sum(len(table.frame) for table in boxes) == len(outcome.detections)
    localization, _, _ = read_results(results)
    np.testing.assert_array_equal(
        localization.candidates.fate, outcome.localization.candidates.fate
    )
    leftovers = [path for path in results.rglob(".*") if path.is_file()]
    assert leftovers == []


@pytest.mark.slow
def test_what_a_killed_run_left_over_goes_and_all_else_stays(outcome, tmp_path):
    folders = {path.parent for path in write_results(tmp_path, outcome)}
    assert len(folders) > 3
    past = time.time() - 2 * ABANDONED_AFTER
    left, kept = [], []
    for folder in folders:
        left += [folder / f".catfree-{'a' * 32}{suffix}" for suffix in (".csv", ".mp4", "")]
        kept += [folder / f".catfree-{'b' * 32}.csv", folder / f".catfree-{'g' * 32}.csv"]
        kept += [folder / ".tracks.csv.swp"]
    for path in (*left, *kept):
        path.write_text("half")
        if path.name[9] != "b":  # these are being written
            os.utime(path, (past, past))
    write_results(tmp_path, outcome)
    assert not any(path.exists() for path in left)
    assert all(path.exists() for path in kept)


@pytest.mark.slow
def test_every_camera_has_files_of_its_own(outcome, tmp_path):
    alike = dataclasses.replace(outcome, camera_names=("a/b", "a_b", "a b"))
    write_results(tmp_path, alike, pictures=False)
    files = {path.name for path in (tmp_path / "boxes").iterdir()}
    assert files == {"a_b.txt", "a_b_C2.txt", "a b.txt"}
    names = read_colmap(tmp_path / "rig" / "colmap").names
    assert set(names) == {"a/b", "a_b", "a_b_C3"}


@pytest.mark.slow
def test_report_shows_pictures_cameras_and_settings(results, outcome):
    text = (results / "report.md").read_text()
    for needle in (
        "| cameras | 3 of 3 |",
        f"| positions | {len(outcome.localization.tracks)} (",
        "| north side |",
        "| rays.sigma_theta | 0.0206 |",
        "median sigma of a position",
        "`tracks.csv`",
    ):
        assert needle in text
    for path in re.findall(r"!\[[^]]*\]\(([^)]*)\)", text):
        assert cv2.imread(str(results / path)) is not None
    page = (results / "report.html").read_text()
    assert page.count("<table>") == text.count("| --- |\n") or "<table>" in page


@pytest.mark.slow
def test_report_blocks_escape_what_they_show():
    blocks = [
        Heading("a < b", 1),
        Paragraph("see `x & y`"),
        Table(("p|q", "v"), (("<b>", "1"),)),
        Picture('a".png', "view"),
    ]
    page = to_html(blocks)
    for needle in (
        "<h1>a &lt; b</h1>",
        "<code>x &amp; y</code>",
        "<td>&lt;b&gt;</td>",
        'src="a&quot;.png"',
    ):
        assert needle in page
    text = to_markdown(blocks)
    assert "# a \\< b" in text
    assert "| p\\|q | v |\n| --- | --- |\n| \\<b> | 1 |" in text


def test_blocks_of_a_page_are_in_its_text_too():
    blocks = [
        Notice("Warnings", ("Mind <this>.", "And that.")),
        Verdicts((("all well", "4 of 4", True), ("so <so>", "?", None), ("lost", "0", False))),
        Folded("Settings", (Table(("setting", "value"), (("a.b", "1"),)),)),
        Video("overlay.webm", "all & everything"),
    ]
    page, text = to_html(blocks), to_markdown(blocks)
    assert "<p>Mind &lt;this&gt;.</p>" in page
    assert '<td class="check">check</td><td>lost</td>' in page
    assert "<td>so &lt;so&gt;</td>" in page
    assert "<details><summary>Settings</summary><table>" in page
    assert '<video src="overlay.webm" aria-label="all &amp; everything" controls' in page
    assert "http" not in page
    for needle in (
        "## Warnings\n\nMind \\<this>.\n\nAnd that.",
        "| pass | all well | 4 of 4 |\n| unknown | so \\<so> | ? |\n| check | lost | 0 |",
        "## Settings\n\n| setting | value |",
        "[all & everything](overlay.webm)",
    ):
        assert needle in text


@pytest.mark.slow
def test_acceptance_names_what_to_look_at(outcome):
    def verdicts(changed, covered=None):
        _, table = describe_acceptance(changed, covered)
        return {text: passed for text, _, passed in table.rows}

    area = coverage(outcome.scene)
    good = verdicts(outcome, area)
    assert good["every camera has a place"] is True
    assert good["the input raised no warning"] is True
    assert good["two cameras see at least half of the ground"] is (area.covered >= 0.5)
    assert None not in (good["most boxes support a position"],)
    warned = dataclasses.replace(outcome.localization, warnings=("Late.",))
    rig = dataclasses.replace(outcome.scene.rig, registered=np.array([True, True, False]))
    scene = dataclasses.replace(outcome.scene, rig=rig)
    bad = verdicts(dataclasses.replace(outcome, localization=warned, scene=scene))
    assert bad["every camera has a place"] is False
    assert bad["the input raised no warning"] is False
    _, table = describe_acceptance(dataclasses.replace(outcome, localization=warned))
    assert ("the input raised no warning", "1 warning", False) in table.rows
    assert "two cameras see at least half of the ground" not in bad
    nobody = dataclasses.replace(
        outcome,
        localization=empty_localization(3, detection_count=len(outcome.detections)),
    )
    unknown = verdicts(nobody)
    assert unknown["the median sigma is below the radius of a correct position"] is None
    assert unknown["MODA is expected to be at least 50"] is None


@pytest.mark.slow
def test_embeddings_are_written_on_request_only(outcome, tmp_path):
    vectors = np.eye(4)[np.arange(len(outcome.detections)) % 4]
    known = dataclasses.replace(
        outcome, detections=dataclasses.replace(outcome.detections, embedding=vectors)
    )
    write_results(tmp_path, known, pictures=False)
    stored = Detections.load(tmp_path / "detections.npz")
    assert stored.embedding is None
    np.testing.assert_array_equal(stored.box, outcome.detections.box)
    for path in tmp_path.rglob("*"):
        assert path.suffix != ".npz" or "embedding" not in np.load(path).files
    write_results(tmp_path, known, pictures=False, embeddings=True)
    stored = Detections.load(tmp_path / "detections.npz")
    np.testing.assert_array_equal(stored.embedding, vectors)


@pytest.mark.slow
def test_heat_map_shows_what_many_people_did(results, tmp_path, capsys):
    table = tmp_path / "heat.csv"
    words = ["heat-map", str(results), "--cell", "0.05", "--k", "1"]
    words += ["--out", str(table)]
    assert not cli.main(words)
    rows = table.read_text().splitlines()
    assert rows[0] == "x,y,positions"
    assert len(rows) > 2
    assert cv2.imread(str(table.with_suffix(".png"))) is not None
    assert f"{len(rows) - 1} cells" in capsys.readouterr().out
    assert not cli.main(["heat-map", str(results), "--k", "1000"])
    assert (results / "heat_map.csv").read_text() == "x,y,positions\n"
    said = capsys.readouterr().out.splitlines()[0]
    assert "0 cells. No cell was visited by 1000 people" in said
    assert "--k" in said
    assert cli.main(["heat-map", str(results), "--k", "0"]) == 1
    assert cli.main([*words[:-1], str(tmp_path / "other.png")]) == 1  # it would replace the table
    assert "other.csv" in capsys.readouterr().err
    assert not (tmp_path / "other.png").exists()


@pytest.mark.slow
def test_boxes_take_the_identity_of_the_track_they_support(outcome, results):
    for camera, name in enumerate(outcome.camera_names):
        rows = outcome.detections.camera == camera
        identity = outcome.localization.identity[rows]
        assert (identity >= 0).any()
        frame = np.searchsorted(outcome.frames, outcome.detections.frame[rows]) + 1
        written = read_mot(results / "boxes" / f"{name}.txt")
        wanted = np.column_stack([frame, np.where(identity >= 0, identity + 1, -1)])
        got = np.column_stack([written.frame, written.identity])
        np.testing.assert_array_equal(np.unique(got, axis=0), np.unique(wanted, axis=0))


@pytest.mark.slow
def test_results_of_other_detections_are_refused(outcome, tmp_path):
    fewer = dataclasses.replace(outcome, detections=outcome.detections[1:])
    with pytest.raises(InvalidInputError, match="not from these"):
        write_results(tmp_path, fewer, pictures=False)


@pytest.mark.slow
def test_the_version_is_told_without_further_libraries(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "tyro", None)
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"catfree {catfree.__version__}\n"


def test_a_version_that_nobody_reads_is_no_traceback(monkeypatch, capsys):
    def closed(text):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("catfree.cli._main.print_text", closed)
    assert cli.main(["--version"]) == 1
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_evaluate_scores_tracks(world, results, tmp_path, capsys):
    tracks = read_tracks_csv(results / "tracks.csv")
    truth = tmp_path / "truth.csv"
    with truth.open("w") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "id", "x", "y"])
        writer.writerows(tracks.to_rows().tolist())
    assert cli.main(["evaluate", str(results / "tracks.csv"), str(truth)]) == 0
    shown = capsys.readouterr().out
    for measure in ("MODA", "IDF1", "HOTA"):
        assert re.search(rf"{measure}.*100\.00", shown)


def walkers(frames, speeds):
    """Make people who walk straight, by some meters per frame: rows [frame, id, x, y]."""
    frame, person = (grid.ravel() for grid in np.meshgrid(frames, range(len(speeds))))
    return np.column_stack([frame, person, np.take(speeds, person) * frame, 5.0 * person])


@pytest.mark.parametrize("stride", [1, 10])
@pytest.mark.parametrize("shift", [-3, -1, 1, 2])
def test_truth_with_other_numbers_of_frames_is_told(stride, shift):
    frames, by = stride * np.arange(20), stride * shift
    tracks = walkers(frames, np.array([0.2, 0.6, 1.0]) / stride)
    truth = np.add(tracks, [by, 0, 0, 0])
    said = commands._better_numbering(truth, tracks, np.intersect1d(frames, frames + by), 0.5)
    way = "lower" if shift > 0 else "higher"
    assert f"numbers of the truth {abs(by)} {way}, MODA would be 100.00 instead of -" in said
    assert commands._better_numbering(tracks, tracks, frames, 0.5) is None


def test_frames_that_are_off_by_less_than_a_match_are_not_told():
    tracks = walkers(np.arange(20), [0.02, 0.05])
    later = np.add(tracks, [1, 0, 0, 0])
    assert commands._better_numbering(later, tracks, np.arange(1, 20), 0.5) is None
    assert commands._better_numbering(tracks, tracks[:0], np.arange(0), 0.5) is None
    assert commands._better_numbering(tracks[:1], tracks[:1], np.arange(1), 0.5) is None


@pytest.mark.slow
def test_evaluate_warns_of_truth_with_other_numbers(tmp_path, capsys):
    rows = walkers(range(20), [0.6, 0.8])
    n = len(rows)
    ground = np.column_stack([rows[:, 2:], np.zeros(n)])
    columns = (rows[:, 0], rows[:, 1], ground, rows[:, 2:], np.full(n, 0.1), np.zeros((n, 2, 2)))
    write_tracks_csv(tmp_path / "tracks.csv", Tracks(*columns, np.full(n, 2), np.zeros(n)))
    lines = [f"{frame + 1:.0f},{person:.0f},{x},{y}" for frame, person, x, y in rows]
    (tmp_path / "truth.csv").write_text("\n".join(["frame,id,x,y", *lines]))
    words = ["evaluate", str(tmp_path / "tracks.csv"), str(tmp_path / "truth.csv")]
    assert cli.main(words) == 0
    assert "frame numbers of the truth 1 lower" in capsys.readouterr().err


@pytest.mark.slow
def test_evaluate_on_truth_of_some_frames(results, tmp_path, capsys):
    rows = read_tracks_csv(results / "tracks.csv").to_rows()
    truth, words = tmp_path / "truth.csv", ["evaluate", str(results), str(tmp_path / "truth.csv")]
    for step, told in ((5, True), (1, False)):
        chosen = rows[rows[:, 0] % step == 0].tolist()
        lines = ["frame,id,x,y", *(",".join(map(repr, row)) for row in chosen)]
        truth.write_text("\n".join(lines))
        assert cli.main(words) == 0
        shown = capsys.readouterr()
        assert (re.search(r"MODA.*100\.00", shown.out) is None) == told
        assert ("have no true position" in shown.err) == told
        assert cli.main([*words, "--frames", "truth"]) == 0
        alone = capsys.readouterr()
        assert re.search(r"MODA.*100\.00", alone.out)
        assert alone.err == ""
    truth.write_text("frame,id,x,y\n1000,1,0,0\n")
    for scored in ("all", "truth"):
        assert cli.main([*words, "--frames", scored]) == 1
        assert "Use the same frame numbers" in one_sentence(capsys)


@pytest.mark.slow
def test_evaluate_of_a_run_with_a_stride(results, tmp_path, capsys):
    header, *rows = (results / "tracks.csv").read_text().splitlines()
    frames = [int(row.split(",")[header.split(",").index("frame")]) for row in rows]
    truth, part = tmp_path / "truth.csv", tmp_path / "tracks.csv"
    positions = read_tracks_csv(results / "tracks.csv").to_rows().tolist()
    truth.write_text("\n".join(["frame,id,x,y", *(",".join(map(repr, row)) for row in positions)]))
    words = ["evaluate", str(part), str(truth)]
    for chosen, told in (((16, 19, 22, 28), True), ((17, 20, 21, 25), False), (range(30), False)):
        kept = [row for row, frame in zip(rows, frames, strict=True) if frame in chosen]
        part.write_text("\n".join([header, *kept]))
        assert cli.main(words) == 0
        shown = capsys.readouterr()
        assert (shown.err.count("\n") == 1 and "give --frames tracks" in shown.err) == told
        assert told or shown.err == ""
        assert cli.main([*words, "--frames", "tracks"]) == 0
        shown = capsys.readouterr()
        assert shown.err == ""
        # No one was found in frame 25, which is one of the steps.
        assert (re.search(r"recall.*100\.00", shown.out) is None) == (chosen != range(30))
        assert re.search(r"precision.*100\.00", shown.out)
    part.write_text(header + "\n")
    assert cli.main(words) == 0
    assert "holds no positions: everybody counts as missed" in " ".join(
        capsys.readouterr().err.split()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda xy: xy, False),
        (lambda xy: xy + 300, True),  # the frame of a map
        (lambda xy: 100 * xy, True),  # centimeters
        (lambda xy: xy[:, ::-1] * [-1, 1], True),  # its own axes: a few match by chance
    ],
)
def test_evaluate_of_positions_in_another_frame(results, tmp_path, capsys, change, told):
    rows = read_tracks_csv(results / "tracks.csv").to_rows()
    rows[:, 2:] = change(rows[:, 2:])
    truth = tmp_path / "truth.csv"
    truth.write_text("\n".join(["frame,id,x,y", *(",".join(map(repr, r)) for r in rows.tolist())]))
    assert cli.main(["evaluate", str(results), str(truth)]) == 0
    shown = capsys.readouterr()
    assert (shown.err.count("\n") == 1 and "different frames of reference" in shown.err) == told
    assert told or shown.err == ""
    # Also in an area of its own frame where no one was found.
    low, high = rows[:, 2:].min(0), rows[:, 2:].max(0)
    area = [repr(float(value)) for value in (low[0], high[0], low[1], high[1])]
    assert cli.main(["evaluate", str(results), str(truth), "--area", *area]) == 0
    assert ("different frames of reference" in capsys.readouterr().err) == told


@pytest.mark.slow
def test_positions_without_identities_are_scored_and_no_tracks(world, outcome, tmp_path, capsys):
    settings = Settings.paper()
    off = dataclasses.replace(settings.trajectories, enabled=False)
    settings = dataclasses.replace(settings, trajectories=off)
    found = localize(world.detections, world.scene, settings)
    assert len(found.tracks)
    assert (found.tracks.track_id == -1).all()
    alone = dataclasses.replace(outcome, localization=found)
    write_results(tmp_path, alone, settings, pictures=False)
    print_result(alone, tmp_path)
    assert capsys.readouterr().out.startswith(f"0 tracks with {len(found.tracks)} positions")
    assert (read_mot(tmp_path / "tracks_mot.txt").identity == -1).all()
    rows = ["frame,id,x,y", *(",".join(map(repr, row)) for row in world.ground_truth.tolist())]
    (tmp_path / "truth.csv").write_text("\n".join(rows))
    assert cli.main(["evaluate", str(tmp_path), str(tmp_path / "truth.csv")]) == 0
    shown = capsys.readouterr().out
    assert "MODA" in shown
    assert not any(measure in shown for measure in ("MOTA", "IDF1", "HOTA"))


@pytest.mark.slow
def test_evaluate_says_what_is_wrong_with_the_truth(results, tmp_path, capsys):
    truth = tmp_path / "truth.csv"
    truth.write_text("frame,x,y\n0,1,2\n")
    assert cli.main(["evaluate", str(results / "tracks.csv"), str(truth)]) == 1
    assert "no column 'id'" in one_sentence(capsys)
    truth.write_text("frame,id,x,y\n0,1,here,2\n")
    assert cli.main(["evaluate", str(results / "tracks.csv"), str(truth)]) == 1
    assert "here" in one_sentence(capsys)


@pytest.mark.slow
def test_evaluate_needs_somebody_in_the_area(results, tmp_path, capsys):
    truth = tmp_path / "truth.csv"
    truth.write_text("frame,id,x,y\n16,1,2,3\n")
    words = ["evaluate", str(results / "tracks.csv"), str(truth)]
    assert cli.main([*words, "--area", "50", "51", "50", "51"]) == 1
    assert "No position of" in one_sentence(capsys)
    # Finding no one gives a score, not an error.
    assert cli.main([*words, "--area", "1.9", "2", "2.9", "3"]) == 0
    assert "nan" not in capsys.readouterr().out


@pytest.mark.slow
def test_evaluate_names_frames_that_are_no_numbers(results, tmp_path, capsys):
    text = (results / "tracks.csv").read_text().splitlines()
    text[1] = "99999999999999999999" + text[1][text[1].index(",") :]
    (tmp_path / "tracks.csv").write_text("\n".join(text))
    (tmp_path / "truth.csv").write_text("frame,id,x,y\n0,1,2,3\n")
    words = ["evaluate", str(tmp_path / "tracks.csv"), str(tmp_path / "truth.csv")]
    assert cli.main(words) == 1
    assert "column 'frame'" in one_sentence(capsys)


@pytest.mark.slow
def test_plot_refuses_files_of_two_runs(results, outcome, tmp_path, capsys):
    for name in ("localization.npz", "scene.json"):
        (tmp_path / name).write_bytes((results / name).read_bytes())
    rig = outcome.scene.rig.select([0, 1])
    write_scene_json(tmp_path / "scene.json", Scene(rig, outcome.scene.ground, 10.0))
    assert cli.main(["plot", str(tmp_path)]) == 1
    assert "has 2 cameras, but" in one_sentence(capsys)
    assert not (tmp_path / "pictures").exists()


@pytest.mark.slow
def test_a_report_about_nobody_says_so(outcome):
    nobody = empty_localization(3)
    (_, table, *_) = describe_reliability(nobody, outcome.scene)
    assert dict(table.rows)["median sigma of a position"] == "too few people"
    assert not any("nan" in cell for row in table.rows for cell in row)


@pytest.mark.slow
def test_the_report_names_the_height_that_was_assumed(outcome):
    calibration = calibration_of(outcome.scene)
    found = dataclasses.replace(outcome, calibration=calibration)
    text = to_markdown(describe_cameras(found, 1.2))
    assert "average height of 1.20 m" in text
    assert "1.70" not in text


@pytest.mark.slow
def test_thresholds_are_told_in_words(outcome):
    assert set(THRESHOLD_NAMES) == {field.name for field in dataclasses.fields(Thresholds)}
    text = to_markdown(describe_reliability(outcome.localization, outcome.scene))
    assert "| median height of a box (px) |" in text
    assert not any(name in text for name in THRESHOLD_NAMES)


@pytest.mark.slow
def test_plot_draws_again(results, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert cli.main(["plot", str(results), "--out", str(tmp_path / "p")]) == 0
    files = capsys.readouterr().out.split()
    assert all(cv2.imread(file) is not None for file in files)
    assert any(file.endswith("bird_eye.png") for file in files)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "a.mp4", "b.mp4"], "Camera 0: There is no video file or image folder a.mp4."),
        (["run", "a.mp4"], "Camera 0: There is no video file or image folder a.mp4."),
        (["run", "."], "needs at least 2 videos, got 1"),
        (["run", "", "b.mp4"], "Argument 2 is empty"),
        (["localize", "a.csv", "--scene", ""], "--scene is empty"),
        (["plot", ".", "--out="], "--out is empty"),
        (["join", ""], "Argument 2 is empty"),
        (["calibrate", "a.mp4", "b.mp4"], "no video file"),
        (["plot", "nowhere"], "There is no file nowhere/scene.json"),
        (["evaluate", "a.csv", "b.csv"], "There is no file b.csv"),
        (["demo", "--cameras", "2"], "cameras is 2; it must be 3 or more"),
        (["demo", "--seed", "-1"], "seed is -1"),
        (["demo", "--people", "0"], "people is 0"),
        (["demo", "--frames", "0"], "frames is 0"),
        (["demo", "--workers", "0"], "workers is 0"),
        (["demo", "--size", "0", "720"], "size is 0 x 720"),
    ],
)
def test_failures_are_one_sentence(words, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 1
    assert sentence in one_sentence(capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_words_that_make_no_sense_exit_with_two(capsys):
    for words in (["walk"], ["run", "a", "b", "--stride", "x"], []):
        with pytest.raises(SystemExit) as exit_:
            cli.main(words)
        assert exit_.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_results_that_cannot_be_written(outcome, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CatFreeError, match=r"Cannot make the folder .*out"):
        write_results(tmp_path / "file" / "out", outcome, pictures=False)


@pytest.mark.slow
def test_calibrate_and_run_on_footage_without_people(tmp_path, capsys):
    videos = []
    for camera in range(2):
        folder = tmp_path / f"c{camera}"
        folder.mkdir()
        for frame in range(10):
            picture = np.full((90, 160, 3), 100 + camera, np.uint8)
            cv2.imwrite(str(folder / f"{frame}.png"), picture)
        videos.append(str(folder))
    for command in ("calibrate", "run"):
        out = tmp_path / command
        assert cli.main([command, *videos, "--out", str(out)]) == 1
        last = capsys.readouterr().err.strip().splitlines()[-1]
        assert last.startswith("catfree: ")
        assert not (out / "scene.json").exists()
    (tmp_path / "c1" / "9.png").write_bytes(b"no picture")
    for command in ("calibrate", "run"):
        words = ["--keep-before-damage", "--out", str(tmp_path / f"damaged_{command}")]
        assert cli.main([command, *videos, *words]) == 1
        assert len([one for one in capsys.readouterr().err.splitlines() if "catfree: " in one]) == 1
        report = (tmp_path / f"damaged_{command}" / "report.md").read_text()
        assert "Used only the footage before the damage, 9 of 10 instants: Camera 1" in report
    (tmp_path / "anchors.json").write_text('{"cameras": [{"camera": "nord", "height": 4}]}')
    for command in ("calibrate", "run"):  # a misspelled name is reported before detection
        words = ["--anchors", str(tmp_path / "anchors.json"), "--out", str(tmp_path / "misspelled")]
        assert cli.main([command, *videos, *words]) == 1
        assert "camera 'nord', but the cameras are c0, c1" in capsys.readouterr().err
        assert not list(tmp_path.glob("misspelled/cache/*"))


@pytest.mark.parametrize("command", ["calibrate", "run", "localize", "check"])
def test_impossible_options_are_told_before_the_work(command, tmp_path, capsys):
    given = []
    for camera in range(2):
        folder = tmp_path / f"c{camera}"
        folder.mkdir()
        for frame in range(3):
            picture = np.full((90, 160, 3), 100 + camera, np.uint8)
            cv2.imwrite(str(folder / f"{frame}.png"), picture)
        given.append(str(folder))
    (tmp_path / "file").write_text("")
    words = [command, *given, "--cache", str(tmp_path / "cache")]
    if command in ("localize", "check"):
        scene = make_world("ring4", seed=2, frames=4, people=2)
        scene.detections.save(tmp_path / "boxes.npz")
        write_scene_json(tmp_path / "scene.json", scene.scene)
        words[1:3] = [str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "scene.json")]
    for out, option, said in (
        (tmp_path / "out", ["--max-offset", "-4"], "--max-offset is -4; it must be 0 or more."),
        (tmp_path / "file" / "out", [], f"Cannot make the folder {tmp_path / 'file' / 'out'}: "),
        (tmp_path / ("x" * 300), [], "which is too long for a path. Shorten it."),
    ):
        assert cli.main([*words, "--out", str(out), *option]) == 1
        assert said in capsys.readouterr().err
        assert not list(tmp_path.glob("cache/*"))
    assert {path.name for path in tmp_path.iterdir()} <= {
        "c0", "c1", "file", "cache", "boxes.npz", "scene.json"
    }  # fmt: skip


@pytest.mark.slow
def test_run_with_a_known_scene(world, tmp_path, capsys):
    videos = []
    rng = np.random.default_rng(0)
    for camera in range(3):
        still = rng.integers(60, 120, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
        path = tmp_path / f"c{camera}.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, SIZE)
        for _ in range(10):
            writer.write(still)
        writer.release()
        videos.append(str(path))
    scene = tmp_path / "scene.json"
    write_scene_json(scene, world.scene, ["c0", "c1", "c2"])
    out = tmp_path / "out"
    words = ["run", *videos, "--scene", str(scene), "--out", str(out), "--no-pictures"]
    assert cli.main(words) == 0
    assert "0 tracks with 0 positions in 10 frames, from 3 of 3 cameras" in capsys.readouterr().out
    assert json.loads((out / "scene.json").read_text())["cameras"][0]["name"] == "c0"
    assert len(read_tracks_csv(out / "tracks.csv")) == 0
    assert list((out / "cache").glob("boxes-*.npz"))


@pytest.mark.slow
def test_results_are_written_before_the_overlay(world, tmp_path, monkeypatch, capsys):
    videos = []
    for camera in range(1, 4):
        folder = tmp_path / f"c{camera}"
        folder.mkdir()
        for frame in range(10):
            picture = np.full((SIZE[1], SIZE[0], 3), 100 + camera, np.uint8)
            cv2.imwrite(str(folder / f"{frame}.png"), picture)
        videos.append(str(folder))
    scene, out = tmp_path / "scene.json", tmp_path / "out"
    write_scene_json(scene, world.scene)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("catfree.viz.footage._overlay.write_overlay_video", full)
    words = ["run", *videos, "--scene", str(scene), "--out", str(out), "--no-pictures"]
    assert cli.main([*words, "--overlay"]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert (out / "report.html").is_file()


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("localize", "known cameras and ground: .* without it, they are found from the people."),
        ("evaluate", "results folder of a run or of joined shards, .* tracks.parquet."),
        ("shard", "the plan that `catfree plan` wrote."),
    ],
)
def test_help_breaks_lines_only_where_the_terminal_ends(
    command, sentence, capsys, monkeypatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    assert re.search(sentence, capsys.readouterr().out)


@pytest.mark.parametrize("columns", ["40", "300"])
@pytest.mark.parametrize("command", [*COMMANDS, "weights get"])
def test_help_shows_every_word(command, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    shown, _ = re.subn(r"[\s│╭╮╰╯─]", "", capsys.readouterr().out)
    text = inspect.getdoc(inspect.unwrap(COMMANDS[command])) if command in COMMANDS else ""
    words, of_arguments = (text or "").partition("Args:")[::2]
    paragraphs = [words, *re.split(r"\n    \w+: ", of_arguments.partition("Raises:")[0])]
    for paragraph in filter(str.strip, paragraphs):
        assert re.sub(r"\s", "", paragraph) in shown


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (["localize", "[bold]a[1].csv"], "[bold]a[1].csv"),
        (["localize", "a.csv", "--unit", "[red]m[/]"], "'[red]m[/]'"),
        (["localize", "a.csv", "--max-offset", "[3]"], "'[3]'"),
        (["run", "--x[bold]y"], "--x[bold]y"),
        (["[bold]run"], "[bold]run"),
    ],
)
def test_words_in_brackets_are_no_markup(words, shown, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    with contextlib.suppress(SystemExit):
        cli.main(words)
    assert shown in capsys.readouterr().err


@pytest.mark.slow
def test_help_needs_no_video_library():
    script = "import sys, catfree.cli._commands; sys.exit(int('cv2' in sys.modules))"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.mark.slow
def test_a_process_says_one_sentence_about_a_video_that_is_none(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).write_bytes(b"no video" * 100)
    words = ["run", "a.mp4", "b.mp4", "--out", "out"]
    done = subprocess.run(
        [sys.executable, "-m", "catfree", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("catfree: Camera 0: a.mp4 cannot be decoded")
    assert not (tmp_path / "out").exists()
