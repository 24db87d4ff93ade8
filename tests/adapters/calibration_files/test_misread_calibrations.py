"""Calibrations that could be misread as something else."""

import inspect
import json
import tomllib

import numpy as np
import pytest

import catfree as cf
from catfree.adapters import (
    read_ai_city,
    read_anipose_toml,
    read_colmap,
    read_opencv_yaml,
    read_rig_json,
    write_ai_city,
    write_anipose_toml,
    write_colmap_text,
    write_opencv_yaml,
    write_rig_json,
)
from catfree.adapters.calibration_files._named_rig import default_names, rotation_from_vector
from catfree.errors import FileFormatError, InvalidInputError
from catfree.synthetic import make_layout
from catfree.types import Lens

NAMES = ("a", "b", "c", "d")


@pytest.fixture
def rig():
    return make_layout("ring4", 0).rig


@pytest.mark.parametrize("unit", [0.0, -0.001, np.nan])
def test_a_unit_is_a_positive_length(unit, rig, tmp_path):
    toml = write_anipose_toml(tmp_path / "calibration.toml", rig, NAMES)
    before = toml.read_bytes()
    yaml = write_opencv_yaml(tmp_path, rig, NAMES)
    for use in (
        lambda: read_anipose_toml(toml, metres_per_unit=unit),
        lambda: read_opencv_yaml(yaml, metres_per_unit=unit),
        lambda: write_anipose_toml(toml, rig, NAMES, metres_per_unit=unit),
    ):
        with pytest.raises(InvalidInputError, match=r"metres_per_unit is .* positive number"):
            use()
    assert toml.read_bytes() == before


def test_a_transposed_matrix_is_of_no_camera(rig, tmp_path):
    path = write_ai_city(tmp_path / "calibration.json", rig, NAMES)
    document = json.loads(path.read_text())
    for sensor in document["sensors"]:
        del sensor["intrinsicMatrix"]
    flat = [np.ravel(sensor["cameraMatrix"]).tolist() for sensor in document["sensors"]]
    for sensor, matrix in zip(document["sensors"], flat, strict=True):
        sensor["cameraMatrix"] = matrix
    path.write_text(json.dumps(document))
    np.testing.assert_allclose(read_ai_city(path).rig.centers, rig.centers, atol=1e-9)
    for sensor, matrix in zip(document["sensors"], flat, strict=True):
        sensor["cameraMatrix"] = np.reshape(matrix, (3, 4)).T.tolist()
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=r"sensor 0 must hold 3 x 4 numbers, .* \(4, 3\)"):
        read_ai_city(path)


def test_a_word_that_is_no_truth_value_does_not_make_a_fisheye(rig, tmp_path):
    path = write_anipose_toml(tmp_path / "calibration.toml", rig, NAMES)
    path.write_text(path.read_text().replace("fisheye = false", 'fisheye = "false"'))
    with pytest.raises(FileFormatError, match=r"fisheye of camera \[cam_0\] is 'false'"):
        read_anipose_toml(path)


@pytest.mark.parametrize(
    ("line", "lens"),
    [
        ("fisheye_model: true", Lens.FISHEYE),
        ("fisheye: True", Lens.FISHEYE),
        ("fisheye: false", Lens.PINHOLE),
        ("fisheye_model: 0", Lens.PINHOLE),
        ("distortion_model: rational_polynomial", Lens.PINHOLE),
        ("distortion_model: equidistant", Lens.FISHEYE),
        ("model: HD-4000", None),
        ("fisheye_model: maybe", None),
    ],
)
def test_four_coefficients_are_of_the_stated_model(line, lens, rig, tmp_path):
    (path, *_) = write_opencv_yaml(tmp_path, rig, NAMES)
    four = path.read_text().replace("0.0, 0.0, 0.0, 0.0, 0.0 ]", "0.1, 0.0, 0.0, 0.0 ]")
    path.write_text(f"{four}{line}\n")
    if lens is None:
        with pytest.raises(FileFormatError, match="does not state the lens model"):
            read_opencv_yaml(path)
    else:
        assert read_opencv_yaml(path).rig.lenses.tolist() == [lens]


def test_every_image_of_colmap_has_two_lines(rig, tmp_path):
    folder = write_colmap_text(tmp_path / "sparse", rig, NAMES)
    images = folder / "images.txt"
    written = images.read_text()
    images.write_text(written.replace("\n\n", "\n1.5 2.5 -1 3.5 4.5 7\n"))
    assert read_colmap(folder).names == NAMES
    images.write_text(written.replace("\n\n", "\n"))
    with pytest.raises(FileFormatError, match=r"images\.txt: the line after image a must hold"):
        read_colmap(folder)


def test_a_camera_of_colmap_is_described_once(rig, tmp_path):
    folder = write_colmap_text(tmp_path / "sparse", rig, NAMES)
    cameras = folder / "cameras.txt"
    cameras.write_text(f"{cameras.read_text()}3 SIMPLE_PINHOLE 640 480 500 320 240\n")
    with pytest.raises(FileFormatError, match=r"cameras\.txt describes camera 3 twice"):
        read_colmap(folder)


def test_colmap_is_given_points_that_it_can_read_again(rig, tmp_path):
    for points in (np.full((2, 3), np.nan), np.ones((2, 2))):
        with pytest.raises(InvalidInputError, match="points"):
            write_colmap_text(tmp_path / "sparse", rig, NAMES, points)
    assert not (tmp_path / "sparse").exists()


def test_rotations_in_degrees_are_noticed(rig, tmp_path):
    path = write_anipose_toml(tmp_path / "calibration.toml", rig, NAMES)
    document = tomllib.loads(path.read_text())
    text = path.read_text()
    for at in range(len(NAMES)):
        radians = document[f"cam_{at}"]["rotation"]
        text = text.replace(str(radians), str(np.degrees(radians).tolist()))
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=r"rotation of camera \[cam_0\] is .* from degrees"):
        read_anipose_toml(path)


def test_a_rotation_vector_turns_by_a_full_turn_at_most():
    whole = [2 * np.pi / np.sqrt(3) - 1e-9] * 3
    np.testing.assert_allclose(rotation_from_vector(whole, "r"), np.eye(3), atol=1e-8)
    for vector in ([5.0, 5.0, 5.0], [1e200, 0.0, 1e200]):
        with np.errstate(over="raise"), pytest.raises(InvalidInputError, match="than a full turn"):
            rotation_from_vector(vector, "r")


def test_wrong_types_are_named(rig, tmp_path):
    path = write_anipose_toml(tmp_path / "calibration.toml", rig, NAMES)
    unchecked = inspect.unwrap(default_names)  # as without type checks
    with pytest.raises(InvalidInputError, match="names must be a list, got int"):
        unchecked(rig, 4)
    with pytest.raises(InvalidInputError, match="ground must be a Plane, got list"):
        inspect.unwrap(cf.read_scene)(path, ground=[0, 0, 1, 0])


def test_ai_city_states_both_sides_of_an_image_and_a_matrix_with_the_position_last(rig, tmp_path):
    path = write_ai_city(tmp_path / "calibration.json", rig, NAMES)
    document = json.loads(path.read_text())
    first = document["sensors"][0]
    square = np.vstack([first["extrinsicMatrix"], [0, 0, 0, 1]])
    first["extrinsicMatrix"] = square.tolist()
    path.write_text(json.dumps(document))
    np.testing.assert_array_equal(read_ai_city(path).rig.t, rig.t)
    first["extrinsicMatrix"] = square.T.tolist()
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match="last row of extrinsicMatrix of sensor 0"):
        read_ai_city(path)
    del first["attributes"][1]
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match="size of sensor 0 is '1920' x None"):
        read_ai_city(path)


def test_opencv_entries_are_stated_once(rig, tmp_path):
    (path, *_) = write_opencv_yaml(tmp_path, rig, NAMES)
    path.write_text(f"{path.read_text()}t: [0, 0, 9]\n")
    with pytest.raises(FileFormatError, match="t is stated twice"):
        read_opencv_yaml(path)


def test_text_is_no_number_and_no_value_of_json_is_lost(rig, tmp_path):
    path = write_rig_json(tmp_path / "rig.json", rig, NAMES)
    text = path.read_text()
    width = f'"width": {rig.image_size[0, 0]}'
    path.write_text(text.replace(width, f'"width": "{rig.image_size[0, 0]}"', 1))
    with pytest.raises(FileFormatError, match="the image size of camera 0 must hold numbers only"):
        read_rig_json(path)
    path.write_text(text.replace(width, f"{width}, {width}0", 1))
    with pytest.raises(FileFormatError, match="'width' is stated twice"):
        read_rig_json(path)
