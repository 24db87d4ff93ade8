"""The commands for long recordings: each works, and every failure is one sentence."""

import contextlib
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import catfree as cf
from catfree import cli
from catfree._worker import ONE_THREAD
from catfree.adapters import write_anipose_toml, write_detections_parquet, write_scene_json
from catfree.cli._shard_commands import _scene_for
from catfree.errors import InvalidInputError
from catfree.synthetic import make_world

pytest.importorskip("tyro")
pytest.importorskip("pyarrow")

CUT = ("--every", "6", "--overlap", "3", "--frame-rate", "5")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write a folder with boxes of twelve seconds, their scene, and lists of sites."""
    folder = tmp_path_factory.mktemp("recording")
    world = make_world("ring4", frames=60, people=4)
    write_detections_parquet(folder / "boxes.parquet", world.detections)
    alive = world.detections.camera != 3
    write_detections_parquet(folder / "dead.parquet", world.detections[alive])
    write_scene_json(folder / "scene.json", world.true_scene, list("abcd"))
    site = '[[site]]\nname = "{}"\nframe_rate = 5\nscene = "scene.json"\ndetections = "{}"\n'
    options = "every = 6\noverlap = 3\n"
    lists = {
        "good": options + site.format("north", "boxes.parquet"),
        "dead": options + site.format("north", "dead.parquet"),
        "half": options + site.format("gone", "x.npz") + site.format("north", "boxes.parquet"),
        "twice": site.format("north", "boxes.parquet") + site.format("north", "boxes.parquet"),
        "unknown": "colour = 3\n" + site.format("north", "boxes.parquet"),
        "empty": "every = 6\n",
    }
    (folder / "mot").mkdir()
    (folder / "mot" / "a.txt").write_text("1,-1,10,10,20,50,0.9,-1,-1,-1\n")
    (folder / "results").mkdir()
    for name in ("detections.npz", "tracks.parquet"):
        (folder / "results" / name).touch()
    for name, text in lists.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


@pytest.fixture
def in_threads(monkeypatch):
    """Run shards in threads of this process, which has already compiled the code."""

    @contextlib.contextmanager
    def workers(count=None):
        with ThreadPoolExecutor(count or 1) as pool:
            yield pool

    monkeypatch.setattr("catfree._run.sharded._executors.spawned_workers", workers)


def last_sentence(capsys):
    """Return the last line on standard error, which names the program, without traceback."""
    error = capsys.readouterr().err.strip()
    assert "Traceback" not in error
    last = error.splitlines()[-1]
    assert last.startswith("catfree: ")
    return last


@pytest.mark.slow
def test_plan_then_shards_then_join(files, tmp_path, capsys):
    out = tmp_path / "one day"
    plan = out / "_shards" / "plan.json"
    words = [str(files / "boxes.parquet"), "--scene", str(files / "scene.json"), *CUT]
    assert cli.main(["plan", *words, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    each = f"catfree shard --plan '{plan}' --index N"
    assert f"{plan} is the plan. Run `{each}` with N from 0 to 1, then" in said
    assert f"`catfree join '{out}'`." in said
    for index in (1, 0):
        assert cli.main(["shard", "--plan", str(plan), "--index", str(index)]) == 0
        assert f"Shard {index} of 2 is finished: " in capsys.readouterr().out
    assert cli.main(["join", str(out)]) == 0
    day = cf.open_tracks(out)
    said = capsys.readouterr().out
    assert said == f"{out}: {day.people} people, {len(day)} positions.\n"
    assert day.people > 0
    assert day.camera_names == ("a", "b", "c", "d")
    assert [(part.first, part.stop) for part in day.parts] == [(0, 30), (30, 60)]
    import pyarrow.dataset

    table = pyarrow.dataset.dataset(out, format="parquet")
    assert table.count_rows() == len(day)
    assert json.loads(table.schema.metadata[b"camera_names"]) == ["a", "b", "c", "d"]
    truth = tmp_path / "truth.csv"
    np.savetxt(truth, day.read().to_rows(), "%.6f", ",", header="frame,id,x,y", comments="")
    assert cli.main(["evaluate", str(out), str(truth)]) == 0
    assert "100.00" in capsys.readouterr().out  # tracks scored against themselves
    assert cli.main(["heat-map", str(out), "--k", "1"]) == 1
    assert "--out" in last_sentence(capsys)
    heat = tmp_path / "heat.csv"
    assert cli.main(["heat-map", str(out), "--k", "1", "--out", str(heat)]) == 0
    assert (
        np.loadtxt(heat, delimiter=",", skiprows=1)[:, 2].sum() == (day.read().track_id >= 0).sum()
    )
    assert cli.main(["plot", str(out)]) == 1
    assert f"catfree heat-map '{out}' --out" in last_sentence(capsys)
    # Neither command repeats finished work.
    before = {path: path.stat().st_mtime_ns for path in (out / "_shards").glob("part-*")}
    assert len(before) == 6
    assert cli.main(["shard", "--plan", str(plan), "--index", "0"]) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_a_plan_can_be_run_from_any_folder(files, tmp_path, monkeypatch):
    monkeypatch.chdir(files)
    words = ["boxes.parquet", "--scene", "scene.json", "--method", "paper", *CUT]
    assert cli.main(["plan", *words, "--out", str(tmp_path)]) == 0
    document = json.loads((tmp_path / "_shards" / "plan.json").read_text())
    assert {tuple(row["camera_names"]) for row in document["shards"]} == {("a", "b", "c", "d")}
    assert document["scene"] == str(files / "scene.json")
    assert document["out"] == str(tmp_path)
    assert document["method"] == "paper"
    assert {row["detections"] for row in document["shards"]} == {str(files / "boxes.parquet")}


def test_shards_of_a_scene_of_another_unit_are_in_meters(files, tmp_path, monkeypatch):
    scene = make_world("ring4", frames=2, people=1).true_scene
    path = write_anipose_toml(tmp_path / "c.toml", scene.rig, list("abcd"), metres_per_unit=0.01)
    given = []

    def run(shard, *, scene, **options):
        given.append(scene.rig.centers)
        raise InvalidInputError("Enough.")

    monkeypatch.setattr("catfree._run.sharded._run_shard.run_shard", run)
    words = [str(files / "boxes.parquet"), "--scene", str(path), "--unit", "cm", *CUT]
    assert cli.main(["plan", *words, "--out", str(tmp_path)]) == 0
    plan = str(tmp_path / "_shards" / "plan.json")
    assert cli.main(["shard", "--plan", plan, "--index", "0"]) == 1
    np.testing.assert_allclose(given[0], scene.rig.centers, atol=1e-4)


@pytest.mark.parametrize("name", ["boxes.PARQUET", "folder"])
def test_endings_of_files_of_boxes_may_be_in_capitals(files, tmp_path, name):
    recording = tmp_path / name
    held = recording / "a.PARQUET" if name == "folder" else recording
    held.parent.mkdir(exist_ok=True)
    held.write_bytes((files / "boxes.parquet").read_bytes())
    words = [str(recording), "--scene", str(files / "scene.json"), *CUT]
    assert cli.main(["plan", *words, "--out", str(tmp_path / "day")]) == 0


def test_a_plan_knows_which_pictures_are_missing(files, tmp_path, monkeypatch):
    monkeypatch.chdir(files)
    (tmp_path / "missing.csv").write_text("frame,camera\n7,1\n8,1\n50,0\n")
    words = ["boxes.parquet", "--scene", "scene.json", "--silent", str(tmp_path / "missing.csv")]
    assert cli.main(["plan", *words, *CUT, "--out", str(tmp_path)]) == 0
    document = json.loads((tmp_path / "_shards" / "plan.json").read_text())
    assert [row["silent"] for row in document["shards"]] == [[[1, 7, 9]], [[0, 50, 51]]]
    # The results of a run already state it.
    cf.adapters.read_detections_parquet("boxes.parquet").save(tmp_path / "detections.npz")
    (tmp_path / "missing_pictures.csv").write_text("frame,camera\n7,b\n8,b\n50,a\n")
    words = [str(tmp_path / "detections.npz"), "--scene", "scene.json"]
    assert cli.main(["plan", *words, *CUT, "--out", str(tmp_path / "again")]) == 0
    document = json.loads((tmp_path / "again" / "_shards" / "plan.json").read_text())
    assert [row["silent"] for row in document["shards"]] == [[[1, 7, 9]], [[0, 50, 51]]]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["boxes.parquet", "--scene", "x.json"], "There is no file x.json"),
        (["a.mp4", "--scene", "scene.json"], "Camera 0: There is no video file"),
        (["--scene", "scene.json"], "at least 2 videos, got 0"),
        (["a.mp4", "b.mp4", "--scene", "scene.json"], "Camera 0: There is no video file"),
        (["x.npz", "--scene", "scene.json"], "x.npz"),
        (["results", "--scene", "scene.json"], "results holds files that end like boxes, not"),
        (["mot", "--scene", "scene.json"], "mot holds files that end like boxes, not like a"),
        (["boxes.parquet", "--scene", "scene.json"], "are undefined. Give --frame-rate, or in a"),
        (["boxes.parquet", "--scene", "scene.json", *CUT[2:], "--every", "2"], "longer than"),
        (["boxes.parquet", "--scene", "scene.json", *CUT, "--detector", "a"], "--detector and"),
        (["boxes.parquet", "--scene", "scene.json", *CUT, "--offsets", "0", "1"], "to videos"),
    ],
)
def test_what_cannot_be_planned(files, tmp_path, monkeypatch, capsys, words, sentence):
    monkeypatch.chdir(files)
    assert cli.main(["plan", *words, "--out", str(tmp_path / "day")]) == 1
    assert sentence in last_sentence(capsys)
    assert not (tmp_path / "day").exists()


@pytest.fixture(scope="module")
def planned(files, tmp_path_factory):
    out = tmp_path_factory.mktemp("planned")
    words = [str(files / "boxes.parquet"), "--scene", str(files / "scene.json"), *CUT]
    assert cli.main(["plan", *words, "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize(
    ("index", "change", "sentence"),
    [
        ("2", None, "There is no shard 2: the plan counts them from 0 to 1"),
        ("-1", None, "There is no shard -1"),
        ("0", lambda text: text[:99], "is not valid JSON"),
        ("0", lambda text: text.replace("plan 1", "plan 9"), "a plan of another version"),
        ("0", lambda text: text.replace('"first"', '"begin"'), "is damaged"),
        ("0", lambda text: text.replace("boxes.parquet", "x.parquet"), "Cannot read"),
        ("0", lambda text: text.replace("scene.json", "x.json"), "There is no file"),
    ],
)
def test_a_shard_that_cannot_be_run(planned, tmp_path, capsys, index, change, sentence):
    text = (planned / "_shards" / "plan.json").read_text()
    plan = tmp_path / "plan.json"
    plan.write_text(text if change is None else change(text))
    assert cli.main(["shard", "--plan", str(plan), "--index", index]) == 1
    assert sentence in last_sentence(capsys)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["shard", "--plan", "none.json", "--index", "0"], "There is no file none.json"),
        (["join", "nowhere"], "There is no folder nowhere"),
        (["join", "."], "holds no finished shard. Run catfree shard first."),
        (["run-sites", "none.toml", "--out", "o"], "catfree: There is no file none.toml"),
        (["run-sites", "unknown.toml", "--out", "o"], "no key 'colour'; it has every"),
        (["run-sites", "twice.toml", "--out", "o"], "'north'"),
        (["run-sites", "empty.toml", "--out", "o"], "has no [[site]]"),
        (["run-sites", "good.toml", "--out", "o", "--workers", "0"], "workers is 0"),
        (["run-sites", "good.toml", "--out", "o", "--dask", "d", "--workers", "1"], "--workers is"),
    ],
)
def test_failures_are_one_sentence(files, tmp_path, monkeypatch, capsys, words, sentence):
    for path in files.glob("*.toml"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 1
    assert sentence in last_sentence(capsys)
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("in_threads")
def test_sites_that_are_complete_are_listed(files, tmp_path, capsys):
    assert cli.main(["run-sites", str(files / "good.toml"), "--out", str(tmp_path)]) == 0
    folder = tmp_path / "site=north"
    day = cf.open_tracks(folder)
    said = capsys.readouterr()
    assert said.out == f"{folder}: {day.people} people, {len(day)} positions.\n"
    assert "tracking people by shards" in said.err
    assert "2/2" in said.err


@pytest.mark.slow
@pytest.mark.usefixtures("in_threads")
def test_a_site_with_a_camera_that_fails_is_warned_of(files, tmp_path, capsys):
    assert cli.main(["run-sites", str(files / "dead.toml"), "--out", str(tmp_path)]) == 0
    first, second = cf.open_tracks(tmp_path / "site=north").parts
    assert any("Camera 'd'" in sentence for sentence in second.warnings)
    (shown,) = [line for line in capsys.readouterr().err.splitlines() if "warning: " in line]
    assert "2 of 2 shards have warnings (`warnings` in manifest.json), first part-00000" in shown
    assert shown.endswith(first.warnings[0])


@pytest.mark.slow
@pytest.mark.usefixtures("in_threads")
def test_a_site_that_fails_is_named_after_the_others_are_complete(files, tmp_path, capsys):
    assert cli.main(["run-sites", str(files / "half.toml"), "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.out.startswith(f"{tmp_path / 'site=north'}: ")
    (sentence,) = [line for line in said.err.splitlines() if line.startswith("catfree: ")]
    assert sentence.startswith("catfree: gone: ")
    assert "x.npz" in sentence


@pytest.mark.slow
def test_sites_on_dask(files, tmp_path, capsys):
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = ["run-sites", str(files / "good.toml"), "--out", str(tmp_path)]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        assert cli.main([*words, "--dask", cluster.scheduler_address]) == 0
    assert f"{tmp_path / 'site=north'}: " in capsys.readouterr().out


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer(files, tmp_path, capsys):
    dask = pytest.importorskip("dask", reason="dask is not installed")
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = ["run-sites", str(files / "good.toml"), "--out", str(tmp_path / "o")]
    with dask.config.set({"distributed.comm.timeouts.connect": "0.1s"}):
        assert cli.main([*words, "--dask", "tcp://127.0.0.1:1"]) == 1
    assert "No Dask scheduler answers at tcp://127.0.0.1:1" in last_sentence(capsys)


def test_a_missing_dask_is_named(files, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = ["run-sites", str(files / "good.toml"), "--out", str(tmp_path), "--dask", "there"]
    assert cli.main(words) == 1
    assert "pip install 'catfree[distributed]'" in last_sentence(capsys)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["shard", "--plan", "none.json", "--index", "0"],
        ["watch", "--scene", "none.json", "--frame-rate", "5"],
    ],
)
def test_a_process_for_a_shard_or_for_instants_uses_one_thread(words):
    code = (
        "import os, sys\n"
        "from catfree.__main__ import main\n"
        "print('numpy' in sys.modules)\n"
        f"sys.argv = ['catfree', *{words}]\n"
        f"print(main(), {{name: os.environ[name] for name in {list(ONE_THREAD)}}})"
    )
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    # NumPy counts the processors when it is imported.
    assert said.splitlines() == ["False", f"1 {ONE_THREAD}"]


def test_cameras_of_a_scene_belong_to_the_videos_of_their_name(tmp_path):
    scene = make_world("ring4", 0, frames=2, people=1).scene
    path = write_scene_json(tmp_path / "scene.json", scene, ["north", "east", "south", "west"])
    videos = [Path(f"{name}.mp4") for name in ("south", "west", "north", "east")]
    ordered, _, (said,) = _scene_for(path, videos)
    assert "matched by name" in said
    np.testing.assert_allclose(ordered.rig.centers, scene.rig.centers[[2, 3, 0, 1]], atol=1e-5)
    same, names, nothing = _scene_for(path, ())
    assert (names, nothing) == (("north", "east", "south", "west"), ())
    np.testing.assert_allclose(same.rig.centers, scene.rig.centers, atol=1e-5)
