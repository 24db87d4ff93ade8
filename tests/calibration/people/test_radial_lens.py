"""Boxes with lens distortion removed."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people._radial_lens import RadialLenses, radial_distortion
from catfree.types import Rig

FOCAL = np.array([900.0, 1200.0])


def ideal(point, focal, k1):
    """Undistort a point with the real roots of r + k1 r^3."""
    radius = np.linalg.norm(point) / focal
    roots = np.roots([k1, 0, 1, -radius]) if k1 else np.array([radius])
    real = roots.real[np.abs(roots.imag) < 1e-9]
    return point / radius * real[real > 0].min()


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.sampled_from([-0.3, -0.1, 0.0, 0.2]))
def test_straightened_boxes_solve_the_lens_equation(seed, k1):
    rng = np.random.default_rng(seed)
    camera = rng.integers(2, size=20)
    edges = rng.uniform(-400, 400, (20, 3))
    lenses = RadialLenses(FOCAL, np.array([k1, 0.1]))
    found = lenses.straightened(camera, edges)
    for row, c, (u, top, bottom) in zip(found, camera, edges, strict=True):
        head, foot = (ideal(np.array([u, v]), FOCAL[c], lenses.k1[c]) for v in (top, bottom))
        np.testing.assert_allclose(row, [(head[0] + foot[0]) / 2, head[1], foot[1]], atol=1e-6)


def test_ideal_lenses_change_nothing():
    edges = np.arange(6.0).reshape(2, 3)
    assert RadialLenses(FOCAL, np.zeros(2)).straightened(np.array([0, 1]), edges) is edges


def test_a_camera_that_is_not_registered_gets_the_usual_lens():
    K = np.tile(np.array([[800.0, 0, 500], [0, 800, 300], [0, 0, 1]]), (3, 1, 1))
    K[1] = np.nan
    distortion = np.zeros((3, 5))
    distortion[[0, 2], 0] = -0.2
    rig = Rig(
        K, np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)), (1000, 600), distortion,
        np.array([True, False, True]),
    )  # fmt: skip
    lenses = RadialLenses.of(rig)
    np.testing.assert_allclose(lenses.focal, 800)
    np.testing.assert_allclose(lenses.k1, -0.2)
    np.testing.assert_allclose(radial_distortion(rig), [-0.2, 0, -0.2])
    assert radial_distortion(rig) == pytest.approx(np.asarray(rig.distortion)[:, 0])
