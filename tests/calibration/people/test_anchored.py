"""Anchors on a rig from people: laws, and the dense problem solved by SciPy."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.calibration.people import anchored
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    X,
    Z,
    from_matrices,
    projection,
    to_matrices,
)
from catfree.errors import CalibrationError, InvalidInputError
from catfree.geometry import fit_similarity
from catfree.settings import CalibrationSettings
from tests.known_calibration import calibration_of

pytestmark = pytest.mark.slow

RULES = CalibrationSettings()
CAMERAS = 4
SIZE = np.tile([1280, 720], (CAMERAS, 1))
CENTER = (SIZE[0] - 1) / 2
CROWD = 0.06  # meters


def true_cameras():
    """Return (C, 7) cameras around a place, 4 m high."""
    angle = np.arange(CAMERAS) * np.pi / 2 + 0.3
    place = np.stack([9 * np.cos(angle), 9 * np.sin(angle), np.linspace(3.5, 4.5, CAMERAS)], -1)
    fixed = np.full((CAMERAS, 3), [7.0, 0.4, 0.02])
    return np.column_stack([fixed, angle + np.pi / 2, place])


def rig_of(parameters, covariance, crowd=CROWD):
    K, R, t = to_matrices(parameters, SIZE)
    scene = cf.Scene.from_rig(cf.Rig(K, R, t, SIZE), cf.Plane([0.0, 0, 1], 0.0), metric=True)
    return calibration_of(
        scene,
        camera_covariance=covariance,
        scale_sd=crowd / RULES.person_height,
        crowd_height=RULES.person_height,
        crowd_height_sd=crowd,
    )


def drawn(seed, scale=None, size=1.0):
    """Draw a rig from people: the truth moved within its covariance, in units of the crowd."""
    rng = np.random.default_rng(seed)
    sd = size * np.tile([0.01, 0.004, 0.004, 0.004, 0.05, 0.05, 0.05], CAMERAS)
    half = sd[:, None] * rng.normal(size=(len(sd), len(sd))) / np.sqrt(len(sd))
    moved = true_cameras() + (half @ rng.normal(size=len(sd))).reshape(CAMERAS, 7)
    if scale is None:
        scale = np.exp(rng.normal() * CROWD / RULES.person_height)
    moved[:, X:] /= scale
    units = np.where(np.arange(7) >= X, 1 / scale, 1.0)
    covariance = (half @ half.T).reshape(CAMERAS, 7, CAMERAS, 7)
    return rig_of(moved, covariance * units[:, None, None] * units), rng


def pixel_of(camera, xy, rng=None, sd=1.0):
    x, y, depth = projection(true_cameras()[camera]) @ [*xy, 0.0, 1.0]
    pixel = np.array([x, y]) / depth
    return tuple((pixel + CENTER + (0 if rng is None else sd * rng.normal(size=2))).tolist())


def distance(camera, rng, factor=1.0, sd=0.02):
    ends = rng.uniform(-2, 2, (2, 2)) + np.array([[2, 0], [-2, 0]])
    meters = factor * np.linalg.norm(ends[0] - ends[1]) + sd * rng.normal()
    pixels = tuple(pixel_of(camera, end, rng) for end in ends)
    return cf.KnownDistance(camera, pixels, float(meters), sd, pixel_sd=1.0)


def point(camera, rng, off=(0.0, 0.0), turn=0.0, shift=(0.0, 0.0)):
    xy = rng.uniform(-3, 3, 2)
    R = Rotation.from_euler("z", turn).as_matrix()[:2, :2]
    place = R @ (xy + off) + shift + 0.02 * rng.normal(size=2)
    return cf.SurveyedPoint(
        camera, pixel_of(camera, xy, rng), tuple(place.tolist()), sd=0.02, pixel_sd=1.0
    )


def scale_error(calibration):
    fitted = fit_similarity(np.asarray(calibration.scene.rig.centers), true_cameras()[:, X:])
    return -np.log(float(fitted.scale))


def parameters_of(calibration):
    rig = calibration.scene.rig
    return from_matrices(*(np.asarray(a, np.float64) for a in (rig.K, rig.R, rig.t)))


def test_errors_of_the_scale_are_as_large_as_stated():
    ratios = []
    for seed in range(60):
        calibration, rng = drawn(seed)
        found = anchored(calibration, [distance(seed % CAMERAS, rng)])
        ratios.append(scale_error(found) / found.scale_sd)
    # The mean square of 60 standard normals is between 0.58 and 1.55 in 999 of 1000 cases.
    assert 0.58 < np.mean(np.square(ratios)) < 1.55


@settings(max_examples=8)
@given(st.integers(0, 10**6))
def test_one_more_consistent_anchor_never_makes_the_rig_less_sure(seed):
    calibration, rng = drawn(seed)
    first = [distance(0, rng), cf.KnownCamera(1, height=float(true_cameras()[1, Z]))]
    before = anchored(calibration, first)
    # The rig's own measurements agree with everything.
    camera = before.scene.rig
    shown = cf.KnownCamera(2, height=float(camera.centers[2, 2]), height_sd=0.01)
    after = anchored(calibration, [*first, shown])
    assert after.scale_sd <= before.scale_sd * (1 + 1e-6)
    assert after.crowd_height_sd <= before.crowd_height_sd * (1 + 1e-6)
    np.testing.assert_allclose(parameters_of(after), parameters_of(before), atol=1e-6)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.permutations(range(5)))
def test_the_order_of_anchors_changes_nothing(seed, order):
    calibration, rng = drawn(seed)
    anchors = [distance(0, rng), distance(1, rng, 1.5), *(point(c, rng) for c in (1, 2, 3))]
    one, other = (anchored(calibration, list(a)) for a in (anchors, [anchors[i] for i in order]))
    np.testing.assert_allclose(parameters_of(one), parameters_of(other), atol=1e-6)
    assert sorted(one.contradictions) == sorted(other.contradictions)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(0.5, 2))
def test_a_world_of_another_size_gives_a_rig_of_that_size(seed, size):
    calibration, rng = drawn(seed, scale=1.0)
    anchors = [distance(0, rng), cf.KnownCamera(1, height=4.0, height_sd=0.1)]
    larger = [
        dataclasses.replace(anchors[0], meters=size * anchors[0].meters, sd=size * 0.02),
        cf.KnownCamera(1, height=4.0 * size, height_sd=0.1 * size),
    ]
    units = np.where(np.arange(7) >= X, size, 1.0)
    grown = parameters_of(calibration) * units
    covariance = calibration.camera_covariance * units[:, None, None] * units
    other = rig_of(grown, covariance, CROWD * size)
    other = dataclasses.replace(other, crowd_height=size * RULES.person_height)
    one, other = anchored(calibration, anchors), anchored(other, larger)
    np.testing.assert_allclose(parameters_of(other), parameters_of(one) * units, rtol=1e-6)
    assert other.scale_sd == pytest.approx(one.scale_sd, rel=1e-6)
    assert other.crowd_height == pytest.approx(size * one.crowd_height, rel=1e-6)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-500, 500), st.floats(-500, 500))
def test_the_scene_comes_out_in_the_frame_of_the_map(seed, turn, x, y):
    calibration, _ = drawn(seed)
    one, other = (
        anchored(calibration, [point(c, np.random.default_rng(seed + c), **how) for c in range(3)])
        for how in ({}, {"turn": 0.0, "shift": (x, y)})
    )
    moved = np.asarray(one.scene.rig.centers) + np.array([x, y, 0])
    np.testing.assert_allclose(np.asarray(other.scene.rig.centers), moved, atol=1e-5)
    rng = np.random.default_rng(seed)
    turned = anchored(calibration, [point(c, rng, turn=turn, shift=(x, y)) for c in (0, 1, 2, 3)])
    R = Rotation.from_euler("z", turn).as_matrix()
    truth = true_cameras()[:, X:] @ R.T + [x, y, 0]
    off = np.asarray(turned.scene.rig.centers) - truth
    for camera in range(CAMERAS):
        covariance = turned.center_covariance[camera]
        assert off[camera] @ np.linalg.solve(covariance, off[camera]) < 30


def test_a_length_that_nothing_fits_is_not_told_to_be_on_a_map():
    calibration, rng = drawn(0)
    with pytest.raises(CalibrationError, match="The lengths and heights of the anchors contradict"):
        anchored(calibration, [distance(0, rng, 1e9)])


@settings(max_examples=8)
@given(st.integers(0, 10**6))
def test_an_anchor_that_contradicts_the_others_is_named_and_not_used(seed):
    calibration, rng = drawn(seed)
    good = [distance(0, rng), distance(1, rng)]
    bad = distance(2, rng, 1.4)
    found = anchored(calibration, [*good, bad])
    assert found.contradictions == (found.anchors[2].sentence,)
    assert "contradicts them and was not used" in found.contradictions[0]
    assert f"distance of {bad.meters:.2f} m in camera 2" in found.contradictions[0]
    without = anchored(calibration, good)
    np.testing.assert_allclose(parameters_of(found), parameters_of(without), atol=1e-6)
    (off,), (sd,) = found.anchors[2].difference, found.anchors[2].sd
    assert off == pytest.approx(bad.meters * 0.4 / 1.4, abs=4 * sd)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.sampled_from([0.7, 0.8, 1.25]))
def test_a_crowd_of_another_height_gives_way_to_an_anchor(seed, size):
    # The rig is in units of the crowd: as if these people were 1.70 m tall.
    calibration, rng = drawn(seed, scale=size)
    assert abs(scale_error(calibration)) > 0.15
    found = anchored(calibration, [distance(0, rng)])
    assert abs(scale_error(found)) < max(4 * found.scale_sd, 0.01)
    assert found.crowd_height == pytest.approx(
        size * RULES.person_height, abs=4 * found.crowd_height_sd + 0.02
    )
    (said,) = found.contradictions
    assert "but 1.70 m" in said


def test_lengths_that_no_crowd_explains_are_errors():
    calibration, rng = drawn(1)
    found = anchored(calibration, [distance(0, rng, 10.0)])
    assert not found.anchors[0].used
    assert found.crowd_height == calibration.crowd_height
    np.testing.assert_allclose(parameters_of(found), parameters_of(calibration), atol=1e-9)
    height = float(1000 * true_cameras()[0, Z])  # in millimeters
    found = anchored(calibration, [cf.KnownCamera(0, height=height)])
    assert not found.anchors[0].used


@pytest.mark.parametrize("unit", [3.28, 1000.0])
def test_anchors_in_another_unit_that_agree_with_each_other_are_refused(unit):
    calibration, rng = drawn(1)
    lengths = [distance(camera, rng, unit) for camera in (0, 1)]
    points = [cf.SurveyedPoint(1, pixel_of(1, (x, 1)), (unit * x, unit)) for x in (-2, 0, 2)]
    for anchors in (lengths, points):
        with pytest.raises(CalibrationError, match="Check that the anchors are in meters"):
            anchored(calibration, anchors)


@pytest.mark.parametrize(("seed", "wrong"), [(0, 0.0), (6, 0.0), (1, 3.0)])
def test_exact_anchors_give_deviations_or_one_clear_error(seed, wrong):
    calibration, rng = drawn(seed)
    anchors = []
    for camera in range(CAMERAS):
        factor = float(np.exp(wrong * rng.normal()))
        exact = {"sd": 1e-9, "pixel_sd": 1e-6}
        known = {"focal": 1100.0, "height": 4 * factor}
        place = tuple(true_cameras()[camera, X:].tolist())
        anchors += [
            dataclasses.replace(distance(camera, rng, factor), **exact),
            dataclasses.replace(point(camera, rng), **exact),
            cf.KnownCamera(
                camera, **known, focal_sd=1e-9, height_sd=1e-9, position=place, position_sd=1e-9
            ),
        ]
    chosen = rng.permutation(len(anchors))[: rng.integers(3, 8)]
    try:
        found = anchored(calibration, [anchors[at] for at in chosen])
    except CalibrationError:
        return
    assert (found.focal_sd > 0).all()
    least, *_, largest = np.linalg.eigvalsh(found.camera_covariance.reshape(7 * CAMERAS, -1))
    assert least >= -1e-9 * largest


@pytest.mark.parametrize("seed", [0, 1])
def test_the_fit_is_that_of_the_dense_problem(seed):
    calibration, rng = drawn(seed, size=0.3)
    camera = true_cameras()[3]
    _, R, _ = to_matrices(camera[None], SIZE[:1])
    anchors = [
        distance(0, rng),
        *(point(c, rng) for c in (0, 1, 2)),
        cf.KnownCamera(
            3,
            height=float(camera[Z]),
            focal=float(np.exp(camera[LOG_FOCAL])),
            position=tuple(camera[X:Z].tolist()),
            rotation=tuple(map(tuple, R[0].tolist())),
        ),
    ]
    found = anchored(calibration, anchors)
    assert not found.contradictions
    start, prior = parameters_of(calibration), calibration.camera_covariance
    root = np.linalg.inv(np.linalg.cholesky(prior.reshape(7 * CAMERAS, -1)))

    def placed(unknown):
        """Return cameras in the frame of the map."""
        cameras = start + unknown[:-4].reshape(CAMERAS, 7)
        turned = Rotation.from_euler("z", unknown[-3]).as_matrix()
        centers = np.exp(unknown[-4]) * cameras[:, X:] @ turned.T
        centers[:, :2] += unknown[-2:]
        K, R, _ = to_matrices(cameras, SIZE)
        return K, R @ turned.T, centers

    def ground(unknown, camera, pixel):
        K, R, centers = placed(unknown)
        ray = R[camera].T @ np.linalg.solve(K[camera], [*pixel, 1.0])
        return (centers[camera] - centers[camera, 2] / ray[2] * ray)[:2]

    def noise(at, measure, pixels, sd):
        """Return the covariance of a measurement, including that of its pixels."""
        flat = np.asarray(pixels, np.float64).ravel()
        slopes = np.stack([
            (measure(at, flat + d) - measure(at, flat - d)) / 2e-4 for d in 1e-4 * np.eye(len(flat))
        ], -1)  # fmt: skip
        return np.diag(np.full(len(slopes), sd**2)) + slopes @ slopes.T

    def log_length(unknown, pixels):
        ends = [ground(unknown, 0, pixel) for pixel in pixels.reshape(2, 2)]
        return np.log([np.linalg.norm(ends[0] - ends[1])])

    def place_of(camera):
        return lambda unknown, pixel: ground(unknown, camera, pixel)

    one, known, points = anchors[0], anchors[4], anchors[1:4]
    ends = np.asarray(one.pixels).ravel()

    def residuals(unknown, halves):
        K, R, centers = placed(unknown)
        angles = (
            from_matrices(np.eye(3)[None], matrix, np.zeros((1, 3)))[0, 1:4]
            for matrix in (R[3][None], np.array(known.rotation)[None])
        )
        rows = [
            root @ unknown[:-4],
            unknown[-4] / (CROWD / RULES.person_height),
            (log_length(unknown, ends) - np.log(one.meters)) / halves[0][0],
            np.log(centers[3, 2] / known.height) * known.height / known.height_sd,
            np.log(K[3, 0, 0] / known.focal) * known.focal / known.focal_sd,
            (centers[3, :2] - known.position) / known.position_sd,
            np.subtract(*angles) / np.deg2rad(known.rotation_sd),
        ]
        for p, half in zip(points, halves[1:], strict=True):
            off = ground(unknown, p.camera, p.pixel) - p.position
            rows.append(np.linalg.solve(half, off))
        return np.concatenate([np.ravel(row) for row in rows])

    at = np.zeros(7 * CAMERAS + 4)
    for _ in range(4):  # the deviations are those at the solution
        spread = [noise(at, log_length, ends, one.sd / one.meters)]
        spread += [noise(at, place_of(p.camera), p.pixel, p.sd) for p in points]
        halves = [np.linalg.cholesky(covariance) for covariance in spread]
        solved = least_squares(residuals, at, x_scale="jac", args=(halves,))
        at = solved.x
    K, _, centers = placed(at)
    np.testing.assert_allclose(np.asarray(found.scene.rig.centers), centers, atol=1e-4)
    np.testing.assert_allclose(np.asarray(found.scene.rig.K)[:, 0, 0], K[:, 0, 0], rtol=1e-5)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    assert found.crowd_height_sd / found.crowd_height == pytest.approx(
        np.sqrt(covariance[-4, -4]), rel=1e-2
    )
    assert found.crowd_height == pytest.approx(RULES.person_height * np.exp(at[-4]), rel=1e-5)


@pytest.mark.parametrize("place", [8.5, 180.0])
def test_places_on_earth_make_a_scene_that_knows_its_place(place):
    calibration, rng = drawn(3)
    earth = cf.GeoReference(place, 47.3, 30.0)
    points = [point(c, rng) for c in (0, 1, 2)]
    anchors = []
    for p in points:
        longitude, latitude = earth.to_longitude_latitude([p.position])[0].tolist()
        anchors.append(
            dataclasses.replace(p, position=None, longitude=longitude, latitude=latitude)
        )
    plain, found = anchored(calibration, points), anchored(calibration, anchors)
    assert plain.scene.georeference is None
    there = found.scene.georeference.to_longitude_latitude(found.scene.rig.centers[:, :2])
    off = earth.residual(plain.scene.rig.centers[:, :2], there)
    np.testing.assert_allclose(off, 0, atol=1e-4)


def test_cameras_may_be_named_and_unregistered_ones_are_told():
    calibration, rng = drawn(4)
    names = ["north", "east", "south", "west"]
    known = dataclasses.replace(distance(0, rng), camera="south")
    by_name = anchored(calibration, [known], camera_names=names)
    by_index = anchored(calibration, [dataclasses.replace(known, camera=2)])
    np.testing.assert_array_equal(parameters_of(by_name), parameters_of(by_index))
    rig = calibration.scene.rig
    lost = dataclasses.replace(rig, registered=np.array([True, True, False, True]))
    scene = dataclasses.replace(calibration.scene, rig=lost)
    found = anchored(dataclasses.replace(calibration, scene=scene), [known], camera_names=names)
    assert "camera 'south' was not used: the camera is not registered" in found.contradictions[0]
    points = [dataclasses.replace(point(0, rng), camera=c) for c in (2, 2)]
    with pytest.raises(CalibrationError, match="not registered"):
        anchored(dataclasses.replace(calibration, scene=scene), points)


def test_anchors_that_cannot_be_are_refused():
    calibration, rng = drawn(5)
    rig = calibration.scene.rig
    K = np.array(rig.K)
    K[0, 1, 2] += 400.0  # moves the horizon into the image
    scene = dataclasses.replace(calibration.scene, rig=dataclasses.replace(rig, K=K))
    sky = cf.KnownDistance(0, ((600.0, 2.0), (700.0, 2.0)), 3.0)
    with pytest.raises(InvalidInputError, match="horizon"):
        anchored(dataclasses.replace(calibration, scene=scene), [sky])
    with pytest.raises(InvalidInputError, match="camera 9"):
        anchored(calibration, [dataclasses.replace(sky, camera=9)])
    with pytest.raises(InvalidInputError, match="where it lies"):
        anchored(calibration, [point(0, rng)])
    mixed = [point(0, rng), cf.SurveyedPoint(1, (640.0, 400.0), longitude=8.0, latitude=47.0)]
    with pytest.raises(InvalidInputError, match="use one form for all"):
        anchored(calibration, mixed)
    far = [dataclasses.replace(point(c, rng), position=(5e5, 5e6 + c)) for c in (0, 1)]
    with pytest.raises(InvalidInputError, match="Subtract"):
        anchored(calibration, far)
    crossed = [point(c, rng, off=(30.0 * c, 0)) for c in (0, 1, 2)]
    with pytest.raises(CalibrationError, match="right-handed"):
        anchored(calibration, crossed)
    assert anchored(calibration, []) is calibration
