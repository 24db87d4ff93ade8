"""The cache returns results of equal content, survives damage, and never returns half a file."""

import dataclasses
import multiprocessing
import os
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree._run._cache import (
    StageCache,
    cached,
    code_hash,
    content_hash,
    from_arrays,
    load_value,
    to_arrays,
)
from catfree.errors import FileFormatError, WriteError
from catfree.methods.paper._assemble import empty_localization
from catfree.types import Detections, Localization, Plane, Rig, Scene
from catfree.types._archive import save_arrays
from catfree.types._writing import ABANDONED_AFTER


@dataclass(frozen=True)
class Inner:
    values: np.ndarray
    note: str | None = None


@dataclass(frozen=True)
class Outer:
    inner: Inner
    flag: bool
    length: float
    other: Inner | None = None


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.lists(finite, max_size=5), st.one_of(st.none(), st.text(max_size=5)), finite, st.booleans()
)
def test_arrays_give_back_every_dataclass(values, note, length, nested):
    # NumPy's strings end at a null character.
    note = None if note is None else note.replace("\0", "")
    inner = Inner(np.array(values, np.float64), note)
    value = Outer(inner, nested, length, inner if nested else None)
    again = from_arrays(Outer, to_arrays(value))
    np.testing.assert_array_equal(again.inner.values, value.inner.values)
    assert again.inner.note == note
    assert (again.flag, again.length) == (nested, length)
    assert (again.other is not None) == nested
    assert content_hash(again) == content_hash(value)


def test_a_missing_field_is_named(tmp_path):
    arrays = {"inner.values": np.zeros(1), "flag": np.array(True)}
    with pytest.raises(FileFormatError, match="lacks 'length'"):
        from_arrays(Outer, arrays)
    save_arrays(tmp_path / "value.npz", "Outer", arrays)
    with pytest.raises(FileFormatError, match=r"value\.npz: A stored Outer lacks 'length'"):
        load_value(tmp_path / "value.npz", Outer)


def test_result_types_come_back_bit_for_bit(tmp_path):
    cache = StageCache(tmp_path)
    eye = np.eye(3)[None].repeat(2, 0)
    rig = Rig(eye, eye, np.array([[0.0, 0, 5], [1, 0, 5]]), (64, 48), registered=[True, False])
    scene = Scene(rig, Plane(np.array([0.0, 0, -1]), 9.0), 2.0, metric=True)
    cache.store("scene", "k", scene)
    again = cache.load("scene", "k", Scene)
    assert again is not None
    assert again.metric is True
    assert content_hash(again) == content_hash(scene)
    empty = empty_localization(3)
    cache.store("localization", "k", empty)
    loaded = cache.load("localization", "k", Localization)
    assert loaded is not None
    assert loaded.thresholds.tau_g is None
    assert content_hash(loaded) == content_hash(empty)


@given(st.integers(0, 3), st.floats(-1, 1))
def test_content_hash_sees_every_number(row, change):
    box = np.tile([[1.0, 2, 30, 40]], (4, 1))
    one = Detections(np.arange(4), np.zeros(4, int), box)
    other = box.copy()
    other[row, 0] += change
    two = Detections(np.arange(4), np.zeros(4, int), other)
    assert (content_hash(one) == content_hash(two)) == bool((other == box).all())


def test_content_hash_does_not_care_where_the_array_lives():
    values = np.arange(3, dtype=np.float32)
    assert content_hash(Inner(values)) == content_hash(Inner(jnp.asarray(values)))  # type: ignore


def test_a_stored_result_is_not_computed_again(tmp_path):
    calls = []

    def compute():
        calls.append(1)
        return Inner(np.arange(3.0))

    first, second, other = (
        cached(StageCache(tmp_path), "stage", Inner, compute, content=content)
        for content in ("a", "a", "b")
    )
    assert len(calls) == 2
    for value in (second, other):
        np.testing.assert_array_equal(value.values, first.values)


@given(st.data())
@settings(max_examples=20)
def test_a_damaged_file_counts_as_absent(tmp_path_factory, data):
    cache, calls = StageCache(tmp_path_factory.mktemp("cache")), []

    def compute():
        calls.append(1)
        return Inner(np.arange(50.0), "note")

    cached(cache, "stage", Inner, compute, content="a")
    (path,) = cache.folder.iterdir()
    content = path.read_bytes()
    cut = data.draw(st.integers(0, len(content) - 1))
    path.write_bytes(content[:cut])
    for _ in range(2):
        cached(cache, "stage", Inner, compute, content="a")
    assert len(calls) == 2
    assert path.read_bytes() == content


def test_leftovers_of_killed_runs_are_swept_and_living_ones_kept(tmp_path):
    old, young = (tmp_path / f".catfree-{letter * 32}.npz" for letter in "ab")
    foreign = [
        tmp_path / name
        for name in (".thesis.npz.bak", ".data.npz.Ab12Cd", f".catfree-{'g' * 32}.npz", ".a.npz")
    ]
    past = time.time() - 2 * ABANDONED_AFTER
    for path in (old, young, *foreign):
        path.write_bytes(b"half")
        if path != young:
            os.utime(path, (past, past))
    StageCache(tmp_path)
    assert not old.exists()
    assert young.exists()
    assert all(path.exists() for path in foreign)


def test_what_the_cache_sweeps_is_what_writing_leaves(tmp_path, monkeypatch):
    def killed(source, destination):
        raise SystemExit

    monkeypatch.setattr(os, "replace", killed)
    monkeypatch.setattr(os, "unlink", killed)
    monkeypatch.setattr("pathlib.Path.unlink", lambda path, missing_ok=False: None)
    with pytest.raises(SystemExit):
        StageCache(tmp_path).store("stage", "a", Inner(np.zeros(1)))
    (left,) = tmp_path.iterdir()
    monkeypatch.undo()
    past = time.time() - 2 * ABANDONED_AFTER
    os.utime(left, (past, past))
    StageCache(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_full_disk_is_one_sentence_and_leaves_no_file(tmp_path):
    script = textwrap.dedent(
        """
        import resource, sys
        import numpy as np
        from catfree._run._cache import StageCache
        from catfree.errors import WriteError
        from catfree.types import Detections
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        n = 5000
        box = np.random.default_rng(0).uniform(0, 100, (n, 4))
        box[:, 2:] += 200
        try:
            StageCache(sys.argv[1]).store("boxes", "k", Detections(np.arange(n), np.arange(n), box))
        except WriteError as error:
            print(error)
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "Cannot write" in done.stdout
    assert "File too large. Name another place." in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="Cannot make the folder"):
        StageCache(tmp_path / "file" / "cache")


def _store_often(folder: str, value: float) -> None:
    for _ in range(20):
        StageCache(folder).store("stage", "same", Inner(np.full(2000, value)))


@pytest.mark.slow
def test_two_writers_of_one_result_never_mix(tmp_path):
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_store_often, args=(str(tmp_path), v)) for v in (1.0, 2.0)]
    for writer in writers:
        writer.start()
    cache, seen = StageCache(tmp_path), 0
    while any(writer.is_alive() for writer in writers):
        if cache.path("stage", "same").is_file():
            value = cache.load("stage", "same", Inner)
            assert value is not None
            assert len(set(value.values)) == 1
            seen += 1
        time.sleep(0.002)
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    assert [path.name for path in tmp_path.iterdir()] == [cache.path("stage", "same").name]


def test_code_hash_tells_packages_apart():
    assert code_hash("types") != code_hash("adapters")
    assert code_hash("types") == code_hash("types")
    assert code_hash() != code_hash("types")


def test_warnings_come_back_and_results_without_them_can_be_read():
    warned = dataclasses.replace(empty_localization(2), warnings=("One.", "Two."))
    arrays = to_arrays(warned)
    assert from_arrays(Localization, arrays).warnings == ("One.", "Two.")
    del arrays["warnings"]  # as in files of version 0.1
    assert from_arrays(Localization, arrays).warnings == ()
