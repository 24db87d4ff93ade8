"""Names of cameras: short, distinct, and valid as file names."""

import unicodedata

import pytest
from hypothesis import given, strategies as st

from catfree.adapters.files._camera_names import (
    distinct_names,
    file_names,
    is_text,
    names_of_files,
    positions_of,
)
from catfree.errors import InvalidInputError


def touched(root, *files):
    paths = [root / file for file in files]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return paths


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["a.mp4", "b.mp4"], ["a", "b"]),
        (["c1/v.mp4", "c2/v.mp4"], ["c1/v", "c2/v"]),
        (["cam.mp4", "cam.avi"], ["cam.mp4", "cam.avi"]),
        (["x/cam.mp4", "x/cam.avi", "y/cam.mp4"], ["x/cam.mp4", "x/cam.avi", "y/cam.mp4"]),
        (["1/x/y/z/v.mp4", "2/x/y/z/v.mp4"], ["C1_v", "C2_v"]),
    ],
)
def test_names_are_as_short_as_they_can_be(files, names, tmp_path):
    assert names_of_files(touched(tmp_path, *files)) == names


def test_folders_near_the_root_have_no_empty_name():
    from pathlib import Path

    assert names_of_files([Path("/"), Path("/tmp")]) == ["C1_", "C2_tmp"]


def test_one_file_is_one_camera(tmp_path):
    first, other = touched(tmp_path, "a.mp4", "b.mp4")
    link = tmp_path / "c.mp4"
    link.symlink_to(first)
    for again in (first, tmp_path / ".." / tmp_path.name / "a.mp4", link):
        with pytest.raises(InvalidInputError, match="Cameras 0 and 2 are the same file"):
            names_of_files([first, other, again])


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (("a/b", "a_b"), ["a_b", "a_b_C2"]),
        (("../evil", ".."), ["_evil", "_C2"]),
        (("Cam", "cam", "cam_C2"), ["Cam", "cam_C2_C2", "cam_C2"]),
    ],
)
def test_files_of_cameras_lie_in_one_folder(names, files):
    assert file_names(names) == files


@given(st.lists(st.text("aA/._C12 ", max_size=6), max_size=6))
def test_file_names_are_distinct_whatever_the_names(names):
    for given_names in (file_names(names), distinct_names(names)):
        assert len({name.casefold() for name in given_names}) == len(names)
        assert all(given_names)
    assert not any("/" in name or name.startswith(".") for name in file_names(names))


def test_bytes_of_another_encoding_are_no_text():
    assert is_text("größe")
    assert not is_text(b"gr\xf6\xdfe".decode("utf-8", "surrogateescape"))


@given(order=st.permutations(range(3)), ending=st.sampled_from(["", ".txt", ".PNG", "/det/det"]))
def test_cameras_are_found_whatever_their_files_end_in(order, ending):
    given_names = ["north", "b/2", "b/10"] if ending != "/det/det" else ["north", "b2", "b10"]
    wanted = [given_names[at].upper() + ending for at in order]
    assert positions_of(wanted, given_names) == list(order)


@given(order=st.permutations(range(3)), forms=st.tuples(*[st.sampled_from(["NFC", "NFD"])] * 2))
def test_cameras_are_found_however_unicode_is_spelled(order, forms):
    names = ["Tür", "Café/Süd", "Süden"]
    there, here = ([unicodedata.normalize(form, name) for name in names] for form in forms)
    assert positions_of([here[at] + ".mp4" for at in order], there) == list(order)
    assert positions_of(["Tür", "Tu\u0308r"], ["Tu\u0308r", "Tür"]) == [1, 0]


def test_names_that_do_not_tell_find_nothing():
    assert positions_of(["a", "c"], ["a", "b"]) is None
    assert positions_of(["a", "a.txt"], ["a", "b"]) is None  # two have the same name
    assert positions_of(["x/a"], ["p/a", "q/a"]) is None  # either could be meant
    assert positions_of([], ["a"]) == []
    assert positions_of(["a"], ["b/a.png", "c.png"]) == [0]
