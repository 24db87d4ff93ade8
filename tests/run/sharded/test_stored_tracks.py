"""A joined table is read part by part, by catfree and others, and damage is detected."""

import datetime
import inspect
import json
import shutil

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree._run.sharded._join import join_shards
from catfree.errors import FileFormatError, InvalidInputError
from tests.run.sharded.walks import SCENE, plan_of, seen_by, walks, write


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    rng = np.random.default_rng(5)
    whole = walks(rng, 4, 160)
    for shard in plan_of(160, 40, 10):
        write(folder, shard, seen_by(shard, whole, rng))
    join_shards(folder)
    return folder


def columns(tracks):
    return {name: value for name, value in vars(tracks).items() if isinstance(value, np.ndarray)}


def test_parts_together_are_the_table(out):
    stored, whole = cf.open_tracks(out), cf.join(out)
    parts = list(stored)
    assert len(stored) == len(whole) == sum(map(len, parts))
    assert len(parts) == len(stored.parts) == 4
    for name, value in columns(stored.read()).items():
        np.testing.assert_array_equal(value, columns(whole)[name])
        np.testing.assert_array_equal(
            value, np.concatenate([columns(part)[name] for part in parts])
        )
    np.testing.assert_allclose(whole.position[:, 2], 0, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(stored.scene.rig.R), np.asarray(SCENE.rig.R))


@pytest.mark.slow
@given(st.floats(-5, 40), st.floats(-5, 40))
def test_a_stretch_of_time_is_a_selection_of_rows(out, begin, end):
    stored = cf.open_tracks(out)
    whole, some = stored.read(), stored.between(begin, end)
    chosen = whole[(whole.time >= begin) & (whole.time < end)]
    np.testing.assert_array_equal(some.frame, chosen.frame)
    np.testing.assert_array_equal(some.ground_xy, chosen.ground_xy)


def test_a_stretch_of_time_begins_and_ends_at_numbers(out):
    stored = cf.open_tracks(out)
    assert len(stored.between(-np.inf, np.inf)) == len(stored)
    between = inspect.unwrap(type(stored).between)  # bypass the tests' type checks
    for bad in (np.nan, "0", None, [0.0], datetime.datetime(2026, 1, 1)):
        with pytest.raises(InvalidInputError, match=r"^begin"):
            between(stored, bad, 2)
        with pytest.raises(InvalidInputError, match=r"^end"):
            between(stored, 2, bad)


@pytest.mark.slow
def test_others_read_the_folder_as_one_table(out):
    dataset = pytest.importorskip("pyarrow.dataset", reason="pyarrow is not installed")
    whole = cf.join(out)
    for opened in (dataset.dataset(out), cf.open_tracks(out).dataset()):
        table = opened.to_table().sort_by([("frame", "ascending"), ("track_id", "ascending")])
        np.testing.assert_array_equal(table["x"].to_numpy(), whole.ground_xy[:, 0])
        np.testing.assert_array_equal(table["track_id"].to_numpy(), whole.track_id)
    polars = pytest.importorskip("polars", reason="polars is not installed")
    frame = polars.scan_parquet(out / "part-*.parquet").sort("frame", "track_id").collect()
    np.testing.assert_array_equal(frame["y"].to_numpy(), whole.ground_xy[:, 1])
    np.testing.assert_allclose(frame["time_s"].to_numpy(), whole.time)


def test_what_was_not_joined_cannot_be_opened(tmp_path):
    with pytest.raises(InvalidInputError, match=r"have not been joined. Run cf.join first"):
        cf.open_tracks(tmp_path)


def work_file(out, name):
    return out / "_shards" / name


def with_parts(path, parts):
    path.write_text(json.dumps(json.loads(path.read_text()) | {"parts": parts}))


DAMAGES = {
    "is missing": lambda out: (out / "part-00001.parquet").unlink(),
    "was changed or truncated": lambda out: (out / "part-00001.parquet").write_bytes(b"PAR1"),
    "is not the scene": lambda out: work_file(out, "scene.json").write_text("{}"),
    "manifest": lambda out: work_file(out, "manifest.json").write_text("{"),
    "another version": lambda out: work_file(out, "manifest.json").write_text('{"schema": "1"}'),
    "damaged": lambda out: with_parts(work_file(out, "manifest.json"), [{}]),
    "lists no parts": lambda out: with_parts(work_file(out, "manifest.json"), []),
}


@pytest.mark.parametrize("sentence", DAMAGES)
def test_damage_is_refused_by_name(out, tmp_path, sentence):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    DAMAGES[sentence](copy)
    with pytest.raises(FileFormatError, match=sentence):
        cf.open_tracks(copy).read()


@pytest.mark.parametrize("name", ["first", "stop", "rows", "boxes_used"])
@pytest.mark.parametrize("value", ["1e999", "-1e999", "NaN", '"x"', "[]"])
def test_impossible_numbers_in_the_manifest_are_refused(out, tmp_path, name, value):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    path = work_file(copy, "manifest.json")
    document = json.loads(path.read_text())
    document["parts"][0][name] = "here"
    path.write_text(json.dumps(document).replace('"here"', value))
    with pytest.raises(
        FileFormatError, match=r"manifest\.json is damaged .* Join the shards again"
    ):
        cf.open_tracks(copy)


@pytest.mark.parametrize("name", ["a" * 5000, "厅" * 100 + ".parquet", "../part.parquet", "/x", ""])
def test_impossible_names_in_the_manifest_are_refused(out, tmp_path, name):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    path = work_file(copy, "manifest.json")
    document = json.loads(path.read_text())
    document["parts"][0]["file"] = name
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match="Join the shards again") as error:
        cf.open_tracks(copy)
    assert len(str(error.value)) < 1000
