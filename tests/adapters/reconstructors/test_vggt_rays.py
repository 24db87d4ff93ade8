"""A network's map of rays as cameras: pixels give the points of VGGT, and nothing else."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import catfree as cf
from catfree.adapters import VggtOnnx
from catfree.adapters.protocols import RaySource
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 168, 112


class RayMap:
    """A `RaySource` that interpolates the rays of a network's pixels."""

    def __init__(self, networks, sizes):
        self._maps = []
        for network, (width, height) in zip(networks, sizes, strict=True):
            seen = network([np.zeros((height, width, 3), np.uint8)])
            (placement,), target = network.preprocess([(int(width), int(height))])
            rows, columns = (
                np.arange(part.start, part.stop, dtype=float) for part in placement.inside(target)
            )
            rays = seen.points @ seen.R[0].T + seen.t[0]
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            u, _ = placement.to_original(np.stack([columns, 0 * columns], -1)).T
            _, v = placement.to_original(np.stack([0 * rows, rows], -1)).T
            grid = rays.reshape(len(rows), len(columns), 3)
            self._maps.append(
                RegularGridInterpolator((v, u), grid, bounds_error=False, fill_value=None)
            )

    def __call__(self, camera, pixels):
        rays = self._maps[camera](pixels[:, ::-1])
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def network_of(K, size, constant_graph, name):
    """Write a tiny graph that answers like VGGT for a camera with these intrinsics."""
    reference = {"pose_enc": np.array([0, 0, 0, 0, 0, 0, 1, 0.8, 1.1], np.float32)}
    blank = np.ones((HEIGHT, WIDTH))
    reference |= {"world_points": np.tile(blank[..., None], 3), "world_points_conf": blank}
    shape = [1, 1, 3, HEIGHT, WIDTH]
    plain = VggtOnnx(constant_graph(shape, reference, lead=2, name=f"plain_{name}"))
    (placement,), _ = plain.preprocess([size])
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    pixel = placement.to_original(np.stack([columns, rows], -1).reshape(-1, 2))
    ray = np.linalg.solve(K, np.column_stack([pixel, np.ones(len(pixel))]).T).T
    depth = 5 + np.sin(0.02 * pixel[:, :1]) + np.cos(0.03 * pixel[:, 1:])
    points = (depth * ray).reshape(HEIGHT, WIDTH, 3).astype(np.float32)
    answers = reference | {"world_points": points}
    return VggtOnnx(constant_graph(shape, answers, lead=2, name=name))


@pytest.mark.parametrize("method", [cf.Settings(), cf.Settings.paper()], ids=["evidence", "paper"])
def test_people_are_where_they_are_through_the_rays_of_a_network(constant_graph, method):
    world = make_world("ring4", 2, frames=20, people=5, background=0)
    scene = world.true_scene
    rig, count = scene.rig, scene.rig.camera_count
    sizes = [(int(w), int(h)) for w, h in rig.image_size]
    networks = [network_of(rig.K[c], sizes[c], constant_graph, f"{c}.onnx") for c in range(count)]
    source = RayMap(networks, sizes)
    assert isinstance(source, RaySource)
    by_rays = cf.rig_from_rays(source, rig.R, rig.t, rig.image_size)
    tracks, expected = (
        cf.localize(world.detections, cf.Scene(r, scene.ground, scene.extent, True), method).tracks
        for r in (by_rays, rig)
    )
    assert len(tracks) > 0.95 * len(expected) > 50
    apart = [
        np.linalg.norm(expected.ground_xy[expected.frame == f] - xy, axis=-1).min()
        for f, xy in zip(tracks.frame, tracks.ground_xy, strict=True)
    ]
    assert np.quantile(apart, 0.95) < 0.05
