"""Cameras and ground: every format gives the same scene, and invalid grounds are refused."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.adapters import (
    write_ai_city,
    write_anipose_toml,
    write_colmap_text,
    write_mv3dt,
    write_opencv_yaml,
    write_rig_json,
    write_scene_json,
)
from catfree.errors import FileFormatError, InvalidInputError
from catfree.synthetic import make_layout
from catfree.types import Rig, Scene

NAMES = ("a", "b", "c", "d")
FLOOR = cf.Plane(np.array([0.0, 0.0, 1.0]), 0.0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    rig = make_layout("ring4", 0).rig
    return replace(rig, distortion=None)


def written(folder, rig):
    """Write the same cameras in every format, with and without a ground."""
    scene = Scene.from_rig(rig, FLOOR, metric=True)
    scene.save(folder / "scene.npz")
    yaml, cam_info, colmap = folder / "yaml", folder / "camInfo", folder / "colmap"
    write_opencv_yaml(yaml, rig, NAMES)
    write_mv3dt(cam_info, rig, NAMES)
    (folder / "reconstruction" / "sparse").mkdir(parents=True)
    write_colmap_text(colmap, rig, NAMES)
    write_colmap_text(folder / "reconstruction" / "sparse" / "0", rig, NAMES)
    (folder / "run").mkdir()
    (folder / "pose2sim").mkdir()
    write_anipose_toml(folder / "pose2sim" / "Calib_scene.toml", rig, NAMES)
    (folder / "pose2sim" / "Config.toml").write_text("[project]")
    write_scene_json(folder / "run" / "scene.json", scene, NAMES)
    return [
        folder / "scene.npz",
        write_scene_json(folder / "my_scene.json", scene, NAMES),
        write_rig_json(folder / "my_rig.json", rig, NAMES, metric=True),
        write_anipose_toml(folder / "Calib.toml", rig, NAMES),
        write_ai_city(folder / "calibration.json", rig, NAMES),
        yaml,
        sorted(yaml.iterdir()),
        cam_info,
        colmap,
        colmap / "cameras.txt",
        folder / "reconstruction",
        folder / "run",
        folder / "pose2sim",
    ]


def test_every_format_gives_the_same_scene(rig, tmp_path):
    size = tuple(rig.image_size[0].tolist())
    for path in written(tmp_path, rig):
        scene, names = cf.read_scene(path, image_size=size)
        assert names in (NAMES, None), path
        assert scene.metric
        for part in ("K", "R", "t"):
            np.testing.assert_allclose(
                getattr(scene.rig, part), getattr(rig, part), rtol=1e-7, atol=1e-7
            )
        np.testing.assert_array_equal(scene.rig.image_size, rig.image_size)
        np.testing.assert_allclose(scene.ground.normal, [0, 0, 1])


def test_an_image_size_that_contradicts_the_files_is_refused(rig, tmp_path):
    for path in written(tmp_path, rig):
        if path == tmp_path / "camInfo":  # its files state no size
            continue
        wrong = r"image_size is 800 x 600, but the calibration of camera .* Leave it out"
        with pytest.raises(cf.CatFreeError, match=wrong):
            cf.read_scene(path, image_size=(800, 600))


def test_the_case_of_a_suffix_does_not_matter(rig, tmp_path):
    size = tuple(rig.image_size[0].tolist())
    for path in written(tmp_path, rig)[:5]:  # formats of one file
        scene, names = cf.read_scene(path, image_size=size)
        same, same_names = cf.read_scene(
            path.rename(path.with_suffix(path.suffix.upper())), image_size=size
        )
        assert same_names == names
        np.testing.assert_array_equal(same.rig.K, scene.rig.K)


@pytest.mark.slow
@given(unit=st.sampled_from([("mm", 0.001), ("cm", 0.01), ("ft", 0.3048), ("m", 1.0)]))
def test_units_and_ground_are_those_of_the_file(unit, rig, tmp_path_factory):
    name, meters = unit
    folder = tmp_path_factory.mktemp("scene")
    raised = cf.Plane(np.array([0.0, 0.0, 2.0]), -0.5 / meters * 2)  # half a meter up
    path = write_anipose_toml(folder / "calibration.toml", rig, NAMES, metres_per_unit=meters)
    scene, _ = cf.read_scene(path, raised, name)
    np.testing.assert_allclose(scene.rig.t, rig.t, rtol=1e-9)
    np.testing.assert_allclose(float(scene.ground.offset), -0.5)
    np.testing.assert_allclose(scene.extent, Scene.from_rig(rig, FLOOR).extent)


def test_a_unit_that_nobody_knows(rig, tmp_path):
    colmap = write_colmap_text(tmp_path / "colmap", rig, NAMES)
    assert not cf.read_scene(colmap, unit="arbitrary")[0].metric
    path = write_rig_json(tmp_path / "rig.json", rig, NAMES, metric=False)
    assert not cf.read_scene(path)[0].metric
    with pytest.raises(InvalidInputError, match="states its unit of length; leave out"):
        cf.read_scene(path, unit="mm")


def test_another_ground_keeps_how_uncertain_the_cameras_are(rig, tmp_path):
    scene = replace(Scene.from_rig(rig, FLOOR, metric=True), rig_sd=0.2)
    path = cf.adapters.write_scene_json(tmp_path / "scene.json", scene, NAMES)
    raised, _ = cf.read_scene(path, cf.Plane(np.array([0.0, 0.0, 1.0]), -0.5))
    assert (raised.ground.offset, raised.rig_sd) == (-0.5, 0.2)


def test_a_board_on_the_floor_may_look_down(rig, tmp_path):
    # x_camera = R F (F x): the world turned by F, whose z points into the floor.
    flip = np.diag([1.0, -1.0, -1.0])
    turned = replace(rig, R=np.asarray(rig.R) @ flip)
    scene, _ = cf.read_scene(write_anipose_toml(tmp_path / "board.toml", turned, NAMES))
    np.testing.assert_array_equal(scene.ground.normal, [0, 0, -1])
    height = scene.ground.signed_distance(np.asarray(scene.rig.centers))
    np.testing.assert_allclose(height, np.asarray(rig.centers)[:, 2])


def test_z_0_is_not_taken_for_the_ground_where_cameras_do_not_look_at_it(rig, tmp_path):
    # As a reconstruction leaves it: axes of the first camera, y down.
    R = np.asarray(rig.R) @ np.asarray(rig.R)[0].T
    t = np.asarray(rig.t) - np.einsum("cij,j->ci", R, np.asarray(rig.t)[0])
    free = replace(rig, R=R, t=t)
    path = write_colmap_text(tmp_path / "colmap", free, NAMES)
    with pytest.raises(InvalidInputError, match=r"it is not z = 0: only . of 4 cameras"):
        cf.read_scene(path)
    normal = np.asarray(rig.R)[0] @ [0.0, 0.0, 1.0]
    ground = cf.Plane(normal, -normal @ np.asarray(rig.t)[0])
    scene, _ = cf.read_scene(path, ground, "arbitrary")
    height = scene.ground.signed_distance(np.asarray(scene.rig.centers))
    np.testing.assert_allclose(height, np.asarray(rig.centers)[:, 2], atol=1e-9)


def test_cameras_beyond_all_numbers_do_not_look_at_the_ground(rig, tmp_path):
    K = np.array(rig.K)
    K[0, 0, 0], K[0, 0, 2] = 1e-314, 1.0
    path = write_rig_json(tmp_path / "rig.json", rig, NAMES, metric=False)
    document = json.loads(path.read_text())
    for camera, matrix in zip(document["cameras"], K.tolist(), strict=True):
        camera["K"] = matrix
    path.write_text(json.dumps(document))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene, names = cf.read_scene(path)
    assert names == NAMES
    assert np.isfinite(scene.extent)


def test_wrong_units_are_noticed(rig, tmp_path):
    path = write_anipose_toml(tmp_path / "mm.toml", rig, NAMES, metres_per_unit=0.001)
    with pytest.raises(InvalidInputError, match="above the ground"):
        cf.read_scene(path)


def test_arrays_under_the_name_of_text_are_told(tmp_path):
    make_layout("ring4", 0).scene.save(tmp_path / "scene.json")
    with pytest.raises(FileFormatError, match=r"scene\.json .* that `save` wrote, name it \.npz"):
        cf.read_scene(tmp_path / "scene.json")


def test_what_is_no_calibration_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "list.json").write_text("[]")
    for path, sentence in [
        (tmp_path / "nothing", "There is no file"),
        (tmp_path / "empty", "holds no known calibration"),
        (tmp_path / "notes.txt", "is not a known calibration"),
        (tmp_path / "list.json", "is not a calibration"),
        ([], "list of calibration files is empty"),
    ]:
        with pytest.raises((InvalidInputError, FileFormatError), match=sentence):
            cf.read_scene(path)


@pytest.mark.parametrize(
    ("path", "cameras"),
    [("cmc1.json", 4), ("wildtrack_original", 7), ("multiviewx_demo10_original", 6)],
)
@pytest.mark.slow
def test_real_calibrations(path, cameras, shared):
    scene, names = cf.read_scene(shared / "data" / "real" / path)
    assert scene.metric
    assert names is not None
    assert len(names) == scene.rig.camera_count == cameras
