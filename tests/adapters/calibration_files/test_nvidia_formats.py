"""The cameras of NVIDIA's trackers and of the AI City Challenge."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.adapters import read_ai_city, read_mv3dt, write_ai_city, write_mv3dt
from catfree.adapters.calibration_files._projection_matrices import decomposed
from catfree.errors import FileFormatError, InvalidInputError
from catfree.synthetic import make_layout

NAMES = ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def rig():
    return replace(make_layout("ring4", 0).rig, distortion=None)


def require_same(found, rig):
    for part in ("K", "R", "t"):
        expected = np.asarray(getattr(rig, part))
        np.testing.assert_allclose(getattr(found, part), expected, rtol=1e-7, atol=1e-7)
    np.testing.assert_array_equal(found.image_size, rig.image_size)


def projected(rig, camera, points):
    vector = cv2.Rodrigues(np.asarray(rig.R)[camera])[0]
    K, t = np.asarray(rig.K)[camera], np.asarray(rig.t)[camera]
    return cv2.projectPoints(points, vector, t, K, None)[0][:, 0]


def test_mv3dt_files_are_yaml_with_one_matrix(rig, tmp_path):
    files = write_mv3dt(tmp_path / "camInfo", rig, NAMES, person_height=1.8)
    assert [path.name for path in files] == ["a.yml", "b.yml", "c.yml", "d.yml"]
    points = np.random.default_rng(0).uniform([-3, -3, 0], [3, 3, 2], (9, 3))
    for camera, path in enumerate(files):
        document = yaml.safe_load(path.read_text())
        assert document["modelInfo"] == [{"classID": 0, "height": 1.8, "radius": 0.3}]
        P = np.array(document["projectionMatrix_3x4_w2p"]).reshape(3, 4)
        pixel = np.column_stack([points, np.ones(9)]) @ P.T
        expected = projected(rig, camera, points)
        np.testing.assert_allclose(pixel[:, :2] / pixel[:, 2:], expected, rtol=1e-6)
    found = read_mv3dt(files, image_size=tuple(rig.image_size[0].tolist()))
    assert found.names == NAMES
    require_same(found.rig, rig)


def test_ai_city_matrices_agree_with_each_other(rig, tmp_path):
    path = write_ai_city(tmp_path / "calibration.json", rig, NAMES)
    found = read_ai_city(path)
    assert found.names == NAMES
    require_same(found.rig, rig)
    document = json.loads(path.read_text())
    ground = np.random.default_rng(1).uniform(-3, 3, (9, 2))
    for camera, sensor in enumerate(document["sensors"]):
        pixel = np.column_stack([ground, np.ones(9)]) @ np.array(sensor["homography"]).T
        expected = projected(rig, camera, np.column_stack([ground, np.zeros(9)]))
        np.testing.assert_allclose(pixel[:, :2] / pixel[:, 2:], expected, rtol=1e-6)
        del sensor["intrinsicMatrix"]
    document["sensors"].append({"type": "radar", "id": "r"})
    path.write_text(json.dumps(document))
    require_same(read_ai_city(path).rig, rig)  # from cameraMatrix alone


@pytest.mark.slow
@given(
    scale=st.floats(-100, 100).filter(lambda x: abs(x) > 1e-2),
    turn=st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    place=st.lists(st.floats(-50, 50), min_size=3, max_size=3),
)
def test_a_projection_of_any_scale_has_one_camera(scale, turn, place):
    K = np.array([[1000.0, 2, 640], [0, 900, 360], [0, 0, 1]])
    R, t = Rotation.from_rotvec(turn).as_matrix(), np.array(place)
    found = decomposed(scale * K @ np.column_stack([R, t]))
    for value, expected in zip(found, (K, R, t), strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-6)


@pytest.mark.parametrize("scale", [1e150, np.inf])
def test_a_matrix_beyond_floats_is_of_no_camera(scale):
    with pytest.raises(InvalidInputError, match="not that of a camera at a finite place"):
        decomposed(scale * (1 + np.arange(12.0).reshape(3, 4) ** 2))


def test_lens_distortion_is_not_lost_silently(rig, tmp_path):
    bent = replace(rig, distortion=np.full((4, 5), 0.01))
    for write in (write_mv3dt, write_ai_city):
        with pytest.raises(InvalidInputError, match="camera 'a' has lens distortion"):
            write(tmp_path / "out", bent, NAMES)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("projectionMatrix_3x4_w2p:\n- 1.0\n", "must hold 3 x 4 numbers"),
        ("projectionMatrix_3x4:\n- 1.0\n", "has no 'projectionMatrix_3x4_w2p'"),
        ("projectionMatrix_3x4_w2p: [0,0,0,0,0,0,0,0,0,0,0,1]\n", "not that of a camera"),
    ],
)
def test_damaged_cam_info_is_named(text, sentence, tmp_path):
    (tmp_path / "cam.yml").write_text(text)
    with pytest.raises((FileFormatError, InvalidInputError), match=sentence):
        read_mv3dt(tmp_path / "cam.yml")


@pytest.mark.parametrize(
    ("sensors", "sentence"),
    [
        (3, "sensors must be a list"),
        ([], "holds no camera"),
        ([{"id": "a"}], "sensor 0 has no 'cameraMatrix'"),
        ([{"cameraMatrix": []}], "sensor 0 has no 'id'"),
        ([{"id": "a", "attributes": [{"name": "frameWidth", "value": "wide"},
          {"name": "frameHeight", "value": "9"}]}], "size of sensor 0 is 'wide' x '9'"),
    ],
)  # fmt: skip
def test_a_damaged_calibration_is_named(sensors, sentence, tmp_path):
    (tmp_path / "calibration.json").write_text(json.dumps({"sensors": sensors}))
    with pytest.raises(FileFormatError, match=sentence):
        read_ai_city(tmp_path / "calibration.json")
