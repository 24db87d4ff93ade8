"""Ground coordinates and places on Earth: an independent computation and both directions agree."""

import inspect

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.errors import InvalidInputError
from catfree.geometry import Similarity, transform_scene
from catfree.synthetic import make_layout

AXIS, FLAT = 6378137.0, 1 / 298.257223563  # WGS 84

coordinates = st.floats(-500, 500)
references = st.tuples(
    st.floats(-180, 180), st.floats(-88, 88), st.floats(-180, 180),
    st.tuples(coordinates, coordinates), st.floats(0.01, 10),
)  # fmt: skip


def earth_centered(longitude, latitude, height=0.0):
    """Compute the point by the closed form with the reduced latitude."""
    polar = AXIS * (1 - FLAT)
    reduced = np.arctan(np.tan(latitude) * (1 - FLAT))
    foot = np.array([AXIS * np.cos(reduced), polar * np.sin(reduced)])
    p, z = foot + height * np.array([np.cos(latitude), np.sin(latitude)])
    return np.array([p * np.cos(longitude), p * np.sin(longitude), z])


@given(references, st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_places_are_those_of_an_independent_computation(given_reference, x, y):
    earth = cf.GeoReference(*given_reference)
    (longitude, latitude) = np.deg2rad(earth.to_longitude_latitude([[x, y]]))[0]
    base = np.deg2rad([earth.longitude, earth.latitude])
    # East, north, up by two rotations; y of the ground is `heading` clockwise from north.
    to_earth = Rotation.from_euler("ZY", [base[0], -base[1]]).as_matrix()[:, [1, 2, 0]]
    east_north = Rotation.from_euler("z", -earth.heading, degrees=True).apply(
        earth.meters_per_unit * np.append(np.subtract([x, y], earth.origin), 0)
    )
    point = earth_centered(*base) + to_earth @ east_north
    below = earth_centered(longitude, latitude)
    vertical = earth_centered(longitude, latitude, 1.0) - below
    assert np.linalg.norm(np.cross(point - below, vertical)) < 1e-6


@pytest.mark.parametrize(
    ("xy", "sentence"),
    [
        ([0.0, np.nan], r"xy\[1, 1\] is not finite"),
        ([1e300, 0.0], r"xy\[1\] is \[1e\+300, 0.0\], more than 50 km"),
        ([-1.7e308, 1.7e308], "more than 50 km"),
        ([0.0, 60_000.0], "more than 50 km"),
    ],
)
def test_places_too_far_away_are_refused(xy, sentence):
    earth = cf.GeoReference(8.5, 47.3, 30.0, (1.7e308, 0.0) if xy[0] < 0 else (0.0, 0.0))
    with pytest.raises(InvalidInputError, match=sentence):
        earth.to_longitude_latitude([earth.origin, xy])


@pytest.mark.slow
@given(references, st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_there_and_back(given_reference, x, y):
    earth = cf.GeoReference(*given_reference)
    again = earth.to_xy(earth.to_longitude_latitude([[x, y]]))
    np.testing.assert_allclose(again, [[x, y]], atol=1e-6 / earth.meters_per_unit)
    np.testing.assert_allclose(earth.residual([[x, y]], earth.to_longitude_latitude([[x, y]])), 0,
                               atol=1e-6)  # fmt: skip


@pytest.mark.slow
@given(references, st.integers(0, 99))
def test_a_moved_scene_stays_where_it_is_on_earth(given_reference, seed):
    earth = cf.GeoReference(*given_reference)
    rng = np.random.default_rng(seed)
    scene = make_layout("ring4").scene
    scene = cf.Scene(scene.rig, scene.ground, scene.extent, True, earth)
    moved = transform_scene(
        Similarity(rng.uniform(0.1, 5), Rotation.from_rotvec(rng.normal(size=3)).as_matrix(),
                   rng.normal(size=3)), scene,
    )  # fmt: skip
    again = transform_scene(Similarity.identity(), scene)
    assert again.georeference.to_array() == pytest.approx(earth.to_array(), abs=1e-3)
    for camera in range(scene.rig.camera_count):
        found = []
        for one in (scene, moved):
            center = np.asarray(one.rig.centers, np.float64)[camera]
            found.append(center @ np.asarray(one.ground.basis, np.float64))
        here = scene.georeference.to_longitude_latitude([found[0]])
        off = moved.georeference.residual([found[1]], here)
        assert off[0] < 1e-3 * earth.meters_per_unit * (1 + np.abs(found[0]).max())


@given(st.floats(-70, 70), st.floats(-0.001, 0.001), st.floats(1, 90))
def test_anchors_may_lie_on_both_sides_of_longitude_180(latitude, longitude, across):
    anchors = np.array([[0.0, 0], [across, 0], [0, 60]])
    there = cf.adapters.GeoReference(longitude, latitude).to_longitude_latitude(anchors)
    expected = cf.adapters.GeoReference.from_anchors(anchors, there)
    # By half a turn of Earth.
    moved = np.column_stack([there[:, 0] % 360 - 180, there[:, 1]])
    found = cf.adapters.GeoReference.from_anchors(anchors, moved)
    assert -180 <= found.longitude <= 180
    assert abs((found.longitude - expected.longitude) % 360 - 180) < 1e-9
    np.testing.assert_allclose(found.to_xy(moved), anchors, atol=1e-3)


def test_files_keep_the_place_and_old_files_have_none(tmp_path):
    earth = cf.GeoReference(8.5, 47.3, 30.0, (1.0, 2.0), 1.0)
    plain = make_layout("ring4").scene
    known = cf.Scene(plain.rig, plain.ground, plain.extent, True, earth)
    for scene, place in ((plain, None), (known, earth)):
        scene.save(tmp_path / "scene.npz")
        assert cf.Scene.load(tmp_path / "scene.npz").georeference == place
        cf.adapters.write_scene_json(tmp_path / "scene.json", scene)
        assert cf.read_scene(tmp_path / "scene.json")[0].georeference == place


@pytest.mark.parametrize("kind", [list, np.array])
def test_an_origin_may_be_any_pair(kind):
    tuples = cf.GeoReference(8.5, 47.3, 30.0, (1.0, 2.0))
    earth = object.__new__(cf.GeoReference)
    inspect.unwrap(cf.GeoReference.__init__)(earth, 8.5, 47.3, 30.0, kind((1.0, 2.0)))
    assert hash(earth) == hash(tuples)


@pytest.mark.parametrize("kind", [np.float32, np.array])
def test_numbers_of_numpy_are_stored_as_floats(kind, tmp_path):
    earth = object.__new__(cf.GeoReference)
    values = map(kind, (8.5, 47.25, 30.0))
    inspect.unwrap(cf.GeoReference.__init__)(earth, *values, meters_per_unit=kind(2.0))
    assert hash(earth) == hash(cf.GeoReference(8.5, 47.25, 30.0, meters_per_unit=2.0))
    plain = make_layout("ring4").scene
    scene = cf.Scene(plain.rig, plain.ground, plain.extent, True, earth)
    cf.adapters.write_scene_json(tmp_path / "scene.json", scene)
    assert cf.read_scene(tmp_path / "scene.json")[0].georeference == earth


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ((0.0, 95.0), "other order"),
        ((np.nan, 0.0), "finite"),
        ((0.0, 0.0, 0.0, (0.0, 0.0), 0.0), "positive"),
    ],
)
def test_a_georeference_that_is_none_is_refused(values, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        cf.GeoReference(*values)


def test_residuals_are_of_as_many_points_as_places():
    earth = cf.GeoReference(8.5, 47.3)
    places = earth.to_longitude_latitude(np.eye(2))
    np.testing.assert_allclose(earth.residual(np.eye(2), places), 0, atol=1e-6)
    for points in (np.eye(2)[:1], []):
        with pytest.raises(InvalidInputError, match=r"xy must have shape \(2, 2\)"):
            earth.residual(points, places)
