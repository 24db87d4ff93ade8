"""Rigs from any rays: a panorama, a fisheye, and refused input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.adapters import RaySource
from catfree.errors import InvalidInputError
from catfree.geometry.camera import pixels_of_points, rays_of_pixels

SIZE = (2000, 1000)


def panorama(camera: int, pixels: np.ndarray) -> np.ndarray:
    """Return rays of an equirectangular picture: columns are longitudes, rows are latitudes."""
    longitude = ((pixels[:, 0] + 0.5) / SIZE[0] - 0.5) * 2 * np.pi
    latitude = ((pixels[:, 1] + 0.5) / SIZE[1] - 0.5) * np.pi
    level = np.cos(latitude)
    return np.stack([level * np.sin(longitude), np.sin(latitude), level * np.cos(longitude)], -1)


def poses(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return Rotation.random(count, rng).as_matrix(), rng.normal(size=(count, 3))


@pytest.mark.slow
def test_a_panorama_sees_in_all_directions():
    assert isinstance(panorama, RaySource)
    R, t = poses(3)
    rig = cf.rig_from_rays(panorama, R, t, SIZE)
    np.testing.assert_allclose(rig.K[:, 0, 0], SIZE[0] / (2 * np.pi), rtol=1e-6)
    rng = np.random.default_rng(1)
    pixels = rng.uniform([50, 60], [1950, 940], (200, 2))
    camera = rng.integers(0, 3, 200)
    expected = np.einsum("nji,nj->ni", R[camera], panorama(0, pixels))
    rays = rays_of_pixels(rig, camera, pixels)
    np.testing.assert_allclose(rays, expected, atol=1e-4)
    again, imaged = pixels_of_points(rig, camera, rig.centers[camera] + 4 * expected)
    assert imaged.all()
    np.testing.assert_allclose(again, pixels, atol=0.1)


def test_wrong_sources_are_refused():
    R, t = poses(2)
    with pytest.raises(InvalidInputError, match="pixels of camera 0; it must be"):
        cf.rig_from_rays(lambda camera, pixels: pixels, R, t, SIZE)
    with pytest.raises(InvalidInputError, match=r"rays\[0\] holds a ray that is not"):
        cf.rig_from_rays(lambda camera, pixels: 2 * panorama(camera, pixels), R, t, SIZE)
    for fixed in ([0.0, 0.0, 1.0], [np.nan] * 3):
        with pytest.raises(InvalidInputError, match="The rays of camera 0 are not finite, or all"):
            cf.rig_from_rays(lambda camera, pixels, ray=fixed: [ray] * len(pixels), R, t, SIZE)
    with pytest.raises(InvalidInputError, match="got lists of different lengths"):
        cf.rig_from_rays(lambda camera, pixels: [[1, 0, 0], [1]], R, t, SIZE)
    with pytest.raises(InvalidInputError, match="R has no rotations"):
        cf.rig_from_rays(panorama, R[:0], t[:0], SIZE)
    with pytest.raises(InvalidInputError, match="image_size must hold positive numbers"):
        cf.rig_from_rays(panorama, R, t, (0, 0))


@pytest.mark.slow
def test_rays_that_jump_are_refused():
    R, t = poses(2)

    def halves(camera: int, pixels: np.ndarray) -> np.ndarray:
        """Turn every pixel row of camera 1 to the other side."""
        rays = panorama(camera, pixels)
        return np.where(camera * (pixels[:, 1:] // 3 % 2) > 0, -rays, rays)

    with pytest.raises(InvalidInputError, match="camera 1 differ from those between the nodes"):
        cf.rig_from_rays(halves, R, t, SIZE)
