"""`Plane`, `Scene`: refused input, geometry, and files of rigs and scenes."""

import dataclasses
import inspect
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from catfree import Detections, Plane, Rig, Scene, localize
from catfree.adapters import NamedRig, read_scene_json, write_scene_json
from catfree.errors import InvalidInputError
from catfree.geometry import Similarity, transform_scene
from catfree.synthetic import make_layout
from tests.types.camera_parameters import K, parameters

UNIT = st.floats(-1, 1)
NOBODY = Detections(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4)))


@pytest.mark.parametrize(
    ("points", "message"), [("abc", "got str"), ([1, 2], r"\(\.\.\., 3\), got \(2,\)")]
)
def test_distances_are_those_of_points(points, message):
    plane = Plane([0, 0, 1], 1)
    for use in (plane.signed_distance, plane.project):
        with pytest.raises(InvalidInputError, match=message):
            use(points)
    for one in (plane, Plane(jnp.array([0.0, 0, 1]), jnp.array(1.0))):
        np.testing.assert_array_equal(one.project([1, 2, 3]), [1, 2, -1])


@given(UNIT, UNIT, UNIT, st.floats(-10, 10), st.sampled_from([np.float32, np.float64]))
def test_the_basis_is_orthonormal_right_handed_and_in_the_plane(x, y, z, offset, dtype):
    normal = np.array([x, y, z])
    assume(np.linalg.norm(normal) > 1e-3)
    plane = Plane(normal.astype(dtype), dtype(offset))
    axes = np.column_stack([plane.basis, plane.normal]).astype(np.float64)
    tolerance = 20 * np.finfo(dtype).eps
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=tolerance)
    assert np.linalg.det(axes) > 0
    assert plane.basis.dtype == dtype


@pytest.mark.slow
def test_the_basis_of_a_level_plane_is_world_x_and_y():
    np.testing.assert_array_equal(Plane([0, 0, 1], 0).basis, np.eye(3)[:, :2])
    np.testing.assert_array_equal(Plane([0, 0, 5], 2).basis, np.eye(3)[:, :2])
    np.testing.assert_array_equal(Plane(jnp.array([0.0, 0.0, 1.0]), 0).basis, np.eye(3)[:, :2])


@pytest.mark.parametrize("length", [1e308, 1e160, 1e-160, 5e-324])
def test_very_long_and_short_normals_have_a_direction(length):
    plane = Plane(np.full(3, length), length)
    np.testing.assert_allclose(plane.normal, np.full(3, 3**-0.5), rtol=1e-15)
    np.testing.assert_allclose(plane.offset, 3**-0.5, rtol=1e-15)
    assert isinstance(plane.offset, np.ndarray)
    short = Plane(np.full(3, 1e-30, np.float32), np.float32(1e-30))
    np.testing.assert_allclose(short.normal, np.full(3, 3**-0.5), rtol=1e-6)
    with pytest.raises(InvalidInputError, match="offset of a plane in units of its normal"):
        Plane(np.full(3, 1e-160), 1e160)


@given(UNIT, UNIT, UNIT, UNIT, UNIT, UNIT, st.floats(-10, 10), st.floats(1e-3, 1e3))
def test_distances_do_not_depend_on_the_length_of_the_normal(x, y, z, a, b, c, offset, scale):
    normal, point = np.array([x, y, z]), np.array([a, b, c])
    assume(np.linalg.norm(normal) > 1e-2)
    plane, scaled = Plane(normal, offset), Plane(scale * normal, scale * offset)
    distance = plane.signed_distance(point)
    np.testing.assert_allclose(distance, scaled.signed_distance(point), rtol=1e-9, atol=1e-9)
    foot = plane.project(point)
    np.testing.assert_allclose(plane.signed_distance(foot), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(point - foot), abs(distance), atol=1e-9)


@pytest.mark.parametrize(
    ("normal", "offset", "message"),
    [
        ([0, 0, 0], 1.0, "non-zero normal"),
        ([0, np.nan, 1], 1.0, r"normal\[1\]"),
        ([0, 0, 1], np.inf, "offset.*not finite"),
        ([0, 1], 0.0, r"normal must have shape \(3\)"),
        ([0, 0, 1], [0.0], r"offset must have shape \(\)"),
    ],
)
def test_what_a_plane_refuses(normal, offset, message):
    with pytest.raises(InvalidInputError, match=message):
        Plane(normal, offset)


def test_what_a_scene_refuses():
    scene = make_layout("ring4").scene
    for extent in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidInputError, match="extent"):
            Scene(scene.rig, scene.ground, extent)
    with pytest.raises(InvalidInputError, match="negative side"):
        Scene(scene.rig, Plane([0, 0, -1], 0.0), 10.0)
    with pytest.raises(InvalidInputError, match="at least 2 registered cameras"):
        Scene.from_rig(scene.rig.select([0]), scene.ground)


def test_extent_is_twice_the_median_distance_from_the_mean():
    R = np.tile(np.eye(3), (4, 1, 1))
    centers = np.array([[1.0, 0, 2], [-1, 0, 2], [0, 3, 2], [0, -3, 2]])
    rig = Rig(np.tile(K, (4, 1, 1)), R, -centers, (640, 480))
    assert Scene.from_rig(rig, Plane([0, 0, 1], 0)).extent == 4.0


@pytest.mark.slow
@given(
    st.integers(1, 4),
    st.sampled_from([np.float32, np.float64]),
    st.booleans(),
    st.booleans(),
)
def test_files_give_back_every_bit(tmp_path, cameras, dtype, distorted, metric):
    rig = Rig(
        **parameters(cameras, dtype),
        distortion=np.full((cameras, 5), 0.1, dtype) if distorted else None,
        registered=np.arange(cameras) != 1,
    )
    normal = np.array([0.3, -0.5, 0.8], dtype)
    height = float((rig.centers @ normal).min())
    scene = Scene(rig, Plane(normal, dtype(1 - height)), dtype(3.3), metric)
    rig.save(tmp_path / "rig.npz")
    scene.save(tmp_path / "scene.npz")
    again = Scene.load(tmp_path / "scene.npz")
    assert again.metric is metric
    for back in (Rig.load(tmp_path / "rig.npz"), again.rig):
        assert_same_bits(back, rig)
    assert_same_bits(again.ground, scene.ground)
    assert (again.extent.dtype, again.extent) == (scene.extent.dtype, scene.extent)


def assert_same_bits(back, wanted):
    for name, value in vars(wanted).items():
        other = getattr(back, name)
        if value is None:
            assert other is None
        else:
            assert (other.dtype, other.shape) == (value.dtype, value.shape)
            assert other.tobytes() == value.tobytes()


@pytest.mark.slow
def test_the_offset_may_be_fixed_while_the_normal_is_differentiated(x64):
    # |n · x / |n|| with x = (1, 2, 3) and n = z: the derivative is the part of x across n.
    gradient = jax.grad(lambda normal: Plane(normal, 0.0).signed_distance(np.array([1.0, 2, 3])))
    np.testing.assert_allclose(gradient(jnp.array([0.0, 0, 1])), [1, 2, 0], atol=1e-15)


def test_a_metric_rig_in_millimetres_or_centimetres_is_refused(tmp_path):
    K = np.tile([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]], (3, 1, 1))
    R = np.tile(np.diag([1.0, -1.0, -1.0]), (3, 1, 1))
    plane = Plane([0.0, 0.0, 1.0], 0.0)
    for unit in (100.0, 1000.0):
        t = np.array([[0.0, 0.0, 0.5], [3.0, 0.0, 3.0], [np.nan] * 3]) * unit
        rig = Rig(K, R, t, (640, 480), registered=[True, True, False])
        assert not Scene.from_rig(rig, plane).metric
        unchecked = Scene(rig, plane, 1.0, metric=True)
        unchecked.save(tmp_path / "scene.npz")
        write_scene_json(tmp_path / "scene.json", unchecked)
        for enter in (
            lambda rig=rig: Scene.from_rig(rig, plane, metric=True),
            lambda: Scene.load(tmp_path / "scene.npz"),
            lambda: read_scene_json(tmp_path / "scene.json"),
        ):
            with pytest.raises(InvalidInputError, match=rf"Camera 1 is {3 * unit:g} m .*by 1000"):
                enter()


def test_a_rig_with_names_is_taken_for_its_rig():
    K = np.tile([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]], (2, 1, 1))
    R = np.tile(np.diag([1.0, -1.0, -1.0]), (2, 1, 1))
    rig = Rig(K, R, [[0.0, 0, 3], [1.0, 0, 3]], (640, 480))
    plane = Plane([0.0, 0.0, 1.0], 0.0)
    assert Scene.from_rig(NamedRig(rig, ("a", "b")), plane).rig is rig
    with pytest.raises(InvalidInputError, match="rig must be a Rig, got str"):
        Scene.from_rig("rig.json", plane)


@pytest.mark.slow
@given(st.none() | st.floats(0, 1e3), st.floats(1e-3, 1e3))
def test_the_deviation_of_the_rig_is_kept_and_scales(tmp_path_factory, deviation, scale):
    known = dataclasses.replace(make_layout("ring4").scene, rig_sd=deviation)
    folder = tmp_path_factory.mktemp("scene")
    known.save(folder / "scene.npz")
    assert Scene.load(folder / "scene.npz").rig_sd == deviation
    write_scene_json(folder / "scene.json", known)
    assert read_scene_json(folder / "scene.json")[0].rig_sd == deviation
    larger = transform_scene(Similarity(scale, np.eye(3), np.zeros(3)), known)
    if deviation is None:
        assert larger.rig_sd is None
    else:
        assert larger.rig_sd == pytest.approx(scale * deviation)


@pytest.mark.parametrize("deviation", [-1.0, np.nan, np.inf, "a", [1.0]])
def test_a_deviation_that_is_none_is_refused(deviation):
    with pytest.raises(InvalidInputError, match=r"rig_sd is .*; it must be a"):
        dataclasses.replace(make_layout("ring4").scene, rig_sd=deviation)


def test_a_normal_that_is_nearly_a_unit_is_made_one_and_a_unit_stays_bit_for_bit():
    rough = np.array([0.6, 0.0, 0.8]) * (1 + 1e-8)
    plane = Plane(rough, 5e6)
    assert abs(np.linalg.norm(plane.normal) - 1) < 1e-15
    np.testing.assert_array_equal(Plane(plane.normal, plane.offset).normal, plane.normal)
    # A point on the plane, far from the origin of a map.
    assert abs(plane.signed_distance(-5e6 * rough / (rough @ rough))) < 1e-8


def test_a_scene_of_other_things_is_refused_with_how_to_make_one():
    rig = make_layout("ring4").rig
    scene = Scene.from_rig(rig, Plane([0, 0, 1], 0))
    for wrong, cure in [
        (rig, r"got Rig: make one with cf\.Scene\.from_rig"),
        (SimpleNamespace(rig=rig), r"make one with cf\.Scene\.from_rig"),
        (SimpleNamespace(scene=scene), r"Pass its \.scene"),
        ((scene, ("a",)), "holds 1 of them"),
        (5, "must be a Scene, got int"),
    ]:
        with pytest.raises(InvalidInputError, match=cure):
            inspect.unwrap(localize)(NOBODY, wrong)
    with pytest.raises(InvalidInputError, match=r"Pass its \.rig"):
        inspect.unwrap(Scene.__init__)(
            object.__new__(Scene), SimpleNamespace(rig=rig), scene.ground, 1.0
        )
