"""Averaging cameras of several instants: exactness, invariance, robustness to garbage."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from catfree.calibration.reconstructions._aggregate import aggregate
from catfree.calibration.reconstructions._robust_mean import (
    angle,
    geometric_median,
    median_rotation,
)
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry import fit_similarity
from catfree.synthetic import make_layout
from catfree.types import Rig
from catfree.types.results._reconstruction import Reconstruction
from tests.noisy_reconstruction import reconstruct

seeds = st.integers(0, 2**31 - 1)


def garbage(rig: Rig, rng: np.random.Generator) -> Reconstruction:
    """Draw cameras with any pose."""
    cameras = rig.camera_count
    K = np.array(rig.K)
    K[:, [0, 1], [0, 1]] *= np.exp(rng.normal(0, 0.5, cameras))[:, None]
    R = Rotation.random(cameras, random_state=rng).as_matrix()
    return Reconstruction(
        K, R, rng.normal(0, 5, (cameras, 3)), rng.normal(0, 5, (9, 3)), np.ones(9)
    )


def errors(found: Rig, true: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angles in radians, center errors in the true rig's units and relative focal errors."""
    centers = np.asarray(found.centers, np.float64)
    similarity = fit_similarity(centers, np.asarray(true.centers))
    moved = np.asarray(similarity(centers))
    turned = np.asarray(found.R) @ np.asarray(similarity.rotation, np.float64).T
    focal = np.asarray(found.K)[:, 0, 0] / np.asarray(true.K)[:, 0, 0] - 1
    return (
        angle(turned, np.asarray(true.R)),
        np.linalg.norm(moved - np.asarray(true.centers), axis=-1),
        np.abs(focal),
    )


@pytest.mark.slow
@given(seed=seeds, count=st.integers(1, 8), cameras=st.integers(3, 6))
@settings(max_examples=15)
def test_exact_reconstructions_give_the_rig_whatever_their_frames(seed, count, cameras, x64):
    rig, rng = make_layout(f"ring{cameras}", seed % 7).rig, np.random.default_rng(seed)
    found = aggregate([reconstruct(rig, rng) for _ in range(count)], rig.image_size)
    turned, away, focal = errors(found.rig, rig)
    assert turned.max() < 1e-7
    assert away.max() < 1e-6
    assert focal.max() < 1e-9
    assert found.inliers.all()
    assert (found.spread.instants == count).all()


@pytest.mark.slow
@given(seed=seeds, bad=st.integers(0, 3))
@settings(max_examples=15)
def test_three_garbage_instants_in_ten_hardly_matter(seed, bad, x64):
    rig, rng = make_layout("ring6", seed % 7).rig, np.random.default_rng(seed)
    instants = [
        reconstruct(rig, rng, rotation=0.005, center=0.1, focal=0.02) for _ in range(10 - bad)
    ]
    instants[1:1] = [garbage(rig, rng) for _ in range(bad)]
    found = aggregate(instants, rig.image_size)
    assert not found.inliers[1 : 1 + bad].any()
    assert found.inliers.sum() >= 6
    good = [instant for i, instant in enumerate(instants) if not 1 <= i < 1 + bad]
    alone = [errors(Rig(one.K, one.R, one.t, rig.image_size), rig) for one in good]
    # The mean of seven would be off by 0.38 of one, and the median of normal errors by 0.48.
    for together, single in zip(errors(found.rig, rig), zip(*alone, strict=True), strict=True):
        assert together.mean() < 0.7 * np.mean(single)


@pytest.mark.slow
def test_one_bad_camera_in_some_instants_costs_nothing_but_those(x64):
    rig, rng = make_layout("ring5", 1).rig, np.random.default_rng(1)
    instants = []
    for i in range(9):
        exact = reconstruct(rig, rng)
        t = exact.t.copy()
        t[i % 5] += rng.normal(0, np.abs(t).max(), 3) if i < 4 else 0.0
        instants.append(Reconstruction(exact.K, exact.R, t, exact.points, exact.confidence))
    _, away, _ = errors(aggregate(instants, rig.image_size).rig, rig)
    assert away.max() < 1e-3


@pytest.mark.slow
def test_spread_says_how_much_the_instants_disagree(x64):
    rig, rng = make_layout("ring6", 0).rig, np.random.default_rng(0)
    many = [reconstruct(rig, rng, rotation=0.01, focal=0.03) for _ in range(60)]
    spread = aggregate(many, rig.image_size).spread
    # The length of a 3-D normal vector has its median at 1.538 standard deviations.
    np.testing.assert_allclose(spread.rotation, 1.4826 * 1.538 * 0.01, rtol=0.35)
    np.testing.assert_allclose(spread.log_focal, 0.03, rtol=0.4)


@pytest.mark.slow
def test_points_of_inlier_instants_meet_in_the_common_frame(x64):
    rig, rng = make_layout("ring4", 0).rig, np.random.default_rng(2)
    points = rng.normal(0, 3, (50, 3))
    instants = [reconstruct(rig, rng, points=points) for _ in range(4)] + [garbage(rig, rng)]
    found = aggregate(instants, rig.image_size)
    clouds = found.points.reshape(4, 50, 3)
    size = np.linalg.norm(np.asarray(found.rig.centers), axis=-1).max()
    np.testing.assert_allclose(clouds - clouds[:1], 0, atol=1e-6 * size)
    back = fit_similarity(np.asarray(found.rig.centers), np.asarray(rig.centers))
    np.testing.assert_allclose(np.asarray(back(clouds[0])), points, atol=1e-5)
    np.testing.assert_array_equal(found.confidence, 1)


def test_scale_is_the_usual_one_of_the_instants(x64):
    rig, rng = make_layout("ring4", 0).rig, np.random.default_rng(3)
    exact = reconstruct(rig, rng, scale_is_metric=True)
    scaled = [
        Reconstruction(
            exact.K, exact.R, factor * exact.t, exact.points, exact.confidence, scale_is_metric=True
        )
        for factor in (0.9, 1.0, 1.25)
    ]
    found = aggregate(scaled, rig.image_size)
    centers, expected = np.asarray(found.rig.centers), -np.einsum("cji,cj->ci", exact.R, exact.t)
    spread, wanted = np.ptp(centers, axis=0), np.ptp(expected, axis=0)
    assert found.metric
    assert np.linalg.norm(spread) == pytest.approx(np.linalg.norm(wanted), rel=0.3)


def test_a_camera_that_is_never_registered_is_absent(x64):
    rig, rng = make_layout("ring4", 0).rig, np.random.default_rng(4)
    registered = np.array([True, True, False, True])
    instants = [reconstruct(rig, rng, registered=registered) for _ in range(3)]
    found = aggregate(instants, rig.image_size)
    np.testing.assert_array_equal(found.rig.registered, registered)
    assert np.isnan(np.asarray(found.rig.t)[2]).all()
    assert found.spread.instants.tolist() == [3, 3, 0, 3]


@pytest.mark.slow
def test_cameras_registered_in_different_instants_are_joined(x64):
    rig, rng = make_layout("ring5", 0).rig, np.random.default_rng(5)
    seen = ~np.eye(5, dtype=bool)
    found = aggregate([reconstruct(rig, rng, registered=row) for row in seen], rig.image_size)
    turned, away, _ = errors(found.rig, rig)
    assert turned.max() < 1e-6
    assert away.max() < 1e-5


def test_what_cannot_be_aggregated_is_refused():
    rig, rng = make_layout("ring4", 0).rig, np.random.default_rng(6)
    one = reconstruct(rig, rng)
    with pytest.raises(InsufficientDataError, match="at least one"):
        aggregate([], rig.image_size)
    other = Reconstruction(one.K[:3], one.R[:3], one.t[:3], one.points, one.confidence)
    with pytest.raises(InvalidInputError, match="Reconstruction 1 has 3 cameras"):
        aggregate([one, other], rig.image_size)
    with pytest.raises(InsufficientDataError, match="two cameras"):
        aggregate([reconstruct(rig, rng, registered=np.eye(4, dtype=bool)[0])], rig.image_size)


@given(seed=seeds, count=st.integers(1, 4))
@settings(max_examples=8)
def test_cameras_that_share_one_center_are_refused(seed, count):
    rig, rng = make_layout("ring4", 0).rig, np.random.default_rng(seed)
    center = np.zeros((4, 3)) if seed % 2 else np.tile(rng.normal(size=3), (4, 1))
    instants = []
    for _ in range(count):
        one = reconstruct(rig, rng)
        t = -np.einsum("cij,cj->ci", one.R, center)
        instants.append(Reconstruction(one.K, one.R, t, one.points, one.confidence))
    with pytest.raises(InsufficientDataError, match="two cameras at different places"):
        aggregate(instants, rig.image_size)


@given(seed=seeds, count=st.integers(3, 12))
@settings(max_examples=15)
def test_medians_minimise_the_sum_of_distances(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.standard_cauchy((count, 3))
    found = geometric_median(points, np.ones(count, bool))

    def cost(x: np.ndarray) -> float:
        return float(np.linalg.norm(points - x, axis=-1).sum())

    best = min(
        minimize(cost, start, method="Nelder-Mead").fun for start in (points.mean(0), points[0])
    )
    assert cost(found) <= best * (1 + 1e-3)


@given(seed=seeds, count=st.integers(3, 9))
@settings(max_examples=15)
def test_rotation_medians_minimise_the_sum_of_angles(seed, count):
    rng = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(0.3 * rng.standard_normal((count, 3))).as_matrix()
    found = median_rotation(rotations, np.ones(count, bool))

    def cost(vector: np.ndarray) -> float:
        return float(angle(rotations, Rotation.from_rotvec(vector).as_matrix() @ found).sum())

    best = minimize(cost, np.full(3, 1e-3), method="Nelder-Mead").fun
    assert cost(np.zeros(3)) <= best * (1 + 1e-3)


def test_absent_values_never_count():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan] * 3, [0.2, 0, 0]])
    present = np.array([True, True, False, True])
    np.testing.assert_allclose(geometric_median(points, present), [0.2, 0, 0], atol=1e-6)
    assert np.isnan(geometric_median(points, np.zeros(4, bool))).all()
