"""Both methods through lenses that are no pinholes: fisheyes of 180 degrees, and their rays."""

from dataclasses import replace

import numpy as np
import pytest

import catfree as cf
from catfree.geometry.camera import rays_of_pixels
from catfree.synthetic import Layout, make_world
from catfree.synthetic._layouts import look_at

HALF = np.array([6.0, 4.5])  # meters: half the sides of a shop
METHODS = {"evidence": cf.Settings(), "paper": cf.Settings.paper()}


def shop(lens: str, seed: int = 0) -> Layout:
    """Four cameras in the ceiling corners of a shop, 3 m high, looking at its middle."""
    corner = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    center = np.column_stack([corner, np.full(4, 3.0)])
    aim = np.column_stack([0.35 * corner, np.full(4, 0.9)])
    R = np.stack([look_at(*view) for view in zip(center, aim, strict=True)])
    width, height, focal = (1920, 1440, 1920 / np.pi) if lens == "fisheye" else (2400, 2000, 640.0)
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = (width - 1) / 2, (height - 1) / 2
    bent = {"distortion": np.tile([-0.02, 0.004, -0.001, 0, 0], (4, 1)), "lens": ["fisheye"] * 4}
    rig = cf.Rig(
        np.tile(K, (4, 1, 1)),
        R,
        -np.einsum("cij,cj->ci", R, center),
        (width, height),
        **(bent if lens == "fisheye" else {}),
    )
    x, y = HALF - 0.3
    return Layout("shop", rig, (-x, x, -y, y), 5.0, 6)


def as_rays(rig: cf.Rig, cameras: list[int]) -> cf.Rig:
    """The same rig with grids of rays in place of the lenses of some cameras."""
    width, height = rig.image_size[0]
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, 49), np.linspace(-0.5, height - 0.5, 37))
    pixel = np.stack([u, v], -1).reshape(-1, 2)
    lens, rays = rig.lenses.copy(), np.zeros((rig.camera_count, 37, 49, 3))
    for camera in cameras:
        lens[camera] = cf.Lens.RAYS
        rays[camera] = (rays_of_pixels(rig, camera, pixel) @ rig.R[camera].T).reshape(37, 49, 3)
    assert rig.distortion is not None
    bent = np.where((lens == cf.Lens.RAYS)[:, None], 0, rig.distortion)
    return replace(rig, distortion=bent, lens=lens, rays=rays)


@pytest.fixture(scope="module")
def world():
    return make_world(shop("fisheye"), 3, frames=12, background=0)


def errors(world, localization: cf.Localization) -> np.ndarray:
    """Distances of the tracks from the nearest person of their frame, in meters."""
    similarity, tracks = world.scene_from_world, localization.tracks
    away = np.asarray(tracks.position) - np.asarray(similarity.translation)
    place = (away @ np.asarray(similarity.rotation) / float(similarity.scale))[:, :2]
    truth = np.asarray(world.ground_truth)
    return np.array(
        [
            np.linalg.norm(truth[truth[:, 0] == frame, 2:] - xy, axis=-1).min()
            for frame, xy in zip(tracks.frame, place, strict=True)
        ]
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_people_are_found_through_fisheyes(world, method):
    found = cf.localize(world.detections, world.scene, METHODS[method])
    error = errors(world, found)
    share = len(error) / len(world.ground_truth)
    assert share > (0.9 if method == "evidence" else 0.2)
    assert np.median(error) < 0.15
    assert np.quantile(error, 0.9) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_grids_of_rays_give_what_their_lenses_give(world, method):
    rays = replace(world.scene, rig=as_rays(world.scene.rig, [0, 2]))
    first = cf.localize(world.detections, world.scene, METHODS[method]).tracks
    again = cf.localize(world.detections, rays, METHODS[method]).tracks
    assert abs(len(first) - len(again)) <= 2
    extent = float(world.scene.extent)
    apart = [
        np.linalg.norm(again.position[again.frame == frame] - position, axis=-1).min()
        for frame, position in zip(first.frame, first.position, strict=True)
        if (again.frame == frame).any()
    ]
    assert np.quantile(apart, 0.95) < 0.002 * extent
