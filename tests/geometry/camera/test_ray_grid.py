"""Grids of rays: comparison with the sampled lenses, inverse, derivatives, degenerate input."""

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.geometry import camera

SIZE = np.array([2000, 1000])

grid_ray = jax.jit(camera.grid_ray)
grid_pixel = jax.jit(camera.grid_pixel)
pixel_jacobian = jax.jit(jax.jacrev(lambda *of: camera.grid_pixel(*of)[0], 2))
ray_jacobian = jax.jit(jax.jacrev(camera.grid_ray, 2))
pinhole_rays = jax.jit(jax.vmap(jax.vmap(camera.pinhole_ray, (None, 0, None)), (None, 0, None)))
pinhole_pixel = jax.jit(camera.pinhole_pixel)


def panorama(pixel: np.ndarray) -> np.ndarray:
    """Return rays of an equirectangular picture: columns are longitudes, rows are latitudes."""
    longitude = ((pixel[..., 0] + 0.5) / SIZE[0] - 0.5) * 2 * np.pi
    latitude = ((pixel[..., 1] + 0.5) / SIZE[1] - 0.5) * np.pi
    level = np.cos(latitude)
    return np.stack(
        [level * np.sin(longitude), np.sin(latitude), level * np.cos(longitude)], axis=-1
    )


def nodes(columns: int, rows: int) -> np.ndarray:
    return np.stack(
        np.meshgrid(
            np.linspace(-0.5, SIZE[0] - 0.5, columns), np.linspace(-0.5, SIZE[1] - 0.5, rows)
        ),
        axis=-1,
    )


GRID = panorama(nodes(65, 49))

# Away from the seam, where two pixels share a ray, and the poles, where a row shares one.
pixels = st.tuples(st.floats(40, 1960), st.floats(60, 940)).map(np.array)


@given(pixels)
def test_rays_between_the_nodes_are_those_of_the_lens(x64, pixel):
    ray = np.asarray(grid_ray(GRID, SIZE, pixel))
    np.testing.assert_allclose(np.linalg.norm(ray), 1, atol=1e-12)
    np.testing.assert_allclose(ray, panorama(pixel), atol=1e-4)


def test_at_the_nodes_rays_are_exact(x64):
    place = nodes(65, 49)[5:40:7, 3:60:9].reshape(-1, 2)
    found = jax.vmap(grid_ray, (None, None, 0))(GRID, SIZE, place)
    np.testing.assert_allclose(found, panorama(place), atol=1e-12)


@pytest.mark.slow
@given(pixels, st.floats(0.1, 50))
def test_a_point_of_the_ray_has_its_pixel(x64, pixel, distance):
    again, imaged = grid_pixel(GRID, SIZE, distance * grid_ray(GRID, SIZE, pixel))
    assert imaged
    np.testing.assert_allclose(again, pixel, atol=1e-6)


@pytest.mark.slow
@given(pixels)
def test_the_derivatives_of_both_directions_are_inverse(x64, pixel):
    ray = grid_ray(GRID, SIZE, pixel)
    there, back = pixel_jacobian(GRID, SIZE, ray), ray_jacobian(GRID, SIZE, pixel)
    np.testing.assert_allclose(np.asarray(there) @ np.asarray(back), np.eye(2), atol=1e-6)


@pytest.mark.slow
@given(st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.2, 0.1))
def test_a_grid_of_a_bent_pinhole_agrees_with_it(x64, x, y, k1):
    K = np.array([[1500.0, 0, 1000], [0, 1500, 500], [0, 0, 1]])
    lens = np.array([k1, 0, 0, 0, 0])
    grid = pinhole_rays(K, nodes(33, 33), lens)
    point = np.array([x, y, 1])
    pixel, imaged = grid_pixel(grid, SIZE, point)
    assert imaged
    np.testing.assert_allclose(pixel, pinhole_pixel(K, point, lens)[0], atol=0.02)
    assert not grid_pixel(grid, SIZE, -point)[1]


@pytest.mark.slow
@pytest.mark.parametrize("point", [[0, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1], [1e-20, 0, 0]])
def test_degenerate_points_have_finite_pixels_and_gradients(point):
    grid, point = GRID.astype(np.float32), np.array(point, np.float32)
    assert np.isfinite(grid_pixel(grid, SIZE, point)[0]).all()
    assert np.isfinite(pixel_jacobian(grid, SIZE, point)).all()


@pytest.mark.slow
def test_far_outside_the_image_rays_are_finite():
    grid = GRID.astype(np.float32)
    for pixel in ([-1e6, 500], [3000, 1e9], [2000, 1000]):
        pixel = np.array(pixel, np.float32)
        assert np.isfinite(grid_ray(grid, SIZE, pixel)).all()
        assert np.isfinite(ray_jacobian(grid, SIZE, pixel)).all()
