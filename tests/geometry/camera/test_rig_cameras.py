"""Rays and pixels of a rig that mixes lenses: each camera's own model, and inverse."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError
from catfree.geometry import camera
from catfree.types import Rig
from tests.types.camera_parameters import parameters

SIZE = np.array([640, 480])
PINHOLE = np.array([-0.2, 0.05, 0.001, -0.001, 0, 0.1, 0, 0])
FISHEYE = np.array([0.02, -0.005, 0.001, 0, 0, 0, 0, 0])


def mixed() -> Rig:
    """Make three cameras: a distorted pinhole, a fisheye, and the fisheye as rays."""
    given = parameters()
    u, v = np.meshgrid(np.linspace(-0.5, 639.5, 33), np.linspace(-0.5, 479.5, 33))
    pixels = np.stack([u, v], -1).reshape(-1, 2)
    fisheye = Rig(
        **given,
        distortion=np.stack([PINHOLE, FISHEYE, FISHEYE * 0]),
        lens=["pinhole", "fisheye", "pinhole"],
    )
    world = camera.rays_of_pixels(fisheye, 1, pixels)
    rays = np.zeros((3, 33, 33, 3))
    rays[2] = (world @ fisheye.R[1].T).reshape(33, 33, 3)
    return replace(fisheye, lens=["pinhole", "fisheye", "rays"], rays=rays)


RIG = mixed()
pixels = st.tuples(st.floats(20, 620), st.floats(20, 460)).map(np.array)


@pytest.mark.slow
@given(pixels, st.floats(0.1, 20))
def test_points_on_the_rays_have_their_pixels(pixel, distance):
    cameras = np.array([2, 0, 1])
    given = np.tile(pixel, (3, 1))
    rays = camera.rays_of_pixels(RIG, cameras, given)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-12)
    points = RIG.centers[cameras] + distance * rays
    again, imaged = camera.pixels_of_points(RIG, cameras, points)
    assert imaged.all()
    np.testing.assert_allclose(again, given, atol=1e-6)
    for at, one in enumerate(cameras):
        alone, _ = camera.pixels_of_points(RIG, int(one), points[at : at + 1])
        np.testing.assert_allclose(alone[0], again[at], atol=1e-9)


@pytest.mark.slow
@given(pixels)
def test_a_fisheye_and_its_rays_agree(pixel):
    rays = camera.rays_of_pixels(RIG, np.array([1, 2]), np.tile(pixel, (2, 1)))
    local = np.einsum("cij,cj->ci", RIG.R[1:], rays)
    np.testing.assert_allclose(local[0], local[1], atol=2e-5)


def test_nothing_is_asked_of_no_camera():
    assert camera.rays_of_pixels(RIG, np.zeros(0, int), np.zeros((0, 2))).shape == (0, 3)
    pixel, imaged = camera.pixels_of_points(RIG, 0, np.zeros((0, 3)))
    assert pixel.shape == (0, 2)
    assert imaged.shape == (0,)


def test_a_camera_that_a_rig_does_not_have_is_named():
    rig = Rig(np.eye(3)[None], np.eye(3)[None], np.zeros((1, 3)), (9, 9))
    for ask, place in ((camera.rays_of_pixels, 2), (camera.pixels_of_points, 3)):
        for number, message in (
            (1, r"camera\[0\] is 1, but the rig has 1 cameras"),
            (-1, r"camera\[0\] is -1"),
            (np.zeros(2, np.int64), "camera must have shape"),
        ):
            with pytest.raises(InvalidInputError, match=message):
                inspect.unwrap(ask)(rig, number, np.ones((3, place)))
