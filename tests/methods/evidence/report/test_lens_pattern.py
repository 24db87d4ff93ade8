"""Radial residuals against scipy's least squares, and for lenses that are known to be wrong."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

import catfree as cf
from catfree.methods.evidence._huber_regression import WIDTH
from catfree.methods.evidence.report._lens_pattern import UNKNOWN, lens_pattern, lens_warnings
from catfree.synthetic import make_world, shop


def drawn(seed: int, k1: tuple[float, ...], noise: float) -> tuple[np.ndarray, ...]:
    """Draw residuals with small pose errors, unmodeled distortion, and a few outliers."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-0.8, 0.8, (len(k1), 256, 2))
    linear, shift = rng.normal(0, 0.02, (len(k1), 2, 2)), rng.normal(0, 0.02, (len(k1), 1, 2))
    radial = np.array(k1)[:, None, None] * (offset**2).sum(-1, keepdims=True) * offset
    residual = shift + np.einsum("cij,cnj->cni", linear, offset) + radial
    residual += rng.normal(0, noise, offset.shape) * np.where(rng.random(offset.shape) < 0.05, 9, 1)
    return residual, offset, np.full(offset.shape, 1 / noise)


def test_the_pattern_minimizes_the_loss_of_huber():
    for camera, (residual, offset, precision) in enumerate(
        zip(*drawn(0, (-0.2, 0.1), 0.01), strict=True)
    ):
        precision[100:] *= camera

        def misfit(p, at=offset, residual=residual, precision=precision):
            model = p[:2] + at @ p[2:6].reshape(2, 2).T
            model += p[6] * (at**2).sum(-1, keepdims=True) * at
            return ((residual - model) * precision).ravel()

        strength, deviation = lens_pattern(residual, offset, precision)
        expected = least_squares(misfit, np.zeros(7), loss="huber", f_scale=WIDTH)
        assert strength == pytest.approx(expected.x[6], abs=2e-4)
        # An outlier counts less in the curvature of the loss than in its approximation.
        curvature = np.sqrt(np.linalg.inv(expected.jac.T @ expected.jac)[6, 6])
        assert deviation == pytest.approx(curvature, rel=0.1)


def test_the_deviation_holds_the_error():
    truth = (-0.3, 0.0, 0.05)
    errors = []
    for seed in range(20):
        for true, *camera in zip(truth, *drawn(seed, truth, 0.01), strict=True):
            strength, deviation = lens_pattern(*camera)
            errors.append((strength - true) / deviation)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.15, abs=0.3)


def test_without_residuals_nothing_is_known_of_a_lens():
    residual, offset, precision = (part[0] for part in drawn(0, (0.3,), 0.01))
    assert lens_pattern(residual, offset, 0 * precision) == (0, pytest.approx(UNKNOWN))


@pytest.mark.parametrize("k1", [5.0, -20.0])
def test_the_bend_of_a_long_lens_is_not_drawn_to_zero(k1):
    rng = np.random.default_rng(0)
    offset = rng.uniform(-0.1, 0.1, (400, 2))
    residual = k1 * (offset**2).sum(-1, keepdims=True) * offset + rng.normal(0, 1e-3, offset.shape)
    strength, deviation = lens_pattern(residual, offset, np.full(offset.shape, 1e3))
    assert abs(strength - k1) < 3 * deviation < 1.5


@pytest.mark.slow
def test_fisheyes_taken_for_pinholes_are_named_and_right_lenses_are_not():
    world = make_world(shop(1), 1, frames=40, background=0)
    right = cf.localize(world.detections, world.scene)
    assert not any("lens" in sentence for sentence in right.warnings)
    rig = dataclasses.replace(world.scene.rig, lens=None, distortion=None)
    taken = cf.Scene(rig, world.scene.ground, world.scene.extent)
    wrong = cf.localize(world.detections, taken)
    assert right.reliability.lens_bend < 0.5 * wrong.reliability.lens_bend
    assert wrong.reliability.expected_moda <= 50 < right.reliability.expected_moda
    (sentence,) = (s for s in wrong.warnings if "lens" in s)
    assert sentence.startswith("Cameras 0, 1, 2, 3 and the other cameras disagree")


def test_no_camera_is_named_without_a_reason():
    assert lens_warnings(np.zeros(3)) == ()
    bend = np.array([0.01, 0.0, 0.03])
    assert lens_warnings(bend)[0].startswith("Camera 2 and")
    assert lens_warnings(bend, ["a", "b", "c 1"])[0].startswith("Camera 'c 1' and")
