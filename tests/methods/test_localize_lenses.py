"""Both methods with lenses that are not pinholes: 180-degree fisheyes, and their rays."""

from dataclasses import replace

import numpy as np
import pytest

import catfree as cf
from catfree.geometry.camera import rays_of_pixels
from catfree.synthetic import make_world, shop

pytestmark = pytest.mark.slow

METHODS = {"evidence": cf.Settings(), "paper": cf.Settings.paper()}


def as_rays(rig: cf.Rig, cameras: list[int]) -> cf.Rig:
    """Replace the lenses of some cameras of a rig by grids of rays."""
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
    return make_world(shop(), 3, frames=12, people=6, background=0)


def errors(world, localization: cf.Localization) -> np.ndarray:
    """Compute distances in meters of tracks from the nearest person of their frame."""
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


@pytest.mark.parametrize("method", METHODS)
def test_fisheyes_find_the_people_that_pinholes_find(world, method):
    """Accuracy agrees within a few centimeters; `benchmarks/lenses.py` has longer worlds."""
    pinholes = make_world(shop(fisheye=False), 3, frames=12, people=6, background=0)
    through, straight = (
        errors(one, cf.localize(one.detections, one.scene, METHODS[method]))
        for one in (world, pinholes)
    )
    people = len(world.ground_truth)
    assert (through < 0.5).sum() >= (straight < 0.5).sum() - 0.05 * people
    if method == "evidence":
        assert (through < 0.5).sum() <= (straight < 0.5).sum() + 0.05 * people
    assert np.median(through) <= np.median(straight) + 0.05
    assert np.quantile(through, 0.9) <= np.quantile(straight, 0.9) + 0.05
