"""Every calibration format reads back the written rig, and errors are clear."""

import dataclasses
import inspect
import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.adapters import (
    NamedRig,
    read_anipose_toml,
    read_colmap,
    read_opencv_yaml,
    read_rig_json,
    read_scene_json,
    write_anipose_toml,
    write_colmap_text,
    write_opencv_yaml,
    write_rig_json,
    write_scene_json,
)
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError, WriteError
from catfree.types import Plane, Rig, Scene


def _numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


def rigs(max_cameras: int = 4) -> st.SearchStrategy[dict]:
    """Draw arguments of `Rig` for cameras with any poses, sizes and lenses."""
    coefficient = st.just(0.0) | _numbers(-1.0, 1.0)
    camera = st.fixed_dictionaries(
        {
            "focal": st.tuples(_numbers(50, 5000), _numbers(50, 5000)),
            "centre": st.tuples(_numbers(-100, 4000), _numbers(-100, 4000)),
            "vector": st.tuples(*[_numbers(-3.0, 3.0)] * 3),
            "t": st.tuples(*[_numbers(-1e4, 1e4)] * 3),
            "size": st.tuples(st.integers(1, 8000), st.integers(1, 8000)),
            "lens": st.tuples(*[coefficient] * 8)
            | st.tuples(*[coefficient] * 5, *[st.just(0.0)] * 3),
            "fisheye": st.booleans(),
        }
    )
    return st.tuples(st.lists(camera, min_size=1, max_size=max_cameras), st.booleans()).map(
        lambda drawn: _rig_arguments(*drawn)
    )


def _rig_arguments(cameras: list[dict], has_lens: bool) -> dict:
    K = [
        [[c["focal"][0], 0, c["centre"][0]], [0, c["focal"][1], c["centre"][1]], [0, 0, 1]]
        for c in cameras
    ]
    return {
        "K": np.array(K, np.float64),
        "R": Rotation.from_rotvec([c["vector"] for c in cameras]).as_matrix(),
        "t": np.array([c["t"] for c in cameras]),
        "image_size": np.array([c["size"] for c in cameras]),
        "distortion": np.stack([_coefficients(c) for c in cameras]) if has_lens else None,
        "lens": np.array([c["fisheye"] for c in cameras], int),
    }


def _coefficients(camera: dict) -> np.ndarray:
    return np.where(np.arange(8) < (4 if camera["fisheye"] else 8), camera["lens"], 0.0)


@dataclasses.dataclass(frozen=True)
class Format:
    write: Callable[[Path, Rig, list[str]], object]
    read: Callable[[Path], NamedRig]
    files: Callable[[Path], list[Path]]


def _opencv_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.yml"))


FORMATS = {
    "colmap": Format(write_colmap_text, read_colmap, lambda p: sorted(p.glob("[ci]*.txt"))),
    "anipose": Format(
        lambda p, *a: write_anipose_toml(p / "calibration.toml", *a),
        lambda p: read_anipose_toml(p / "calibration.toml"),
        lambda p: [p / "calibration.toml"],
    ),
    "opencv": Format(
        write_opencv_yaml, lambda p: read_opencv_yaml(_opencv_files(p)), _opencv_files
    ),
    "json": Format(
        lambda p, *a: write_rig_json(p / "rig.json", *a),
        lambda p: read_rig_json(p / "rig.json"),
        lambda p: [p / "rig.json"],
    ),
}
every_format = pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS)


def _lens(rig: Rig) -> np.ndarray:
    if rig.distortion is None:
        return np.zeros((rig.camera_count, 8))
    return np.pad(rig.distortion, ((0, 0), (0, 8 - rig.distortion.shape[1])))


def _assert_same(read: Rig, written: Rig) -> None:
    np.testing.assert_allclose(read.K, written.K, rtol=0, atol=1e-9)
    np.testing.assert_allclose(read.R, written.R, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(read.t, written.t)
    np.testing.assert_array_equal(read.image_size, written.image_size)
    np.testing.assert_array_equal(_lens(read), _lens(written))
    np.testing.assert_array_equal(read.lenses, written.lenses)


@pytest.mark.slow
@every_format
@given(drawn=rigs())
def test_reading_gives_back_the_written_rig(form, drawn, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    rig = Rig(**drawn)
    names = [f"cam{at}.png" for at in range(rig.camera_count)]
    form.write(folder, rig, names)
    named = form.read(folder)
    _assert_same(named.rig, rig)
    assert [Path(name).stem for name in named.names] == [Path(name).stem for name in names]


@pytest.mark.slow
@given(drawn=rigs(), text=st.text(max_size=20))
def test_any_name_survives_toml_and_json(drawn, text, tmp_path_factory):
    folder = tmp_path_factory.mktemp("names")
    rig = Rig(**drawn)
    text = text.encode("utf-8", "ignore").decode("utf-8")
    names = [f"{text}{at}" for at in range(rig.camera_count)]
    for form in (FORMATS["anipose"], FORMATS["json"]):
        form.write(folder, rig, names)
        assert form.read(folder).names == tuple(names)


@pytest.mark.slow
@every_format
@given(drawn=rigs(max_cameras=2), where=st.floats(0, 1), data=st.data())
def test_damaged_files_raise_only_our_errors_and_name_the_file(
    form, drawn, where, data, tmp_path_factory
):
    folder = tmp_path_factory.mktemp("damaged")
    rig = Rig(**drawn)
    form.write(folder, rig, [f"cam{at}" for at in range(rig.camera_count)])
    file = data.draw(st.sampled_from(form.files(folder)))
    content = file.read_bytes()
    at = int(where * (len(content) - 1))
    kind = data.draw(st.sampled_from(["cut", "replace", "insert"]))
    junk = data.draw(st.binary(min_size=1, max_size=3))
    damaged = {
        "cut": content[:at],
        "replace": content[:at] + junk + content[at + len(junk) :],
        "insert": content[:at] + junk + content[at:],
    }[kind]
    file.write_bytes(damaged)
    try:
        message = f"{file.name}: {form.read(folder).names}"
    except CatFreeError as error:
        message = str(error)
    assert file.name in message or str(folder) in message


@every_format
def test_missing_files_are_named(form, tmp_path):
    form.write(tmp_path, _ring(3), ["a", "b", "c"])
    gone = form.files(tmp_path)[-1]
    gone.unlink()
    if form is FORMATS["opencv"]:
        with pytest.raises(InvalidInputError, match=gone.name):
            read_opencv_yaml([gone])
    else:
        with pytest.raises(InvalidInputError, match=gone.stem):
            form.read(tmp_path)


@every_format
def test_half_a_file_is_an_error(form, tmp_path):
    form.write(tmp_path, _ring(2), ["a", "b"])
    file = form.files(tmp_path)[0]
    content = file.read_text()
    file.write_text(content[: int(0.6 * len(content))])
    with pytest.raises(CatFreeError, match=file.name):
        form.read(tmp_path)


@every_format
def test_wrong_number_of_names_is_refused(form, tmp_path):
    with pytest.raises(InvalidInputError, match="names has 2 names, but there are 3 cameras"):
        form.write(tmp_path, _ring(3), ["a", "b"])
    with pytest.raises(InvalidInputError, match="same name"):
        form.write(tmp_path, _ring(2), ["a", "a"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", [FORMATS[k] for k in ("colmap", "anipose", "opencv")])
def test_unregistered_cameras_are_left_out(form, tmp_path):
    rig = _with_unregistered(_ring(3))
    form.write(tmp_path, rig, ["a", "b", "c"])
    named = form.read(tmp_path)
    assert named.names == ("a", "c")
    _assert_same(named.rig, rig.select([0, 2]))
    none = Rig(rig.K, rig.R, rig.t, rig.image_size, registered=np.zeros(3, bool))
    with pytest.raises(InvalidInputError, match="no camera of the rig is registered"):
        form.write(tmp_path, none, ["a", "b", "c"])


def test_json_keeps_unregistered_cameras(tmp_path):
    rig = _with_unregistered(_ring(3))
    write_rig_json(tmp_path / "rig.json", rig)
    named = read_rig_json(tmp_path / "rig.json")
    assert named.names == ("C1", "C2", "C3")
    np.testing.assert_array_equal(named.rig.registered, [True, False, True])
    np.testing.assert_array_equal(named.rig.t, rig.t)
    assert np.isnan(named.rig.K[1]).all()


@pytest.mark.parametrize("value", ["false", "", 0, 1, 1.0, None, [], [False], {}])
def test_json_says_of_every_camera_whether_it_is_registered(tmp_path, value):
    path = write_rig_json(tmp_path / "rig.json", _ring(3), ("north", "east", "south"))
    document = json.loads(path.read_text())
    document["cameras"][1]["registered"] = value
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=r"rig\.json: .*camera 1 \(east\).*true or false"):
        read_rig_json(path)
    del document["cameras"][1]["registered"]
    path.write_text(json.dumps(document))
    assert read_rig_json(path).rig.registered.all()


@pytest.mark.slow
@given(drawn=rigs(), above=_numbers(0.01, 10), metric=st.booleans())
def test_scene_json_round_trip(drawn, above, metric, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.json"
    rig = Rig(**drawn)
    normal = np.array([0.36, -0.48, 0.8])
    heights = np.asarray(rig.centers) @ normal
    # Cameras of a metric scene hang below 100 m.
    metric = metric and bool(np.ptp(heights) + above < 100)
    scene = Scene(rig, Plane(normal, above - heights.min()), 7.25, metric)
    write_scene_json(path, scene)
    again, names = read_scene_json(path)
    _assert_same(again.rig, rig)
    np.testing.assert_array_equal(again.ground.normal, scene.ground.normal)
    np.testing.assert_array_equal(again.ground.offset, scene.ground.offset)
    assert (again.extent, again.metric) == (7.25, metric)
    assert names[0] == "C1"


def test_float32_rigs_are_written_and_read_as_float64(tmp_path):
    rig = _ring(2)
    single = Rig(*(np.asarray(v, np.float32) for v in (rig.K, rig.R, rig.t)), rig.image_size)
    for form in FORMATS.values():
        form.write(tmp_path, single, ["a", "b"])
        again = form.read(tmp_path).rig
        assert again.K.dtype == np.float64
        np.testing.assert_allclose(again.R, single.R, atol=2e-7)


def test_failed_writes_leave_the_old_file(tmp_path, monkeypatch):
    path = write_rig_json(tmp_path / "rig.json", _ring(2))
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("catfree.adapters.files._documents.os.replace", full)
    with pytest.raises(OSError, match="No space"):
        write_rig_json(path, _ring(3))
    assert [file.name for file in tmp_path.iterdir()] == ["rig.json"]
    assert path.read_bytes() == before


# One hand-made camera, a quarter turn about z, written in each format.

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_colmap_text_example(tmp_path):
    (tmp_path / "cameras.txt").write_text(
        "# a comment\n"
        "7 SIMPLE_RADIAL 640 480 500.0 320.5 240.5 0.01\n"
        "3 OPENCV 1920 1080 900 910 960.5 540.5 0.1 -0.2 0.003 0.004\n"
        "4 SIMPLE_PINHOLE 100 50 80 50 25\n"
    )
    half = np.sqrt(0.5)
    (tmp_path / "images.txt").write_text(
        "# a comment\n"
        f"2 {half} 0 0 {half} 1 2 3 3 west view.png\n"
        "10.5 20.5 -1 30.0 40.0 7\n"
        "1 1 0 0 0 0 0 5 7 east.png\n"
        "\n"
        "9 2 0 0 0 0 0 6 4 north.png\n"
        "\n"
    )
    (tmp_path / "points3D.txt").write_text("7 1.5 2.5 3.5 10 20 30 0.7 2 1\n")
    named = read_colmap(tmp_path)
    assert named.names == ("east.png", "north.png", "west view.png")
    rig = named.rig
    # COLMAP's principal point 320.5 is catfree's 320: pixel centers at 0.5 against 0.
    np.testing.assert_array_equal(rig.K[0], [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
    np.testing.assert_array_equal(rig.K[2], [[900, 0, 960], [0, 910, 540], [0, 0, 1]])
    np.testing.assert_allclose(rig.R[2], QUARTER, atol=1e-15)
    np.testing.assert_array_equal(rig.R[1], np.eye(3))  # quaternions need not be unit
    np.testing.assert_array_equal(rig.t, [[0, 0, 5], [0, 0, 6], [1, 2, 3]])
    np.testing.assert_array_equal(rig.image_size, [[640, 480], [100, 50], [1920, 1080]])
    assert rig.distortion is not None
    np.testing.assert_array_equal(
        rig.distortion, [[0.01, 0, 0, 0, 0], [0] * 5, [0.1, -0.2, 0.003, 0.004, 0]]
    )
    np.testing.assert_array_equal(named.points, [[1.5, 2.5, 3.5]])


def test_anipose_example(tmp_path):
    path = tmp_path / "calibration.toml"
    path.write_text(
        "[cam_00]\n"
        'name = "left \\"A\\""\n'
        "size = [1920, 1080]\n"
        "matrix = [[1000.0, 0.0, 960.0], [0.0, 1010.0, 540.0], [0.0, 0.0, 1.0]]\n"
        "distortions = [-0.1, 0.2, 0.0, 0.0]\n"
        "rotation = [0.0, 0.0, 1.5707963267948966]\n"
        "translation = [1000.0, 2000.0, 3000.0]\n"
        "fisheye = false\n"
        "[metadata]\n"
        "adjusted = false\n"
        "error = 0.0\n"
    )
    named = read_anipose_toml(path, metres_per_unit=0.001)
    assert named.names == ('left "A"',)
    np.testing.assert_allclose(named.rig.R[0], QUARTER, atol=1e-15)
    np.testing.assert_allclose(named.rig.t, [[1, 2, 3]], rtol=1e-15)
    np.testing.assert_array_equal(named.rig.distortion, [[-0.1, 0.2, 0, 0, 0]])
    np.testing.assert_array_equal(named.rig.image_size, [[1920, 1080]])


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize(
    "names",
    [
        ("K", "dist_coeffs", "R", "t"),
        ("camera_matrix", "distortion_coefficients", "rvec", "tvec"),
        ("cameraMatrix", "distCoeffs", "rotation_matrix", "T"),
    ],
)
def test_opencv_files_by_opencv_itself(suffix, names, tmp_path):
    path = tmp_path / f"left.{suffix}"
    K = np.array([[1000.0, 0, 960], [0, 1010, 540], [0, 0, 1]])
    rotation = cv2.Rodrigues(QUARTER)[0] if names[2] == "rvec" else QUARTER
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1920)
    storage.write("image_height", 1080)
    storage.write("calibration_time", "a text that is no matrix")
    lens = np.array([[0.1, 0.2, 0.3, 0.4, 0.5]])
    for name, value in zip(names, (K, lens, rotation, np.array([[1.0], [2], [3]])), strict=True):
        storage.write(name, value)
    storage.release()
    named = read_opencv_yaml(path)
    assert named.names == ("left",)
    np.testing.assert_array_equal(named.rig.K[0], K)
    np.testing.assert_allclose(named.rig.R[0], QUARTER, atol=1e-15)
    np.testing.assert_array_equal(named.rig.t, [[1, 2, 3]])
    np.testing.assert_array_equal(named.rig.distortion, lens)
    np.testing.assert_array_equal(named.rig.image_size, [[1920, 1080]])


def test_opencv_reads_what_we_write(tmp_path):
    rig = _ring(2)
    for at, path in enumerate(write_opencv_yaml(tmp_path, rig)):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), rig.K[at])
        np.testing.assert_array_equal(storage.getNode("t").mat().ravel(), rig.t[at])
        storage.release()


def test_opencv_yaml_by_hand(tmp_path):
    """Lists in both of YAML's styles, a comment, and entries that are not numbers."""
    path = tmp_path / "left.yaml"
    path.write_text(
        "%YAML:1.0\n---\n# made by hand\ncamera: left\n"
        "K: [ 1000., 0., 960.,\n   0., 1010., 540., 0., 0., 1. ]\n"
        "dist:\n   - -1.0e-01\n   - 2.0e-01\n   - 0.\n   - -0.5\n"
        "distortion_model: plumb_bob\n"
        "rvec: [0, 0, 1.5707963267948966]\ntvec:\n- 1\n- -2\n- 3\n"
        "image_size: [1920, 1080]\n"
    )
    rig = read_opencv_yaml(path).rig
    np.testing.assert_array_equal(rig.K, [[[1000, 0, 960], [0, 1010, 540], [0, 0, 1]]])
    np.testing.assert_array_equal(rig.distortion, [[-0.1, 0.2, 0, -0.5, 0]])
    np.testing.assert_allclose(rig.R[0], QUARTER, atol=1e-15)
    np.testing.assert_array_equal(rig.t, [[1, -2, 3]])
    path.write_text(path.read_text().replace("1080]", "nan]"))
    with pytest.raises(InvalidInputError, match=r"left\.yaml: image_size"):
        read_opencv_yaml(path)


def test_opencv_image_size_may_be_given(tmp_path):
    (path,) = write_opencv_yaml(tmp_path, _ring(1), ["a"])
    text = path.read_text().replace("image_width: 1920\nimage_height: 1080\n", "")
    path.write_text(text)
    with pytest.raises(FileFormatError, match="image_size"):
        read_opencv_yaml(path)
    rig = read_opencv_yaml(path, image_size=(64, 48), metres_per_unit=0.01).rig
    np.testing.assert_array_equal(rig.image_size, [[64, 48]])
    np.testing.assert_allclose(rig.t, _ring(1).t / 100)


def test_units_are_meters_or_not(tmp_path):
    path = tmp_path / "rig.json"
    assert '"units": "m"' in write_rig_json(path, _ring(1), metric=True).read_text()
    with pytest.raises(InvalidInputError, match="metric must hold true and false"):
        inspect.unwrap(write_rig_json)(path, _ring(1), metric="m")


def test_mirrored_rotations_are_refused(tmp_path):
    path = write_rig_json(tmp_path / "rig.json", _ring(2))
    document = json.loads(path.read_text())
    document["cameras"][1]["R"][0] = [-value for value in document["cameras"][1]["R"][0]]
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInputError, match=r"rig\.json: R\[1\] is not a rotation.*det = -1"):
        read_rig_json(path)


def test_lenses_with_more_coefficients_are_refused(tmp_path):
    (yml,) = write_opencv_yaml(tmp_path, _ring(1))
    text = (
        yml.read_text()
        .replace("rows: 5", "rows: 12")
        .replace("0.0, 0.0, 0.0, 0.0, 0.0 ]", f"{'0.0, ' * 11} 0.1 ]")
    )
    yml.write_text(text)
    with pytest.raises(FileFormatError, match="12 coefficients"):
        read_opencv_yaml(yml)
    toml = write_anipose_toml(tmp_path / "c.toml", _ring(1))
    fisheye = toml.read_text().replace("fisheye = false", "fisheye = true")
    toml.write_text(fisheye.replace("0.0, 0.0, 0.0, 0.0, 0.0]", "0.0, 0.0, 0.0, 0.0, 0.1]"))
    with pytest.raises(FileFormatError, match="k1 to k4 of a fisheye"):
        read_anipose_toml(toml)
    write_colmap_text(tmp_path / "sparse", _ring(1))
    cameras = tmp_path / "sparse" / "cameras.txt"
    cameras.write_text(cameras.read_text().replace("PINHOLE", "THIN_PRISM_FISHEYE"))
    with pytest.raises(FileFormatError, match="THIN_PRISM_FISHEYE"):
        read_colmap(tmp_path / "sparse")


def _with_rays() -> Rig:
    ray = np.random.default_rng(0).normal(size=(3, 5, 4, 3))
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    lens = np.array([[0.1, 0.2, 0.3, 0.4, 0], [0] * 5, [1, 2, 3, 4, 5]])
    return dataclasses.replace(
        _ring(3), lens=["fisheye", "rays", "pinhole"], rays=ray, distortion=lens
    )


def test_json_holds_grids_of_rays(tmp_path):
    rig = _with_rays()
    read = read_rig_json(write_rig_json(tmp_path / "rig.json", rig)).rig
    np.testing.assert_array_equal(read.lens, rig.lens)
    np.testing.assert_array_equal(read.rays[1], rig.rays[1])
    np.testing.assert_array_equal(read.distortion, rig.distortion)
    document = json.loads((tmp_path / "rig.json").read_text())
    for change, message in (
        ({"lens": "mirror"}, "the lens of camera 1 is 'mirror'"),
        ({"lens": []}, r"the lens of camera 1 is \[\]"),
        ({"lens": {}}, r"the lens of camera 1 is \{\}"),
        ({"rays": [[0.0, 1.0]]}, "rays of camera 1 must hold rows of vectors"),
        ({"rays": None}, "rays of camera 1"),
    ):
        broken = json.loads(json.dumps(document))
        broken["cameras"][1] |= change
        (tmp_path / "broken.json").write_text(json.dumps(broken))
        with pytest.raises(CatFreeError, match=message):
            read_rig_json(tmp_path / "broken.json")


@pytest.mark.parametrize("write", [write_colmap_text, write_anipose_toml, write_opencv_yaml])
def test_formats_of_coefficients_refuse_rays_by_name(write, tmp_path):
    with pytest.raises(InvalidInputError, match="camera 'b' is a grid of rays"):
        write(tmp_path / "file", _with_rays(), ["a", "b", "c"])
    assert os.listdir(tmp_path) == []


def test_opencv_files_stay_in_their_folder(tmp_path):
    (tmp_path / "rigs").mkdir()
    files = write_opencv_yaml(tmp_path / "rigs", _ring(3), ["../evil", "a/b", "a_b"])
    assert [file.name for file in files] == ["_evil.yml", "a_b.yml", "a_b_C3.yml"]
    assert {file.parent for file in files} == {tmp_path / "rigs"}
    assert os.listdir(tmp_path) == ["rigs"]


def test_names_of_cameras_are_text(tmp_path):
    for write in (write_colmap_text, write_anipose_toml, write_opencv_yaml, write_rig_json):
        with pytest.raises(InvalidInputError, match="name of camera 1 is"):
            write(tmp_path / "file", _ring(2), ["a", "gr\udcf6"])
    assert os.listdir(tmp_path) == []


def test_folders_of_cameras_are_made_where_they_can_be(tmp_path):
    (tmp_path / "file").touch()
    for write in (write_colmap_text, write_opencv_yaml):
        write(tmp_path / "new" / write.__name__, _ring(2))
        assert len(os.listdir(tmp_path / "new" / write.__name__)) >= 2
        with pytest.raises(WriteError, match=r"Cannot make the folder .*file: File exists"):
            write(tmp_path / "file", _ring(2))


def test_colmap_refuses_what_it_cannot_say(tmp_path):
    rig = _ring(1)
    skewed = Rig(rig.K + np.array([[0, 2.0, 0], [0] * 3, [0] * 3]), rig.R, rig.t, rig.image_size)
    with pytest.raises(InvalidInputError, match="skew"):
        write_colmap_text(tmp_path / "a", skewed)
    with pytest.raises(InvalidInputError, match=r"has a space.*Pass other names"):
        write_colmap_text(tmp_path / "a", rig, ["left view"])


def _ring(count: int) -> Rig:
    """Place cameras on a circle of 10 m radius at 3 m height, looking at its middle."""
    angle = 2 * np.pi * np.arange(count) / count + 0.1
    center = np.stack([10 * np.cos(angle), 10 * np.sin(angle), np.full(count, 3.0)], -1)
    forward = -center / np.linalg.norm(center, axis=-1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.tile([[1000.0, 0, 960.25], [0, 1001.0, 540.75], [0, 0, 1]], (count, 1, 1))
    return Rig(K, R, -np.einsum("cij,cj->ci", R, center), (1920, 1080))


def _with_unregistered(rig: Rig) -> Rig:
    K, R, t = (np.array(value) for value in (rig.K, rig.R, rig.t))
    for value in (K, R, t):
        value[1] = np.nan
    known = np.array([True, False, True])
    return Rig(K, R, t, rig.image_size, registered=known)
