"""Writing text: complete or not at all, with usual permissions, and one sentence on failure."""

import os

import pytest

from catfree.adapters.files._documents import (
    read_text,
    write_bytes_atomically,
    write_text_atomically,
)
from catfree.errors import FileFormatError, InvalidInputError


def test_files_have_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    write_text_atomically(tmp_path / "a.txt", "a")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_folder_is_no_target(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(InvalidInputError, match="it is a folder"):
        write_bytes_atomically(tmp_path / "a.txt", b"a")
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_folder_is_no_document(tmp_path):
    with pytest.raises(InvalidInputError, match=r"not a file \(plan\). Name a file in it.$"):
        read_text(tmp_path, "plan")


def test_text_that_utf8_cannot_hold_is_shown(tmp_path):
    with pytest.raises(InvalidInputError, match=r"camera \\udcf6st' is not valid UTF-8"):
        write_text_atomically(tmp_path / "a.txt", "camera \udcf6st")
    assert os.listdir(tmp_path) == []


def test_text_of_another_encoding_is_told_so(tmp_path):
    (tmp_path / "a.csv").write_bytes("frame,camera\n1,Süd\n".encode("cp1252"))
    with pytest.raises(FileFormatError, match=r"a\.csv .* is not readable text.*save it as UTF-8"):
        read_text(tmp_path / "a.csv", "boxes")
