"""The ground of a scene: its cameras as maps from the plane, and their inverses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.geometry._person import box_edges, drop_to_height, height_at
from catfree.methods.evidence.observe._views import (
    ground_views,
)
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import make_rig

CAMERAS = 4

pytestmark = pytest.mark.usefixtures("x64")


def three(low, high):
    return st.lists(st.floats(low, high), min_size=3, max_size=3).map(np.array)


# Roll of the cameras, pose of the world, and its unit.
worlds = st.tuples(st.floats(-0.5, 0.5), three(-np.pi, np.pi), st.floats(0.1, 10), three(-9, 9))


def scene_of(world):
    """Make a ring of cameras around a plane of any pose, in any unit; also return the unit."""
    roll, turn, scale, shift = world
    rig = make_rig(CAMERAS, roll=roll)
    Q = Rotation.from_rotvec(turn).as_matrix()
    R = np.asarray(rig.R) @ Q.T
    t = scale * np.asarray(rig.t) - R @ shift
    normal = Q[:, 2]
    plane = cf.Plane(normal, -normal @ shift)
    return cf.Scene(cf.Rig(rig.K, R, t, rig.image_size), plane, 18 * scale), scale


# Compiled once.
edges = jax.jit(box_edges)
slopes = jax.jit(jax.jacfwd(box_edges, argnums=1))
drop = jax.jit(drop_to_height)
height_of = jax.jit(height_at)

places = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 1.5)).map(np.array)


def in_scene(scene, views, place, height):
    """Return the world point at a height above a place, in units of the views."""
    plane = scene.ground
    normal, basis = np.asarray(plane.normal), np.asarray(plane.basis)
    foot = basis @ (views.origin + views.unit * place[:2]) - float(plane.offset) * normal
    return foot + views.unit * height * normal


@pytest.mark.slow
@given(worlds, places, st.floats(0.3, 2))
def test_the_map_is_the_projection_of_the_scene(world, place, metres):
    scene, scale = scene_of(world)
    views = ground_views(scene, metres * scale)
    rig = scene.rig
    for height in (0.0, place[2]):
        point = in_scene(scene, views, place, height)
        for c in range(CAMERAS):
            pixel = rig.K[c] @ (rig.R[c] @ point + rig.t[c])
            mine = views.matrix[c] @ [*place[:2], height, 1]
            np.testing.assert_allclose(mine[:2] / mine[2], pixel[:2] / pixel[2], atol=1e-6)
            # Positive in front of the camera, like the depth.
            assert mine[2] * views.unit == pytest.approx(pixel[2])


@pytest.mark.slow
@given(worlds, places, st.integers(0, CAMERAS - 1))
def test_feet_and_heads_drop_back_to_where_they_are(world, place, camera):
    scene, scale = scene_of(world)
    views = ground_views(scene, 1.7 * scale)
    matrix = jnp.asarray(views.matrix[camera])
    column, top, bottom = edges(matrix, jnp.asarray(place), jnp.asarray(views.station[camera]), 0.0)
    for height, inverse in ((0.0, views.ground_inverse), (1.0, views.head_inverse)):
        pixel = views.matrix[camera] @ [*place[:2], height, 1]
        found = drop(jnp.asarray(inverse[camera]), jnp.asarray(pixel[:2] / pixel[2]))
        np.testing.assert_allclose(found, place[:2], atol=1e-9)
    assert float(height_of(matrix, jnp.asarray(place[:2]), top)) == pytest.approx(place[2])
    assert float(height_of(matrix, jnp.asarray(place[:2]), bottom)) == pytest.approx(0, abs=1e-9)
    ends = [views.matrix[camera] @ [*place[:2], h, 1] for h in (0, place[2])]
    assert float(column) == pytest.approx(np.mean([end[0] / end[2] for end in ends]))


@pytest.mark.slow
@given(worlds, st.floats(0.2, 5))
def test_a_larger_unit_makes_smaller_numbers_and_the_same_picture(world, factor):
    scene, scale = scene_of(world)
    one, other = (ground_views(scene, 1.7 * scale * f) for f in (1, factor))
    np.testing.assert_allclose(one.station, factor * other.station, rtol=1e-9, atol=1e-9)
    for name in ("focal", "center", "heading", "origin", "image_size"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    place = np.array([0.4, -0.3, 1.0, 1.0])
    scaled = np.append(place[:3] / factor, 1.0)
    np.testing.assert_allclose(factor * other.matrix @ scaled, one.matrix @ place, rtol=1e-9)


@pytest.mark.slow
@given(worlds)
def test_a_station_is_below_its_camera_which_looks_along_its_heading(world):
    scene, scale = scene_of(world)
    views = ground_views(scene, scale)
    np.testing.assert_allclose(np.linalg.norm(views.heading, axis=1), 1)
    for c in range(CAMERAS):
        foot = in_scene(scene, views, views.station[c], 0.0)
        up = np.asarray(scene.rig.centers[c]) - foot
        np.testing.assert_allclose(np.cross(up, scene.ground.normal), 0, atol=1e-9 * scale)
        # The cameras of this ring look at the point in its middle.
        np.testing.assert_allclose(
            views.heading[c], -views.station[c] / np.linalg.norm(views.station[c]), atol=1e-9
        )


def test_a_camera_that_looks_straight_down_heads_where_its_picture_is_up():
    down = cf.Rig(
        [[[800.0, 0, 640], [0, 800, 360], [0, 0, 1]]], [np.diag([1.0, -1, -1])], [[0, 0, 5.0]],
        (1280, 720),
    )  # fmt: skip
    scene = cf.Scene(down, cf.Plane([0.0, 0.0, 1.0], 0.0), 5.0)
    up = np.array([0.0, 1.0, 0.0]) @ np.asarray(scene.ground.basis)
    np.testing.assert_allclose(ground_views(scene, 1.7).heading, [up], atol=1e-12)


@pytest.mark.slow
@given(worlds, st.integers(0, CAMERAS - 1))
def test_an_unknown_camera_may_hold_anything_and_moves_no_other(world, camera):
    scene, scale = scene_of(world)
    known = np.arange(CAMERAS) != camera
    K, R, t = (np.array(a) for a in (scene.rig.K, scene.rig.R, scene.rig.t))
    both = []
    for junk in (np.nan, 7.0):
        K[camera], R[camera], t[camera] = junk, junk, junk
        rig = cf.Rig(K, R, t, scene.rig.image_size, registered=known)
        both.append(ground_views(cf.Scene(rig, scene.ground, scene.extent), scale))
    for one, other in zip(*map(jax.tree.leaves, both), strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)
    alone = cf.Scene(scene.rig.select(np.flatnonzero(known)), scene.ground, scene.extent)
    np.testing.assert_allclose(both[0].matrix[known], ground_views(alone, scale).matrix)


@pytest.mark.slow
@given(three(-2, 2))
def test_beside_and_behind_a_camera_values_and_slopes_are_finite(place):
    views = ground_views(cf.Scene(make_rig(CAMERAS), cf.Plane([0.0, 0.0, 1.0], 0.0), 18.0), 1.7)
    for c in range(CAMERAS):
        matrix = jnp.asarray(views.matrix[c])
        for away in (1.0, 1.0 + 1e-9, 3.0):
            state = jnp.asarray(np.append(away * views.station[c], 1.0) + (away == 3.0) * place)
            at = matrix, state, jnp.asarray(views.station[c]), FOOT_AHEAD
            assert np.isfinite(edges(*at)).all()
            assert np.isfinite(slopes(*at)).all()
