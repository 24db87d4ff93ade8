"""Files are written completely or not at all, under unpredictable names, and errors name them."""

import errno
import os

import cv2
import pytest

from catfree.errors import DownloadError, InvalidInputError, WriteError
from catfree.types._writing import cannot_write, is_temporary, make_folder, replacement, replacing


def test_a_link_at_any_former_temporary_name_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    for name in (f".partial_{os.getpid()}_a.png", ".a.png.partial", ".a.partial.mp4"):
        (tmp_path / name).symlink_to(victim)
    for _ in range(2):
        with replacing(tmp_path / "a.png") as stream:
            stream.write(b"new")
    assert victim.read_text() == "mine"
    assert (tmp_path / "a.png").read_bytes() == b"new"


def test_a_link_stays_and_the_file_that_it_leads_to_is_replaced(tmp_path):
    (tmp_path / "far").mkdir()
    file, near = tmp_path / "far/scene.json", tmp_path / "near.json"
    (tmp_path / "scene.json").symlink_to(near)
    near.symlink_to("far/scene.json")
    for content in (b"first", b"second"):  # the file need not exist
        with replacing(tmp_path / "scene.json") as stream:
            stream.write(content)
        assert file.read_bytes() == content
        assert (tmp_path / "scene.json").is_symlink()
        assert near.is_symlink()
    assert sorted(os.listdir(tmp_path / "far")) == ["scene.json"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes that have a path")
def test_a_pipe_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        refused = pytest.raises(InvalidInputError, match="pipe: it is a device or a pipe")
        with refused, replacing(tmp_path / name):
            pass
    assert (tmp_path / "pipe").is_fifo()
    assert sorted(os.listdir(tmp_path)) == ["link", "pipe"]


def test_temporary_names_differ_keep_the_suffix_and_are_known(tmp_path):
    seen = set()
    for _ in range(3):
        with replacement(tmp_path / "a.mp4") as temporary:
            seen.add(temporary.name)
            assert temporary.suffix == ".mp4"
            assert is_temporary(temporary.name)
    assert len(seen) == 3
    assert not is_temporary("a.mp4")
    assert not is_temporary(".a.npz.0123")


def test_a_folder_whose_name_is_a_time_can_hold_videos(tmp_path, monkeypatch):
    monkeypatch.chdir(make_folder(tmp_path / "12:00").parent)
    with replacement("12:00/a.mp4") as temporary:
        writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*"mp4v"), 10, (64, 48))
        assert writer.isOpened()
        writer.release()
    assert (tmp_path / "12:00/a.mp4").is_file()


def test_a_name_as_long_as_file_systems_hold_can_be_written(tmp_path):
    for name in ("x" * 251 + ".txt", "." + "y" * 254, "x." + "z" * 253):
        with replacing(tmp_path / name) as stream:
            stream.write(b"1")
        assert (tmp_path / name).read_bytes() == b"1"
    with (
        pytest.raises(InvalidInputError, match=r"too long for a path\. Shorten it"),
        replacing(tmp_path / ("x" * 256)),
    ):
        pass
    assert len(os.listdir(tmp_path)) == 3


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.ENOSPC, "Free some space"), (errno.EDQUOT, "Free some space"), (errno.EROFS, "Name")],
)
def test_only_a_full_disk_asks_for_space(number, advice, tmp_path):
    with pytest.raises(WriteError, match=rf"a\.txt: .*\. {advice}"), replacing(tmp_path / "a.txt"):
        raise OSError(number, os.strerror(number))
    assert os.listdir(tmp_path) == []
    again = cannot_write("elsewhere", cannot_write("first", OSError(number, "")))
    assert "first" in str(again)


def test_other_errors_of_catfree_stay_as_they_are(tmp_path):
    error = DownloadError("nothing came")
    with pytest.raises(DownloadError) as raised, replacing(tmp_path / "a.txt"):
        raise error
    assert raised.value is error
    assert error.__cause__ is None
    assert os.listdir(tmp_path) == []


def test_a_folder_in_the_way_is_one_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match="Cannot make the folder"):
        make_folder(tmp_path / "file" / "below")
    with pytest.raises(InvalidInputError, match="is a folder"), replacing(tmp_path):
        pass


def test_a_folder_that_nobody_may_write_to_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK)  # root may do anything
    with pytest.raises(WriteError, match=r"write to the folder .*denied\. Name"):
        make_folder(tmp_path)
