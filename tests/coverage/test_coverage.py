from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from catfree._coverage import (
    Coverage,
    camera_gain,
    coverage,
    rank_cameras,
    visible_area,
)
from catfree.adapters import read_uniform_json
from catfree.errors import DegenerateGeometryError, InsufficientDataError, InvalidInputError
from catfree.geometry import Similarity, ground_sigma, information, transform_scene
from catfree.geometry._plane import from_plan
from catfree.synthetic import make_layout
from catfree.types import Plane, Rig, Scene

AREA = (-6.0, 6.0, -5.0, 5.0)
SEEDS = st.integers(0, 10_000)
NOISE = 0.0206


def scene_of(seed, name="ring4"):
    return make_layout(name, seed).scene


def without(scene, camera):
    """Make the scene with a failed camera."""
    registered = scene.rig.registered & (np.arange(scene.rig.camera_count) != camera)
    rig = replace(scene.rig, registered=registered)
    return Scene(rig, scene.ground, scene.extent, scene.metric)


def inside_by_opencv(rig, points):
    """Return (C, N) whether each camera sees each world point, by cv2.projectPoints."""
    seen = []
    for c in range(rig.camera_count):
        lens = np.zeros(5) if rig.distortion is None else rig.distortion[c]
        rotation = cv2.Rodrigues(rig.R[c])[0]
        pixel = cv2.projectPoints(points, rotation, rig.t[c], rig.K[c], lens)[0][:, 0]
        depth = points @ rig.R[c, 2] + rig.t[c, 2]
        within = (pixel >= -0.5) & (pixel <= rig.image_size[c] - 0.5)
        seen.append(within.all(-1) & (depth > 0))
    return np.array(seen)


@pytest.mark.slow
@settings(max_examples=8)  # each compares 30 places individually
@given(seed=SEEDS)
def test_sigma_and_visibility_are_those_of_the_geometry(x64, seed):
    scene = scene_of(seed)
    result = coverage(scene, AREA, resolution=2.0)
    points = from_plan(scene, result.xy.reshape(-1, 2))
    seen = inside_by_opencv(scene.rig, points)
    np.testing.assert_array_equal(result.visible.reshape(4, -1), seen)
    np.testing.assert_array_equal(result.cameras.ravel(), seen.sum(0))
    for point, weights, sigma in zip(
        points, seen.T.astype(float), result.sigma.ravel(), strict=True
    ):
        sight = point - scene.rig.centers
        rays = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
        expected = ground_sigma(
            information(point, scene.rig.centers, rays, weights, NOISE), scene.ground
        )
        np.testing.assert_allclose(sigma, expected, rtol=1e-9)
    assert np.isinf(result.sigma[result.cameras < 2]).all()


@pytest.mark.slow
@given(seed=SEEDS)
def test_removing_a_camera_never_lowers_sigma(seed):
    scene = scene_of(seed)
    whole = coverage(scene, AREA, resolution=1.5)
    for camera in range(4):
        rest = coverage(without(scene, camera), AREA, resolution=1.5)
        assert (rest.sigma >= whole.sigma * (1 - 1e-4)).all()
        assert (rest.cameras == whole.cameras - whole.visible[camera]).all()
        assert rest.accuracy <= whole.accuracy + 1e-6
        assert rest.covered <= whole.covered


@pytest.mark.slow
@given(seed=SEEDS, camera=st.integers(0, 3))
def test_a_copy_of_a_camera_gives_the_map_of_the_rig_that_has_it_twice(seed, camera):
    scene = scene_of(seed)
    rig, center = scene.rig, np.asarray(scene.rig.centers)[camera]
    # The camera is held upright: rotated about its axis until the world's z points up in the
    # picture.
    x, y, _ = rig.R[camera] @ [0, 0, 1]
    level = Rotation.from_rotvec([0, 0, np.arctan2(-x, -y)]).as_matrix() @ rig.R[camera]
    R, t = rig.R.copy(), rig.t.copy()
    R[camera], t[camera] = level, -level @ center
    rig = replace(rig, R=R, t=t)
    scene = Scene(rig, scene.ground, scene.extent, scene.metric)
    copied = camera_gain(scene, center, center + level[2], AREA, like=camera, resolution=1.5).after
    doubled = Scene(rig.select([0, 1, 2, 3, camera]), scene.ground, scene.extent, scene.metric)
    twice = coverage(doubled, AREA, resolution=1.5)
    np.testing.assert_allclose(copied.sigma, twice.sigma, rtol=1e-3)
    np.testing.assert_array_equal(copied.visible, twice.visible)


@pytest.mark.slow
@settings(max_examples=8)
@given(
    seed=SEEDS,
    place=st.tuples(st.floats(5, 12), st.floats(-12, 12), st.floats(1, 8)),
    target=st.tuples(st.floats(-4, 4), st.floats(-4, 4)),
)
def test_one_more_camera_never_makes_any_place_worse(seed, place, target):
    scene = scene_of(seed)
    gain = camera_gain(scene, np.array(place), np.array([*target, 0.5]), AREA, resolution=1.5)
    assert (gain.after.sigma <= gain.before.sigma * (1 + 1e-4)).all()
    assert (gain.after.cameras >= gain.before.cameras).all()
    assert (gain.sigma_ratio <= 1 + 1e-4).all()
    assert gain.accuracy >= -1e-6
    assert gain.covered >= 0
    blind = ~gain.after.visible[-1]
    np.testing.assert_allclose(gain.sigma_ratio[blind], 1, rtol=1e-4)


@pytest.mark.slow
@settings(max_examples=8)
@given(seed=SEEDS, scale=st.floats(0.05, 20.0), turn=st.floats(-3.0, 3.0))
def test_what_a_camera_gives_moves_with_the_scene(x64, seed, scale, turn):
    scene = scene_of(seed)
    rotation = Rotation.from_rotvec([0.4, turn, -0.3]).as_matrix()
    move = Similarity(scale, rotation, np.array([3.0, -1.0, 2.0]))
    moved = transform_scene(move, scene)
    center, target = np.array([9.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.9])
    place = np.array([1.0, -1.0, 0.0])
    found = []
    for one, move_one in ((scene, lambda x: x), (moved, lambda x: np.asarray(move(x)))):
        at = move_one(place) @ np.asarray(one.ground.basis)
        half = 1e-4 * float(one.extent)
        around = (at[0] - half, at[0] + half, at[1] - half, at[1] + half)
        gain = camera_gain(one, move_one(center), move_one(target), around, resolution=4 * half)
        found.append((float(gain.after.sigma[0, 0]) / float(one.extent), gain.sigma_ratio[0, 0]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


@pytest.mark.slow
def test_a_new_camera_looks_where_it_is_told_and_stands_upright(x64):
    scene = scene_of(3)
    copied = camera_gain(scene, np.array([9.0, 0.0, 4.0]), np.array([0.0, 0.0, 1.0]), AREA)
    # In the middle of its picture it sees its target.
    nearest = np.argmin(np.linalg.norm(copied.after.xy.reshape(-1, 2), axis=-1))
    assert copied.after.visible[-1].ravel()[nearest]
    assert "%" in str(copied)
    with pytest.raises(DegenerateGeometryError, match="straight"):
        camera_gain(scene, np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, 1.0]), AREA)
    with pytest.raises(InvalidInputError, match="registered camera"):
        camera_gain(scene, np.array([9.0, 0, 4]), np.array([0.0, 0, 1]), AREA, like=7)
    with pytest.raises(InvalidInputError, match="like must hold whole numbers"):
        camera_gain(scene, np.array([9.0, 0, 4]), np.array([0.0, 0, 1]), AREA, like=True)


@pytest.mark.slow
@settings(max_examples=8)
@given(seed=SEEDS, order=st.permutations(range(4)))
def test_the_order_of_cameras_has_no_effect(seed, order):
    scene = scene_of(seed)
    shuffled = Scene(scene.rig.select(np.array(order)), scene.ground, scene.extent, scene.metric)
    before = coverage(scene, AREA, resolution=1.5)
    after = coverage(shuffled, AREA, resolution=1.5)
    np.testing.assert_array_equal(after.visible, before.visible[np.array(order)])
    np.testing.assert_allclose(after.sigma, before.sigma, rtol=1e-4)


@pytest.mark.slow
@given(
    seed=SEEDS,
    scale=st.floats(0.01, 100.0),
    turn=st.floats(-3.0, 3.0),
    shift=st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
)
def test_the_map_moves_with_the_scene(x64, seed, scale, turn, shift):
    scene = scene_of(seed)
    rotation = Rotation.from_rotvec([0.3, turn, -0.2]).as_matrix()
    move = Similarity(scale, rotation, np.array(shift))
    moved = transform_scene(move, scene)
    before = coverage(scene, AREA, resolution=2.0)
    # The plan's axes do not follow the world's rotation: check one moved place at a time.
    places = np.asarray(move(from_plan(scene, before.xy.reshape(-1, 2)))) @ moved.ground.basis
    cell = 1e-4 * scale
    for place, sigma, cameras in zip(
        places[::13], before.sigma.ravel()[::13], before.cameras.ravel()[::13], strict=True
    ):
        around = (place[0] - cell, place[0] + cell, place[1] - cell, place[1] + cell)
        after = coverage(moved, around, resolution=2 * cell)
        assert after.sigma.shape == (1, 1)
        assert after.cameras[0, 0] == cameras
        np.testing.assert_allclose(after.sigma[0, 0], scale * sigma, rtol=1e-6)


@pytest.mark.slow
@settings(max_examples=8)  # each evaluates two maps of 40 000 cells
@given(seed=SEEDS, scale=st.floats(0.01, 100.0), shift=st.floats(-100.0, 100.0))
def test_default_area_and_resolution_are_relative_to_the_extent(x64, seed, scale, shift):
    scene = scene_of(seed)
    move = Similarity(scale, np.eye(3), np.array([shift, -shift, 0.0]))
    before, after = coverage(scene), coverage(transform_scene(move, scene))
    assert before.sigma.shape == after.sigma.shape
    np.testing.assert_allclose(after.x, scale * before.x + shift, rtol=1e-6, atol=1e-6 * scale)
    assert after.accuracy == pytest.approx(before.accuracy, abs=1e-3)
    assert after.radius == pytest.approx(scale * before.radius)


@pytest.mark.slow
def test_visible_area_holds_what_two_cameras_see():
    scene = scene_of(5)
    x_min, x_max, y_min, y_max = visible_area(scene)
    result = coverage(scene, (x_min - 3, x_max + 3, y_min - 3, y_max + 3), resolution=0.4)
    middle = np.asarray(scene.rig.centers)[:, :2].mean(0)
    near = np.linalg.norm(result.xy - middle, axis=-1) <= float(scene.extent) - 0.4
    x, y = result.xy[(result.cameras >= 2) & near].T
    assert x_min <= x.min()
    assert x.max() <= x_max
    assert y_min <= y.min()
    assert y.max() <= y_max


@pytest.mark.slow
def test_a_camera_at_the_same_place_matters_least():
    scene = scene_of(2)
    rig = scene.rig
    doubled = rig.select([0, 1, 2, 3, 1])
    ranking = rank_cameras(Scene(doubled, scene.ground, scene.extent, True), AREA, resolution=1.0)
    assert set(ranking.order[:2].tolist()) == {1, 4}
    assert ranking.accuracy_without[0] == pytest.approx(ranking.accuracy_without[1], abs=1e-6)
    assert (np.diff(ranking.accuracy_without) <= 0).all()
    assert (ranking.accuracy_without <= ranking.accuracy).all()
    for place, camera in enumerate(ranking.order):
        whole = Scene(doubled, scene.ground, scene.extent, True)
        rest = coverage(without(whole, camera), AREA, resolution=1.0)
        assert ranking.covered_without[place] == rest.covered
        assert ranking.median_sigma_without[place] == pytest.approx(rest.median_sigma)


def test_accuracy_is_the_gaussian_mass_in_the_disc():
    rng = np.random.default_rng(0)
    sigma = np.array([[0.3, 1.0], [4.0, np.inf]])
    x = y = np.arange(2.0)
    one = Coverage(x, y, np.ones((2, 2, 2), bool), sigma, 0.5, (-0.5, 1.5, -0.5, 1.5))
    inside = [
        (np.linalg.norm(s * rng.standard_normal((200_000, 2)), axis=-1) <= 0.5).mean()
        for s in (0.3, 1.0, 4.0)
    ]
    assert one.accuracy == pytest.approx(sum(inside) / 4, abs=2e-3)
    assert one.median_sigma == 4.0


@pytest.mark.slow
@settings(max_examples=8)
@given(width=st.floats(0.05, 2), height=st.floats(0.05, 2), at=st.floats(-3, 3))
def test_the_cells_fill_the_area_also_in_a_single_row_or_column(width, height, at):
    area = (at, at + width, -at, height - at)
    found = coverage(scene_of(0), area, resolution=0.5)
    assert found.area == area
    for centers, (low, high) in ((found.x, area[:2]), (found.y, area[2:])):
        edges = low + (high - low) * np.linspace(0, 1, len(centers) + 1)
        np.testing.assert_allclose(centers, (edges[1:] + edges[:-1]) / 2)


@pytest.mark.slow
def test_heads_must_be_in_the_picture_if_a_height_is_given(x64):
    scene = scene_of(7)
    feet = coverage(scene, (-12.0, 12.0, -12.0, 12.0), resolution=1.0)
    tall = coverage(scene, (-12.0, 12.0, -12.0, 12.0), resolution=1.0, person_height=1.8)
    heads = from_plan(scene, feet.xy.reshape(-1, 2)) + np.array([0.0, 0.0, 1.8])
    both = feet.visible.reshape(4, -1) & inside_by_opencv(scene.rig, heads)
    np.testing.assert_array_equal(tall.visible.reshape(4, -1), both)
    assert tall.visible.sum() < feet.visible.sum()


@pytest.mark.slow
def test_points_that_a_lens_polynomial_folds_back_are_not_seen(x64):
    scene = scene_of(1)
    lens = np.tile([-0.35, 0.0, 0.0, 0.0, 0.0], (4, 1))
    rig = scene.rig
    bent = Rig(rig.K, rig.R, rig.t, rig.image_size, lens)
    wide = (-30.0, 30.0, -30.0, 30.0)
    result = coverage(Scene(bent, scene.ground, scene.extent, True), wide, resolution=2.0)
    points = from_plan(scene, result.xy.reshape(-1, 2))
    claimed, seen = inside_by_opencv(bent, points), result.visible.reshape(4, -1)
    in_camera = np.einsum("cij,nj->cni", rig.R, points) + rig.t[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (in_camera[..., :2] ** 2).sum(-1) / in_camera[..., 2] ** 2
    folds_at = 1 / np.sqrt(3 * 0.35)  # where r (1 + k1 r²) stops growing
    invertible = squared < folds_at**2
    # On the fold itself both sides have one pixel.
    clear = np.abs(np.sqrt(squared) / folds_at - 1) > 0.02
    np.testing.assert_array_equal(seen[clear], (claimed & invertible)[clear])
    assert (claimed & ~invertible).any()


@pytest.mark.slow
def test_unregistered_cameras_see_nothing_and_may_hold_nan():
    scene = scene_of(4)
    rig, known = scene.rig, np.array([True, True, True, False])
    broken = [
        np.where(known.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in (rig.K, rig.R, rig.t)
    ]
    lost = Scene(Rig(*broken, rig.image_size, registered=known), scene.ground, scene.extent, True)
    result = coverage(lost, AREA, resolution=1.0)
    assert not result.visible[3].any()
    expected = coverage(without(scene, 3), AREA, resolution=1.0)
    np.testing.assert_allclose(result.sigma, expected.sigma, rtol=1e-3)
    assert rank_cameras(lost, AREA, resolution=2.0).order.tolist().count(3) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"area": (1.0, 0.0, 0.0, 1.0)}, "area"),
        ({"area": AREA, "resolution": 0.0}, "resolution"),
        ({"area": AREA, "sigma_theta": 0.0}, "sigma_theta"),
        ({"area": AREA, "sigma_theta": np.nan}, "sigma_theta"),
        ({"area": (0.0, np.inf, 0.0, 1.0)}, "area.*finite"),
        ({"area": AREA, "resolution": 1e-9}, "resolution of 1e-09 over an area of .* x .* cells"),
        ({"resolution": 1e-9}, "resolution of 1e-09 over an area"),
        ({"area": AREA, "resolution": 1e-320}, "resolution of"),
        ({"area": AREA, "person_height": np.nan}, "person_height is nan"),
        ({"area": AREA, "person_height": -5}, "person_height is -5"),
        ({"area": AREA, "person_height": 10**400}, "person_height is 1000"),
        ({"area": AREA, "resolution": 10**400}, "resolution is 1000"),
        ({"area": (0, 10**400, 0, 1)}, "area is"),
    ],
)
def test_impossible_arguments_are_named(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        coverage(scene_of(0), **arguments)


def test_one_camera_is_not_enough():
    scene = scene_of(0)
    alone = Scene(scene.rig.select([0]), scene.ground, scene.extent, True)
    with pytest.raises(InsufficientDataError, match="at least 2"):
        coverage(alone, AREA)


@pytest.mark.slow
def test_float32_agrees_with_float64():
    scene = scene_of(6)
    single = coverage(scene, AREA, resolution=1.0)
    with jax.enable_x64(True):
        double = coverage(scene, AREA, resolution=1.0)
        assert jnp.zeros(()).dtype == jnp.float64
    np.testing.assert_allclose(single.sigma, double.sigma, rtol=1e-3)


@pytest.mark.slow
def test_the_medians_of_the_public_calibration(shared):
    scene = read_uniform_json(shared / "data/real/wildtrack_0_715.json").scene
    medians = []
    for count in (2, 4, 7):
        rig = scene.rig.select(np.arange(count))
        part = Scene(rig, Plane(scene.ground.normal, scene.ground.offset), scene.extent, True)
        medians.append(100 * coverage(part, (-3.0, 9.0, 0.0, 14.0)).median_sigma)
    # Centimeters for 2, 4 and 7 cameras, computed earlier without the pictures' borders.
    assert medians[0] > medians[1] > medians[2]
    assert medians[2] == pytest.approx(15.3, rel=0.5)
