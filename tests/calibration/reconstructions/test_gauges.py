"""Gauges: alignment is exact, and medians ignore absent values and garbage."""

import numpy as np
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from catfree.calibration.reconstructions._gauges import (
    Gauges,
    Poses,
    agreeing,
    align,
    average_poses,
    central_instant,
    median_of_present,
    usual_scale,
)
from catfree.synthetic import make_layout

seeds = st.integers(0, 2**31 - 1)


def random_gauges(rng: np.random.Generator, count: int) -> Gauges:
    rotation = Rotation.random(count, random_state=rng).as_matrix()
    return Gauges(np.exp(rng.uniform(-2, 2, count)), rotation, rng.normal(0, 5, (count, 3)))


def inverse(gauges: Gauges) -> Gauges:
    back = np.swapaxes(gauges.rotation, -1, -2)
    scale = 1 / gauges.scale
    translation = -scale[:, None] * np.einsum("nij,nj->ni", back, gauges.translation)
    return Gauges(scale, back, translation)


def ring(count: int) -> tuple[Poses, Poses]:
    """Return the cameras of a layout, once and for each of several instants."""
    rig = make_layout("ring5", 0).rig
    R, center = np.asarray(rig.R, np.float64), np.asarray(rig.centers, np.float64)
    one = Poses(R, center, np.ones(5, bool))
    many = Poses(np.stack([R] * count), np.stack([center] * count), np.ones((count, 5), bool))
    return one, many


@given(seed=seeds)
@settings(max_examples=10)
def test_alignment_undoes_any_similarity(seed):
    one, many = ring(4)
    gauges = random_gauges(np.random.default_rng(seed), 4)
    moved = inverse(gauges).poses(many)
    found = align(moved, one)
    np.testing.assert_allclose(found.scale, gauges.scale, rtol=1e-6)
    np.testing.assert_allclose(found.poses(moved).center, many.center, atol=1e-5)
    np.testing.assert_allclose(found.poses(moved).R, many.R, atol=1e-6)


def test_an_instant_that_shares_no_camera_has_no_gauge():
    one, many = ring(2)
    many.known[1] = False
    found = align(many, one)
    assert np.isfinite(found.scale).tolist() == [True, False]
    assert not found.poses(many).known[1].any()


def test_garbage_is_neither_central_nor_agreeing():
    rng = np.random.default_rng(0)
    one, many = ring(6)
    for bad in (0, 3):
        many.center[bad] = rng.normal(0, 5, (5, 3))
        many.R[bad] = Rotation.random(5, random_state=rng).as_matrix()
    central = central_instant(many)
    np.testing.assert_array_equal(central.center, one.center)
    aligned = align(many, central).poses(many)
    near = agreeing(aligned, average_poses(aligned, aligned.known))
    assert near.tolist() == [False, True, True, False, True, True]


def test_the_usual_scale_is_kept():
    gauges = random_gauges(np.random.default_rng(1), 5)
    inliers = np.array([True, True, True, False, False])
    found = usual_scale(gauges, inliers)
    np.testing.assert_allclose(np.median(np.log(found.scale[inliers])), 0, atol=1e-12)
    np.testing.assert_allclose(
        found.translation / gauges.translation, (found.scale / gauges.scale)[:, None] * np.ones(3)
    )


def test_medians_of_what_is_present():
    values = np.array([[1.0, 5, 100], [np.nan, 2, 3], [7, 8, 9]])
    present = np.array([[True, True, False], [False, True, False], [False] * 3])
    np.testing.assert_array_equal(median_of_present(values, present), [3, 2, np.nan])
