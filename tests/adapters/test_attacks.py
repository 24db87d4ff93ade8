"""Files made to stall, crash or deceive a reader fail at once with one sentence."""

import contextlib
import io
import json
import struct
import time
import tomllib
import zipfile

import numpy as np
import pytest

from catfree._run._cache import StageCache
from catfree.adapters import (
    read_anipose_toml,
    read_coco,
    read_colmap,
    read_mot,
    read_opencv_yaml,
    read_rig_json,
    read_tracks_csv,
    read_uniform_json,
    write_anipose_toml,
    write_colmap_text,
    write_opencv_yaml,
    write_rig_json,
    write_tracks_csv,
)
from catfree.adapters.datasets._grid_annotations import numbered_files
from catfree.adapters.files._camera_names import file_names
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError, quoted
from catfree.methods.paper._assemble import empty_localization
from catfree.types import Detections, Lens, Rig, Scene
from catfree.types._archive import load_arrays, save_arrays

LONGEST = 600  # characters of a message


def _rig(count: int = 2) -> Rig:
    K = np.tile([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]], (count, 1, 1))
    lens = np.tile([-0.1, 0.01, 0.001, 0.002, 0.0], (count, 1))
    return Rig(K, np.tile(np.eye(3), (count, 1, 1)), np.eye(count, 3), (320, 240), distortion=lens)


def _member(descr: str, shape: str, content: bytes = bytes(24)) -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n".encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        head = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text
        archive.writestr("frame.npy", head + content)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("descr", "shape"),
    [
        ("'<f8'", "(10**12,)"),
        ("'<f8'", "(1000000000000,)"),
        ("'<f8'", "(4611686018427387904, 4)"),
        ("'<f8'", "(-3,)"),
        ("'<f8'", "(2,)"),
        ("'|O'", "(3,)"),
        ("'<U2000000000'", "(3,)"),
    ],
)
def test_headers_that_ask_for_other_than_the_file_holds(descr, shape, tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(_member(descr, shape))
    with pytest.raises(FileFormatError, match=r"a\.npz is not a readable"):
        Detections.load(path)
    cache = StageCache(tmp_path)
    cache.path("boxes", "a").write_bytes(path.read_bytes())
    assert cache.load("boxes", "a", Detections) is None


@pytest.mark.slow
def test_an_archive_that_unpacks_to_hundreds_of_times_its_size_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    size = 2**28 + 2**20
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({size},)}}\n".encode()
        with archive.open("frame.npy", "w") as stream:
            stream.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
            for _ in range(257):
                stream.write(bytes(2**20))
    start = time.perf_counter()
    with pytest.raises(FileFormatError, match="more than 100 times its size"):
        Detections.load(path)
    assert time.perf_counter() - start < 5


def test_what_compresses_too_well_is_still_read_back(tmp_path, monkeypatch):
    monkeypatch.setattr("catfree.types._archive._ALWAYS_ALLOWED", 1000)
    save_arrays(tmp_path / "a.npz", "thing", {"x": np.zeros(200_000)})
    again = load_arrays(tmp_path / "a.npz", "thing", required=("x",))
    np.testing.assert_array_equal(again["x"], np.zeros(200_000))


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * 5000,
        "x = " + "{a = " * 5000,
        "x = " + "9" * 5000,
        ".".join("a" * 20_000) + " = 1",
        "[" + ".".join("a" * 20_000) + "]",
        'x = {"' + '"."'.join("a" * 20_000) + '" = 1}',
        'x = "' + "\\" * 20_000,
        "# " + "x" * 2**20,
    ],
)
def test_deep_and_long_toml_is_refused_at_once(text, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(text)
    start = time.perf_counter()
    with pytest.raises(FileFormatError, match=r"a\.toml") as error:
        read_anipose_toml(path)
    assert time.perf_counter() - start < 5
    assert len(str(error.value)) < LONGEST


def test_names_with_dots_are_no_dotted_keys(tmp_path):
    names = ["." * 500, 'a"."b\\']
    assert read_anipose_toml(write_anipose_toml(tmp_path / "a.toml", _rig(), names)).names == (
        *names,
    )


def test_two_anipose_cameras_of_one_name_are_refused(tmp_path):
    path = write_anipose_toml(tmp_path / "a.toml", _rig(), ["left", "right"])
    path.write_text(path.read_text().replace("right", "left"))
    assert len(tomllib.loads(path.read_text())) == 3
    with pytest.raises(InvalidInputError, match=r"a\.toml: Two cameras have the same name"):
        read_anipose_toml(path)


@pytest.mark.parametrize("body", ["data:[" * 20_000, "data: " * 20_000, "]" * 20_000 + "data: ["])
def test_opencv_yaml_is_searched_once(body, tmp_path):
    path = tmp_path / "a.yml"
    path.write_text("%YAML:1.0\n---\nK: !!opencv-matrix\n   " + body)
    start = time.perf_counter()
    with pytest.raises(FileFormatError, match="matrix K is incomplete"):
        read_opencv_yaml(path)
    assert time.perf_counter() - start < 5


def _four(tmp_path, statement="", values="-0.1, 0.01, 0.001, 0.002"):
    (path,) = write_opencv_yaml(tmp_path, _rig(1), ["a"])
    text = path.read_text().replace("-0.1, 0.01, 0.001, 0.002, 0.0", values)
    path.write_text(text.replace("rows: 5", "rows: 4") + statement)
    return path


@pytest.mark.parametrize(
    "statement", ["fisheye_model: 1\n", "distortion_model: equidistant\n", 'model: "Fisheye"\n']
)
def test_opencv_files_state_fisheyes_in_several_ways(statement, tmp_path):
    for values in ("-0.1, 0.01, 0.001, 0.002", "0., 0., 0., 0."):
        rig = read_opencv_yaml(_four(tmp_path, statement, values)).rig
        assert rig.lenses[0] == Lens.FISHEYE


def test_four_coefficients_must_say_of_which_lens(tmp_path):
    with pytest.raises(FileFormatError, match="does not state the lens model"):
        read_opencv_yaml(_four(tmp_path))
    for statement in ("fisheye_model: 0\n", "distortion_model: plumb_bob\n"):
        rig = read_opencv_yaml(_four(tmp_path, statement)).rig
        np.testing.assert_array_equal(rig.distortion, [[-0.1, 0.01, 0.001, 0.002, 0]])
    assert read_opencv_yaml(_four(tmp_path, values="0, 0, 0, 0")).rig.distortion is None


def test_opencv_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    paths = []
    for folder in ("left", "right"):
        (tmp_path / folder).mkdir()
        paths += write_opencv_yaml(tmp_path / folder, _rig(1), ["calibration"])
    assert read_opencv_yaml(paths).names == ("left/calibration", "right/calibration")


@pytest.mark.parametrize("name", ["\\ud800", "a\\udfff"])
def test_half_a_character_is_no_name(name, tmp_path):
    path = write_rig_json(tmp_path / "a.json", _rig(), ["left", "right"])
    path.write_text(path.read_text().replace("left", name))
    with pytest.raises(FileFormatError, match=r"a\.json \(rig\) is not valid JSON"):
        read_rig_json(path)
    path.write_text(path.read_text().replace(name, "\\ud83c\\udfa5"))
    assert read_rig_json(path).names == ("🎥", "right")


def test_a_name_is_text_not_a_list(tmp_path):
    path = write_rig_json(tmp_path / "a.json", _rig(), ["left", "right"])
    path.write_text(path.read_text().replace('"left"', "[1, 2]"))
    with pytest.raises(FileFormatError, match=r"the name of camera 0 is \[1, 2\]"):
        read_rig_json(path)


def test_points_of_colmap_are_finite(tmp_path):
    root = write_colmap_text(tmp_path / "m", _rig(), points=np.eye(3))
    path = root / "points3D.txt"
    path.write_text(path.read_text().replace("2 0.0 1.0", "2 nan 1.0"))
    with pytest.raises(InvalidInputError, match=r"points3D\.txt: point 2 is not finite"):
        read_colmap(root)


@pytest.mark.parametrize("fps", ["NaN", "Infinity", "-1", "0"])
def test_fps_is_a_rate(fps, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(f'{{"units": "m", "cameras": [], "frames": [], "fps": {fps}}}')
    with pytest.raises(InvalidInputError, match=r"a\.json: fps is"):
        read_uniform_json(path)


def test_boxes_of_mot_end_at_finite_pixels(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1,1,1e308,0,1e308,5\n")
    with pytest.raises(InvalidInputError, match="box in line 1 is not finite"):
        read_mot(path)


@pytest.mark.parametrize("value", ["nan", "inf", "-1.0"])
def test_sigma_of_a_table_is_a_length(value, tmp_path):
    from catfree.types import Tracks

    one = Tracks(
        *(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros((1, 3)), np.zeros((1, 2))),
        *(np.array([0.125]), np.eye(2)[None], np.array([2]), np.zeros(1, np.int64)),
    )
    path = write_tracks_csv(tmp_path / "a.csv", one)
    assert read_tracks_csv(path).sigma == [0.125]
    path.write_text(path.read_text().replace("0.125", value))
    with pytest.raises(InvalidInputError, match=r"a\.csv: sigma"):
        read_tracks_csv(path)


def test_file_numbers_are_frames(tmp_path):
    (tmp_path / f"{2**70}.json").touch()
    with pytest.raises(FileFormatError, match="too large for a frame"):
        numbered_files(tmp_path, "json")


def test_metric_is_one_flag(tmp_path):
    path = tmp_path / "a.npz"
    rig = _rig(2)
    arrays = {f"rig_{name}": value for name, value in vars(rig).items()}
    arrays |= {"normal": np.array([0, 0, -1.0]), "offset": 0.0, "extent": 2.0}
    for metric in (np.zeros(0, bool), np.zeros(3, bool), np.array("x"), np.array(7)):
        save_arrays(path, "Scene", arrays | {"metric": metric})
        with pytest.raises(InvalidInputError, match=r"a\.npz: metric"):
            Scene.load(path)


class _MuteError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-(10**5000), "a number of 16610 bits"),
        ([10**5000], "a list"),
        (ValueError(10**5000), "a ValueError"),
        (_MuteError(), "a _MuteError"),
    ],
    ids=["number", "list", "error", "mute"],
)
def test_what_cannot_be_printed_is_named(value, text):
    assert quoted(value) == text


def test_bad_values_are_quoted_in_part(tmp_path):
    long = "u" * 5000
    path = tmp_path / "a.json"
    for document in ({"units": long}, {"units": "m", "cameras": [{"name": [long]}]}):
        path.write_text(json.dumps(document))
        for read in (read_rig_json, read_uniform_json):
            with pytest.raises(CatFreeError) as error:
                read(path)
            assert len(str(error.value).replace(str(path), "")) < LONGEST
    assert quoted("short") == "'short'"
    assert quoted(np.eye(2)) == "array([[1., 0.], [0., 1.]])"
    for value in (10**6000, [[0] * 99] * 99, {long: long}, ValueError(long)):
        assert len(quoted(value)) < 200


def test_long_names_of_cameras_become_names_of_files(tmp_path):
    names = ["x" * 767 + end for end in "abc"] + ["厅" * 300, "厅" * 300 + "b"]
    files = file_names(names)
    assert len(set(files)) == len(names)
    assert all(len(f"{file}.txt".encode()) <= 255 for file in files)
    assert len(write_opencv_yaml(tmp_path, _rig(3), names[:3])) == 3


def test_an_empty_result_is_cached(tmp_path):
    cache = StageCache(tmp_path)
    cache.store("localize", "a", empty_localization(2))
    assert cache.load("localize", "a", type(empty_localization(2))) is not None


@pytest.mark.parametrize("name", ["9" * 3000, "a" + "9" * 99_999, "9" * 99_999 + "a", "9a" * 9999])
def test_digits_in_the_name_of_an_image_take_no_time(name, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps([{"image_id": f"C1/{name}.png", "bbox": [0, 0, 5, 9]}]))
    start, found = time.process_time(), None
    with contextlib.suppress(CatFreeError):
        found = read_coco(path).detections.frame.tolist()
    assert time.process_time() - start < 1
    assert found == ([9] if name == "9a" * 9999 else None)
