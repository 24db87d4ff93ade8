"""`Rig`: refused input, its place in errors, and geometry."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Lens, Rig
from catfree.errors import InvalidInputError
from catfree.types._archive import save_arrays
from catfree.types._rig import require_pinholes
from tests.types.camera_parameters import K, parameters

RAYS = np.random.default_rng(1).normal(size=(3, 5, 4, 3))
RAYS /= np.linalg.norm(RAYS, axis=-1, keepdims=True)


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
        ({"lens": ["pinhole", "mirror", "rays"]}, "lens has 'mirror'"),
        ({"lens": [0, 1, 7]}, r"lens has \[0, 1, 7\]"),
        ({"lens": [1, 1]}, r"lens must have shape \(3\)"),
        ({"lens": [0, 1, 0], "distortion": np.ones((3, 5))}, r"distortion\[1\] of a fisheye"),
        ({"lens": [0, 2, 0]}, r"rays must have shape \(3, n, n, 3\)"),
        ({"lens": [0, 2, 0], "rays": np.zeros((3, 4, 4, 3))}, r"rays\[1\] holds a ray that"),
        ({"lens": [0, 2, 0], "rays": RAYS[:, :2]}, "rays has 2 rows and 4 columns"),
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


def test_a_rig_may_mix_lenses(tmp_path):
    mixed = Rig(
        **parameters(),
        distortion=np.array([[0.1] * 8, [0.1] * 4 + [0] * 4, [0] * 8]),
        lens=["pinhole", "fisheye", "rays"],
        rays=RAYS,
    )
    np.testing.assert_array_equal(mixed.lens, [Lens.PINHOLE, Lens.FISHEYE, Lens.RAYS])
    mixed.save(tmp_path / "rig.npz")
    again = Rig.load(tmp_path / "rig.npz")
    for name, value in vars(mixed).items():
        np.testing.assert_array_equal(getattr(again, name), value)
    assert mixed.select([0]).lens is None
    assert mixed.select([1, 0]).rays is None
    np.testing.assert_array_equal(mixed.select([2, 0]).rays[0], RAYS[2])
    with pytest.raises(InvalidInputError, match=r"Camera 1 has a fisheye lens, and"):
        require_pinholes(mixed)
    require_pinholes(mixed.select([0]))


def test_rigs_saved_without_lenses_are_pinholes(tmp_path):
    old = {k: v for k, v in vars(Rig(**parameters())).items() if k not in ("lens", "rays")}
    save_arrays(tmp_path / "rig.npz", "Rig", old)
    assert (Rig.load(tmp_path / "rig.npz").lenses == Lens.PINHOLE).all()


def test_centres_are_where_the_camera_coordinates_vanish():
    rig = Rig(**parameters())
    at_camera = np.einsum("cij,cj->ci", rig.R, rig.centers) + rig.t
    np.testing.assert_allclose(at_camera, 0, atol=1e-12)


def test_centers_on_a_map_do_not_depend_on_the_digits_of_rotations():
    rig = Rig(**parameters())
    place = np.array([437_000.0, 5_411_000.0, 300.0]) + rig.centers
    R = np.round(rig.R, 6)
    on_map = replace(rig, R=R, t=-np.einsum("cij,cj->ci", R, place))
    np.testing.assert_allclose(on_map.centers, place, rtol=0, atol=1e-6)


def test_a_rig_of_jax_arrays_passes_through_jit():
    rig = Rig(**(parameters(dtype=np.float32) | {"K": jnp.asarray(parameters()["K"], jnp.int32)}))
    assert rig.K.dtype == jnp.float32
    moved = jax.jit(lambda r: r.centers)(jax.tree.map(jnp.asarray, rig))
    np.testing.assert_allclose(moved, rig.centers, atol=1e-6)
