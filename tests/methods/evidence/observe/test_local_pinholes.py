"""Pinholes that agree with a lens around a pixel: value, derivative, and the case of a pinhole."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.geometry.camera import rays_of_pixels
from catfree.methods.evidence.observe._local_pinholes import local_pinholes, project_rays
from tests.methods.evidence.evidence_worlds import make_rig

FISHEYE = np.array([0.05, -0.01, 0.002, -0.0005, 0])
CAMERA = np.zeros(1, int)


def fisheye_rig():
    rig = make_rig(count=2, roll=0.3)
    K = np.array(rig.K)
    K[:, :2, :2] *= 0.4  # wide: the corners are beyond 90 degrees
    return replace(rig, K=K, distortion=np.tile(FISHEYE, (2, 1)), lens=["fisheye"] * 2)


RIG = fisheye_rig()
WIDTH, HEIGHT = RIG.image_size[0]
pixels = st.tuples(st.floats(0, WIDTH - 1), st.floats(0, HEIGHT - 1)).map(np.array)


@pytest.mark.slow
@given(pixels, st.floats(0, 2 * np.pi))
def test_near_the_pixel_the_pinhole_is_the_lens(pixel, around):
    K, R, usable = local_pinholes(RIG, CAMERA, pixel[None])
    assert usable.all()
    np.testing.assert_allclose(R[0] @ R[0].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R[0]) > 0
    assert K[0, 1, 0] == 0
    assert K[0, 0, 0] > 0
    assert K[0, 1, 1] > 0
    step = np.array([np.cos(around), np.sin(around)])
    for length, tolerance in ((0, 1e-9), (1, 0.02), (10, 1.0)):
        there = pixel + length * step
        found, in_front = project_rays(K, R, rays_of_pixels(RIG, CAMERA, there[None]))
        assert in_front.all()
        np.testing.assert_allclose(found[0], there, atol=tolerance)


def test_at_the_principal_point_a_pinhole_is_its_own():
    rig = make_rig(roll=0.2)
    K, R, usable = local_pinholes(rig, np.arange(5), np.asarray(rig.K)[:, :2, 2])
    assert usable.all()
    np.testing.assert_allclose(K, rig.K, atol=1e-3)
    np.testing.assert_allclose(R, rig.R, atol=1e-9)


@pytest.mark.parametrize("row", [0.0, -0.5])
def test_at_a_pole_it_is_finite(row):
    rig = make_rig(count=2)
    rays = np.zeros((2, 9, 9, 3))
    latitude, longitude = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-2, 2, 9), indexing="ij")
    level = np.cos(latitude * np.pi / 2)
    rays[:] = np.stack(
        [level * np.sin(longitude), np.sin(latitude * np.pi / 2), level * np.cos(longitude)], -1
    )
    rays[:, 0] = rays[:, 0, :1]
    rig = replace(rig, lens=["rays"] * 2, rays=rays)
    K, R, _ = local_pinholes(rig, CAMERA, np.array([[WIDTH / 2, row]]))
    assert np.isfinite(K).all()
    assert np.isfinite(R).all()
