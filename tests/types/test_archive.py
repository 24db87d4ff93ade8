"""Files: never half-written, and damage gives one clear error that leaves no file open."""

import contextlib
import errno
import os
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Detections, Plane, Rig, Scene, Tracks
from catfree.adapters import write_colmap_text, write_rig_json, write_tracks_csv
from catfree.errors import FileFormatError, InvalidInputError, WriteError
from catfree.methods.paper._assemble import empty_localization
from catfree.types._archive import load_arrays, save_arrays

VALUES = {"x": np.arange(6.0), "y": np.array(3, np.int8)}
NAMES = tuple(VALUES)


def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    target = tmp_path / "a.npz"
    save_arrays(target, "thing", VALUES)
    before = target.read_bytes()

    def full_disk(stream, **arrays):
        stream.write(b"half a file")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(OSError, match="No space left"):
        save_arrays(target, "thing", {"x": np.zeros(3)})
    assert os.listdir(tmp_path) == ["a.npz"]
    assert target.read_bytes() == before


def test_a_killed_rename_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    target = tmp_path / "a.npz"
    save_arrays(target, "thing", VALUES)
    before = target.read_bytes()

    def interrupted(source, destination):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_arrays(target, "thing", {"x": np.zeros(3)})
    assert os.listdir(tmp_path) == ["a.npz"]
    assert target.read_bytes() == before


def test_files_have_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    save_arrays(tmp_path / "a.npz", "thing", VALUES)
    assert (tmp_path / "a.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_no_suffix_is_added_and_none_is_left_out(tmp_path):
    save_arrays(tmp_path / "name", "thing", {**VALUES, "nothing": None})
    loaded = load_arrays(tmp_path / "name", "thing", required=NAMES)
    assert loaded.keys() == VALUES.keys()
    assert loaded["y"].dtype == np.int8
    assert loaded["y"].shape == ()


def test_a_missing_folder_or_file_is_named(tmp_path):
    with pytest.raises(InvalidInputError, match=r"the folder .*nowhere does not exist"):
        save_arrays(tmp_path / "nowhere" / "a.npz", "thing", VALUES)
    with pytest.raises(InvalidInputError, match=r"there is no file .*a\.npz"):
        load_arrays(tmp_path / "a.npz", "thing")


def test_objects_are_neither_written_nor_read(tmp_path):
    with pytest.raises(ValueError, match="allow_pickle"):
        save_arrays(tmp_path / "a.npz", "thing", {"x": np.array([None])})
    assert os.listdir(tmp_path) == []
    np.savez(tmp_path / "b.npz", x=np.array([None]), allow_pickle=True)
    with pytest.raises(FileFormatError, match=r"b\.npz is not a readable"):
        load_arrays(tmp_path / "b.npz", "thing")


@pytest.mark.parametrize("kind", [Detections, Rig, Scene, Tracks])
def test_junk_is_one_error_that_names_the_file(tmp_path, kind):
    # An unclosed file would be a ResourceWarning, which is an error in these tests.
    path = tmp_path / "junk"
    with zipfile.ZipFile(tmp_path / "text.zip", "w") as archive:
        archive.writestr("readme.txt", "not an array")
    contents = [
        b"",
        b"junk",
        b"PK\x03\x04 and no more",
        b"\x93NUMPY",
        pickle.dumps([1, 2]),
        (tmp_path / "text.zip").read_bytes(),
    ]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match="junk"):
            kind.load(path)
    np.save(tmp_path / "junk.npy", np.zeros(3))
    with pytest.raises(FileFormatError, match="junk"):
        kind.load(tmp_path / "junk.npy")
    np.savez(tmp_path / "foreign.npz", frame=np.zeros(3))
    with pytest.raises(FileFormatError, match="holds arrays that catfree did not save"):
        kind.load(tmp_path / "foreign.npz")


def test_another_type_or_version_is_named(tmp_path):
    path = tmp_path / "a.npz"
    Detections([], [], []).save(path)
    with pytest.raises(FileFormatError, match="holds Detections, not Tracks"):
        Tracks.load(path)
    save_arrays(path, "Detections", {"frame": np.zeros(0)})
    with pytest.raises(FileFormatError, match="lacks camera"):
        Detections.load(path)
    save_arrays(path, "Detections", {**vars(Detections([], [], [])), "colour": np.zeros(0)})
    with pytest.raises(FileFormatError, match="unknown entry colour"):
        Detections.load(path)


@given(st.data())
def test_damage_is_noticed_or_harmless(tmp_path, data):
    path = tmp_path / "a.npz"
    save_arrays(path, "thing", {"x": np.arange(300) % 17})
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with contextlib.suppress(FileFormatError):
        loaded = load_arrays(path, "thing", required=("x",))
        np.testing.assert_array_equal(loaded["x"], np.arange(300) % 17)


def test_a_folder_is_no_file_to_write(tmp_path):
    with pytest.raises(InvalidInputError, match="is a folder"):
        save_arrays(tmp_path, "thing", VALUES)


def test_every_saver_names_the_file_that_cannot_be_written(tmp_path, monkeypatch):
    rig = Rig(
        np.diag([500.0, 500, 1])[None].repeat(2, 0),
        np.eye(3)[None].repeat(2, 0),
        np.eye(2, 3),
        (64, 48),
    )
    scene = Scene(rig, Plane([0, 0, -1.0], 9.0), 1.0)
    tracks = empty_localization(2).tracks
    savers = {
        "rig.npz": rig.save,
        "scene.npz": scene.save,
        "detections.npz": Detections([], [], []).save,
        "tracks.npz": tracks.save,
        "rig.json": lambda path: write_rig_json(path, rig),
        "tracks.csv": lambda path: write_tracks_csv(path, tracks),
        "colmap": lambda path: write_colmap_text(path, rig),
    }

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    for name, save in savers.items():
        with pytest.raises(WriteError, match=rf"{name}.*No space.*Free some space"):
            save(tmp_path / name)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match=r"file: File exists\. Name another"):
        write_colmap_text(tmp_path / "file", rig)
