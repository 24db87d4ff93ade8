import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError, MissingDependencyError
from catfree.geometry import project
from catfree.viz import write_glb, write_rerun
from catfree.viz.scene3d._scene_geometry import (
    TUBE_SIDES,
    frustum_corners,
    track_lines,
    tracks_of,
    tube,
)


@pytest.mark.slow
def test_glb_loads_back_with_every_node(world, localization, tmp_path):
    cloud = np.random.default_rng(0).normal(size=(50, 3))
    path = write_glb(tmp_path / "scene.glb", world.scene, localization, points=cloud)
    loaded = trimesh.load(path)
    lines = track_lines(localization.tracks)
    names = set(loaded.graph.nodes_geometry)
    assert names == {
        "ground",
        "cloud",
        *(f"camera_C{camera + 1}" for camera in range(4)),
        *(f"track_{identity}" for identity in lines),
    }
    assert len(names) == 1 + 1 + 4 + len(lines)
    for identity in lines:
        assert loaded.geometry[f"track_{identity}"].is_watertight
    # glTF's y axis points up: the ground is y = 0 and the cameras are above it.
    assert np.abs(loaded.geometry["ground"].vertices[:, 1]).max() < 1e-6
    centers = np.asarray(world.scene.rig.centers)
    heights = world.scene.ground.signed_distance(centers)
    for camera in range(4):
        apex = loaded.geometry[f"camera_C{camera + 1}"].vertices[0]
        assert apex[1] == pytest.approx(heights[camera], rel=1e-4)
    apexes = np.array([loaded.geometry[f"camera_C{c + 1}"].vertices[0] for c in range(4)])
    for one in range(4):
        np.testing.assert_allclose(
            np.linalg.norm(apexes - apexes[one], axis=-1),
            np.linalg.norm(centers - centers[one], axis=-1),
            rtol=1e-4,
            atol=1e-6,
        )


def test_glb_without_tracks_or_points(world, tmp_path):
    path = write_glb(tmp_path / "scene.glb", world.scene, camera_names=["a", "b", "c", "d"])
    assert set(trimesh.load(path).graph.nodes_geometry) == {
        "ground",
        "camera_a",
        "camera_b",
        "camera_c",
        "camera_d",
    }
    assert [one.name for one in tmp_path.iterdir()] == ["scene.glb"]


def test_wrong_colours_and_folders_are_named(world, tmp_path):
    with pytest.raises(InvalidInputError, match="colors"):
        write_glb(
            tmp_path / "scene.glb", world.scene, points=np.zeros((3, 3)), colors=np.zeros((2, 3))
        )
    with pytest.raises(InvalidInputError, match="does not exist"):
        write_glb(tmp_path / "missing" / "scene.glb", world.scene)
    unchecked = inspect.unwrap(write_glb)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match=r"points must have shape \(n, 3\)"):
        unchecked(tmp_path / "scene.glb", world.scene, points=np.zeros(3))
    with pytest.raises(InvalidInputError, match="localization must be a Localization, got Scene"):
        inspect.unwrap(tracks_of)(world.scene)


@pytest.mark.slow
def test_frustum_corners_project_to_the_picture_corners(world):
    rig = world.scene.rig
    for camera in range(4):
        corners = frustum_corners(world.scene, camera, 0.1)
        np.testing.assert_allclose(corners[0], rig.centers[camera], atol=1e-6)
        width, height = rig.image_size[camera]
        expected = [
            (-0.5, -0.5),
            (width - 0.5, -0.5),
            (width - 0.5, height - 0.5),
            (-0.5, height - 0.5),
        ]
        for corner, pixel in zip(corners[1:], expected, strict=True):
            seen, depth = project(rig.K[camera], rig.R[camera], rig.t[camera], corner)
            np.testing.assert_allclose(seen, pixel, atol=0.05)
            assert float(depth) == pytest.approx(0.1, rel=1e-4)


@given(seed=st.integers(0, 1000), count=st.integers(2, 12))
def test_tubes_are_closed_and_as_wide_as_asked(seed, count):
    rng = np.random.default_rng(seed)
    points = np.pad(np.cumsum(rng.uniform(0.3, 1.0, (count, 2)), axis=0), ((0, 0), (0, 1)))
    vertices, faces = tube(points, 0.02, np.array([0.0, 0.0, 1.0]))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    length = np.linalg.norm(np.diff(points, axis=0), axis=-1).sum()
    octagon = TUBE_SIDES / 2 * 0.02**2 * np.sin(2 * np.pi / TUBE_SIDES)
    assert 0.5 * octagon * length < mesh.volume <= 1.001 * octagon * length
    rings = vertices[:-2].reshape(count, TUBE_SIDES, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - points[:, None], axis=-1), 0.02)


def test_a_track_that_turns_right_back_has_a_tube():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0]])
    vertices, faces = tube(points, 0.1, np.array([0.0, 0.0, 1.0]))
    assert np.isfinite(vertices).all()
    assert faces.max() == len(vertices) - 1


@pytest.mark.slow
def test_people_who_stand_still_have_no_path(localization):
    tracks = localization.tracks
    lines = track_lines(tracks)
    for identity, line in lines.items():
        assert (np.linalg.norm(np.diff(line, axis=0), axis=-1) > 0).all()
        own = tracks.position[tracks.track_id == identity]
        np.testing.assert_array_equal(line[0], own[0])
    assert track_lines(tracks[:1]) == {}


@pytest.mark.slow
def test_rerun_is_optional(world, localization, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'catfree\[rerun\]'"):
        write_rerun(tmp_path / "scene.rrd", world.scene, localization)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_rerun_writes_a_recording(world, localization, tmp_path):
    pytest.importorskip("rerun")
    path = write_rerun(tmp_path / "scene.rrd", world.scene, localization, points=np.zeros((2, 3)))
    assert path.stat().st_size > 1000
    assert [one.name for one in tmp_path.iterdir()] == ["scene.rrd"]


@pytest.mark.slow
def test_importing_viz_loads_no_drawing_library():
    code = (
        "import sys, catfree.viz\n"
        "print([m for m in ('matplotlib', 'cv2', 'trimesh', 'rerun') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[3]
    )
    assert done.stdout.strip() == "[]", done.stderr
