"""`Rig`, `Plane`, `Scene`: what they refuse and where, their geometry, and their files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from scipy.spatial.transform import Rotation

from catfree import Plane, Rig, Scene
from catfree.errors import InvalidInputError
from catfree.synthetic import make_layout

UNIT = st.floats(-1, 1)
K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])


def parameters(cameras: int = 3, dtype: type[np.floating] = np.float64) -> dict:
    rng = np.random.default_rng(0)
    return {
        "K": np.tile(K, (cameras, 1, 1)).astype(dtype),
        "R": Rotation.from_quat(rng.standard_normal((cameras, 4)))
        .as_matrix()
        .reshape(-1, 3, 3)
        .astype(dtype),
        "t": rng.standard_normal((cameras, 3)).astype(dtype),
        "image_size": (640, 480),
    }


@given(st.integers(1, 6), st.data())
def test_an_error_names_the_first_bad_camera(cameras, data):
    bad = data.draw(st.lists(st.integers(0, cameras - 1), min_size=1, unique=True))
    kind = data.draw(st.sampled_from(["focal", "form", "mirror", "nan", "size", "transposed"]))
    given_rig = parameters(cameras) | {"image_size": np.tile([640, 480], (cameras, 1))}
    match kind:
        case "focal":
            given_rig["K"][bad, 0, 0] = 0
        case "form":
            given_rig["K"][bad, 2, 2] = 2
        case "transposed":
            given_rig["K"][bad] = K.T
        case "mirror":
            given_rig["R"][bad, 0] *= -1
        case "nan":
            given_rig["t"][bad, 1] = np.nan
        case "size":
            given_rig["image_size"][bad, 1] = 0
    names = {"focal": "K", "form": "K", "transposed": "K", "mirror": "R", "nan": "t"}
    name = names.get(kind, "image_size")
    with pytest.raises(InvalidInputError, match=rf"{name}\[{min(bad)}[\],]"):
        Rig(**given_rig)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.eye(3)}, r"K must have shape \(n, 3, 3\), got \(3, 3\)"),
        ({"t": np.zeros((2, 3))}, r"t must have shape \(3, 3\)"),
        ({"image_size": (640, 480, 3)}, "image_size must have shape"),
        ({"image_size": (640.5, 480)}, r"image_size\[0\] is 640.5"),
        ({"distortion": np.zeros((3, 4))}, r"distortion must have shape \(3, 5\)"),
        ({"distortion": np.full((3, 5), np.inf)}, r"distortion\[0, 0\] is not finite"),
        ({"registered": [True]}, "registered must have shape"),
        ({"registered": [True, 3, True]}, r"registered\[1\]"),
    ],
)
def test_what_a_rig_refuses(change, message):
    with pytest.raises(InvalidInputError, match=message):
        Rig(**(parameters() | change))


def test_a_camera_that_is_not_registered_may_be_anything():
    wrong = parameters()
    for name in ("K", "R", "t"):
        wrong[name][1] = np.nan
    rig = Rig(**wrong, distortion=np.full((3, 5), 0.0), registered=[True, False, True])
    assert rig.select(rig.registered).camera_count == 2
    wrong["R"][1] = np.diag([1.0, 1.0, -1.0])
    Rig(**wrong, registered=[True, False, True])


def test_centres_are_where_the_camera_coordinates_vanish():
    rig = Rig(**parameters())
    at_camera = np.einsum("cij,cj->ci", rig.R, rig.centers) + rig.t
    np.testing.assert_allclose(at_camera, 0, atol=1e-12)


def test_a_rig_of_jax_arrays_passes_through_jit():
    rig = Rig(**(parameters(dtype=np.float32) | {"K": jnp.asarray(parameters()["K"], jnp.int32)}))
    assert rig.K.dtype == jnp.float32
    moved = jax.jit(lambda r: r.centers)(jax.tree.map(jnp.asarray, rig))
    np.testing.assert_allclose(moved, rig.centers, atol=1e-6)


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


def test_the_basis_of_a_level_plane_is_world_x_and_y():
    np.testing.assert_array_equal(Plane([0, 0, 1], 0).basis, np.eye(3)[:, :2])
    np.testing.assert_array_equal(Plane([0, 0, 5], 2).basis, np.eye(3)[:, :2])
    np.testing.assert_array_equal(Plane(jnp.array([0.0, 0.0, 1.0]), 0).basis, np.eye(3)[:, :2])


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


def test_the_offset_may_be_fixed_while_the_normal_is_differentiated(x64):
    # |n · x / |n|| with x = (1, 2, 3) and n = z: the derivative is the part of x across n.
    gradient = jax.grad(lambda normal: Plane(normal, 0.0).signed_distance(np.array([1.0, 2, 3])))
    np.testing.assert_allclose(gradient(jnp.array([0.0, 0, 1])), [1, 2, 0], atol=1e-15)
