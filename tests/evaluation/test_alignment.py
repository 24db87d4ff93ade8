"""Alignment on camera centers and on people: recovery of a known transform, laws, refusals."""

import json
import math
import warnings

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree import evaluation
from catfree.errors import DegenerateGeometryError, InsufficientDataError, InvalidInputError
from catfree.geometry import Similarity

pytestmark = pytest.mark.usefixtures("x64")

CENTRES = np.array(
    [[0.0, 0.0, 3.0], [20.0, 1.0, 2.5], [19.0, 12.0, 2.8], [1.0, 14.0, 3.2], [9.0, -3.0, 2.2]]
)


def transform(angle, tilt, scale, shift):
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    lean = np.array(
        [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    )
    return Similarity(scale, turn @ lean, np.array([shift, -shift, 2 * shift]))


transforms = st.builds(
    transform, st.floats(-3, 3), st.floats(-3, 3), st.floats(0.1, 10), st.floats(-20, 20)
)


@pytest.mark.slow
@given(transforms)
def test_centres_of_a_moved_scene_are_aligned_exactly(world_from_scene):
    scene = np.asarray(world_from_scene.inverse()(CENTRES))
    aligned = evaluation.align_centres(scene, CENTRES)
    np.testing.assert_allclose(aligned(scene), CENTRES, atol=1e-8)
    assert float(aligned.scale) == pytest.approx(float(world_from_scene.scale), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=8)
@given(transforms)
def test_scores_do_not_depend_on_the_frame_of_the_scene(scene_from_world):
    random = np.random.default_rng(0)
    noisy = CENTRES + random.normal(0, 0.2, CENTRES.shape)
    positions = random.uniform(0, 10, (12, 3))

    def score(points):
        return float(np.linalg.norm(points - positions, axis=1).mean())

    expected = evaluation.leave_one_camera_out(noisy, CENTRES, positions, score)
    result = evaluation.leave_one_camera_out(
        np.asarray(scene_from_world(noisy)),
        CENTRES,
        np.asarray(scene_from_world(positions)),
        score,
    )
    np.testing.assert_allclose(result.values, expected.values, atol=1e-7)
    np.testing.assert_allclose(
        result.held_out_centre_error, expected.held_out_centre_error, atol=1e-7
    )
    assert result.value == pytest.approx(expected.value, abs=1e-7)


@pytest.mark.slow
def test_fixed_scale_is_rigid():
    aligned = evaluation.align_centres(2 * CENTRES, CENTRES, fixed_scale=True)
    assert float(aligned.scale) == 1.0


@pytest.mark.slow
def test_one_wrong_camera_is_found_by_leaving_it_out():
    estimated = CENTRES.copy()
    estimated[3] += [0.0, 0.0, 2.0]
    result = evaluation.leave_one_camera_out(
        estimated, CENTRES, CENTRES, lambda points: -np.abs(points - CENTRES).max()
    )
    assert result.cameras.tolist() == [0, 1, 2, 3, 4]
    # Without the wrong camera the alignment is exact, and that camera lands where it was moved.
    assert result.values[3] == pytest.approx(0.0, abs=1e-9)
    assert result.held_out_centre_error[3] == pytest.approx(2.0)
    assert result.values.argmax() == 3
    assert (result.min, result.mean) == (result.values.min(), result.values.mean())
    assert result.std == pytest.approx(np.std(result.values, ddof=1))
    assert str(result).startswith("all cameras -")


@pytest.mark.slow
def test_moda_as_the_score():
    rows = np.array([[0, 1, 4.0, 5.0], [0, 2, 8.0, 6.0], [1, 1, 4.5, 5.0]])
    world = np.column_stack([rows[:, 2:], np.zeros(3)])

    def moda(points):
        predicted = np.column_stack([rows[:, :2], points[:, :2]])
        return evaluation.detection_metrics(rows, predicted).moda

    result = evaluation.leave_one_camera_out(CENTRES / 7, CENTRES, world / 7, moda)
    assert (result.value, result.mean, result.min, result.std) == (100, 100, 100, 0)


@pytest.mark.slow
def test_unregistered_cameras_may_be_nan():
    estimated = CENTRES.copy()
    estimated[1] = np.nan
    registered = np.array([True, False, True, True, True])
    aligned = evaluation.align_centres(estimated, CENTRES, registered=registered)
    np.testing.assert_allclose(aligned(CENTRES), CENTRES, atol=1e-9)
    result = evaluation.leave_one_camera_out(
        estimated,
        CENTRES,
        np.zeros((0, 3)),
        lambda points: float(len(points)),
        registered=registered,
    )
    assert result.cameras.tolist() == [0, 2, 3, 4]
    with pytest.raises(InvalidInputError, match="center of camera 1 is not finite"):
        evaluation.align_centres(estimated, CENTRES)


@pytest.mark.slow
def test_too_few_or_collinear_cameras_are_refused():
    with pytest.raises(InsufficientDataError, match="2 cameras, 3 needed"):
        evaluation.align_centres(CENTRES[:2], CENTRES[:2])
    with pytest.raises(InsufficientDataError, match="3 cameras, 4 needed"):
        evaluation.leave_one_camera_out(CENTRES[:3], CENTRES[:3], CENTRES, lambda _: 0.0)
    line = np.arange(4.0)[:, None] * np.array([1.0, 2.0, 0.5])
    with pytest.raises(DegenerateGeometryError, match="line"):
        evaluation.align_centres(line, line)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: evaluation.align_centres(CENTRES, CENTRES[:4]), r"two \(C, 3\) arrays"),
        (lambda: evaluation.align_centres(CENTRES[:, :2], CENTRES[:, :2]), r"two \(C, 3\) arrays"),
        (lambda: evaluation.align_centres(CENTRES, CENTRES, registered=[True]), "registered must"),
        (
            lambda: evaluation.leave_one_camera_out(CENTRES, CENTRES, [1.0], lambda _: 0.0),
            r"positions must have shape \(M, 3\)",
        ),
    ],
)
def test_bad_shapes_are_refused(call, message):
    with pytest.raises(InvalidInputError, match=message):
        call()


@pytest.mark.slow
@given(st.floats(-0.03, 0.03), st.floats(0.98, 1.02), st.floats(-0.1, 0.1))
def test_a_small_similarity_between_people_is_undone(angle, scale, shift):
    random = np.random.default_rng(4)
    truth = np.column_stack([np.arange(40), np.zeros(40), random.uniform(-5, 5, (40, 2))])
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    predicted = truth.copy()
    predicted[:, 2:] = truth[:, 2:] @ turn.T + shift
    result = evaluation.align_positions(truth, predicted)
    np.testing.assert_allclose(result.rows, truth, atol=1e-8)
    assert result.matched == 40
    assert result.rms_after < 1e-8
    assert result.rms_before == pytest.approx(
        np.sqrt(((predicted - truth) ** 2).sum(axis=1).mean())
    )
    assert str(result).startswith(f"RMS {result.rms_before:.3f} m before, 0.000 m after")


@pytest.mark.slow
def test_without_double_precision_it_is_accurate_to_a_millimetre():
    with jax.enable_x64(False):
        scene = np.asarray(transform(0.4, 0.3, 0.2, 5.0)(CENTRES), dtype=np.float64)
        result = evaluation.leave_one_camera_out(
            scene, CENTRES, scene, lambda points: float(np.abs(points - CENTRES).max())
        )
        assert result.values.max() < 1e-3
        assert result.held_out_centre_error.max() < 1e-3


@given(st.booleans(), st.floats(-0.1, 0.1))
def test_a_similarity_between_people_moves_other_points_without_a_warning(wide, shift):
    rows = np.array([[0, 1, 0, 0], [0, 2, 3, 4], [1, 1, 5, 0]], float)
    with jax.enable_x64(wide), warnings.catch_warnings(action="error"):
        similarity = evaluation.align_positions(rows, rows + np.array([0, 0, shift, 0])).similarity
        moved = similarity.inverse()(similarity(rows[:, 2:]))
    np.testing.assert_allclose(moved, rows[:, 2:], atol=1e-5)


def test_positions_without_partners_are_refused():
    with pytest.raises(InsufficientDataError, match=r"1 predictions within 1\.0 m"):
        evaluation.align_positions([[0, 1, 0, 0]], [[0, 1, 0.1, 0], [0, 2, 9, 9]])


@pytest.mark.slow
def test_reference_similarities(shared):
    compared = 0
    for case in json.loads((shared / "vectors" / "umeyama.json").read_text())["cases"]:
        source, target = np.array(case["src"]), np.array(case["dst"])
        if source.shape[1] != 3:
            continue
        compared += 1
        if not case["expected_unique"]:
            with pytest.raises((DegenerateGeometryError, InsufficientDataError)):
                evaluation.align_centres(source, target)
            continue
        for kind in ("sim", "rigid"):
            expected = case["expected"][kind]
            aligned = evaluation.align_centres(source, target, fixed_scale=kind == "rigid")
            label = f"{case['name']} {kind}"
            np.testing.assert_allclose(
                aligned.rotation, expected["rotation"], atol=1e-6, err_msg=label
            )
            assert float(aligned.scale) == pytest.approx(expected["scale"], rel=1e-6), label
            np.testing.assert_allclose(
                aligned.translation, expected["translation"], rtol=1e-6, atol=1e-6, err_msg=label
            )
    assert compared >= 15


@pytest.mark.slow
@pytest.mark.parametrize("wide", [False, True])
def test_scores_on_a_map_keep_their_digits(wide):
    """With UTM eastings and northings, single precision resolves 0.25 to 0.5 m there."""
    corner = np.array([512_345.0, 5_412_345.0, 400.0])
    noisy = CENTRES + np.random.default_rng(1).normal(0, 0.05, CENTRES.shape)
    people = np.random.default_rng(2).uniform(0, 10, (20, 3))
    rows = np.column_stack([np.arange(20), np.zeros(20), people[:, :2] + corner[:2]])

    def spread(points):
        return float(np.linalg.norm(points - points[0], axis=1).sum())

    with jax.enable_x64(wide):
        expected = evaluation.leave_one_camera_out(noisy, CENTRES, people, spread)
        result = evaluation.leave_one_camera_out(
            noisy + corner, CENTRES + corner, people + corner, spread
        )
        aligned = evaluation.align_positions(rows, rows)
    np.testing.assert_allclose(result.values, expected.values, rtol=1e-6)
    np.testing.assert_allclose(
        result.held_out_centre_error, expected.held_out_centre_error, atol=1e-6
    )
    np.testing.assert_allclose(aligned.rows, rows, atol=1e-6)
