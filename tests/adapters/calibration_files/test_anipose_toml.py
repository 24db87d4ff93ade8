"""`calibration.toml` as aniposelib, Pose2Sim, caliscope and FreeMoCap exchange it."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from catfree.adapters import read_anipose_toml, write_anipose_toml
from catfree.synthetic import make_layout

NAMES = ("a", "b", "c", "d")


@pytest.fixture
def rig():
    lens = np.tile([-0.1, 0.02, 0.001, 0.002, -0.003], (4, 1))
    return replace(make_layout("ring4", 0).rig, distortion=lens)


def test_a_table_has_what_pose2sim_and_caliscope_look_for(rig, tmp_path):
    path = write_anipose_toml(tmp_path / "Calib.toml", rig, NAMES, metres_per_unit=0.001)
    document = tomllib.loads(path.read_text())
    assert "metadata" in document
    for at, name in enumerate(NAMES):
        camera = document[f"cam_{at}"]
        assert camera["name"] == name
        shapes = {key: np.shape(camera[key]) for key in ("size", "matrix", "distortions")}
        assert shapes == {"size": (2,), "matrix": (3, 3), "distortions": (5,)}
        assert np.shape(camera["rotation"]) == np.shape(camera["translation"]) == (3,)
        assert camera["fisheye"] is False
        np.testing.assert_allclose(camera["translation"], 1000 * np.asarray(rig.t)[at])


def test_a_hall_of_many_cameras_comes_back(rig, tmp_path):
    many = rig.select(np.arange(400) % 4)
    again = read_anipose_toml(write_anipose_toml(tmp_path / "Calib.toml", many)).rig
    np.testing.assert_allclose(again.t, many.t)


@pytest.mark.slow
def test_aniposelib_sees_the_same_pixels(rig, tmp_path):
    cameras = pytest.importorskip("aniposelib.cameras", reason="aniposelib is not installed")
    group = cameras.CameraGroup.load(str(write_anipose_toml(tmp_path / "c.toml", rig, NAMES)))
    assert group.get_names() == list(NAMES)
    group.dump(str(tmp_path / "again.toml"))
    again = read_anipose_toml(tmp_path / "again.toml")
    assert again.names == NAMES
    for part in ("K", "R", "t", "image_size", "distortion"):
        expected = np.asarray(getattr(rig, part))
        np.testing.assert_allclose(getattr(again.rig, part), expected, rtol=1e-9, atol=1e-9)
    points = np.random.default_rng(0).uniform([-2, -2, 0], [2, 2, 2], (9, 3))
    shown = group.project(points).reshape(4, 9, 2)
    k1, k2, p1, p2, k3 = np.asarray(rig.distortion)[0]
    for camera in range(4):
        seen = points @ np.asarray(rig.R)[camera].T + np.asarray(rig.t)[camera]
        x, y = (seen[:, :2] / seen[:, 2:]).T
        r = x * x + y * y
        radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
        bent = [
            x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x),
            y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y,
            np.ones(9),
        ]
        pixel = np.stack(bent, axis=-1) @ np.asarray(rig.K)[camera].T
        np.testing.assert_allclose(shown[camera], pixel[:, :2], atol=1e-6)
