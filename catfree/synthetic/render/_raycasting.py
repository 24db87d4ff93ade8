"""Ray casting: the rays of a camera, their nearest hits, and the three shapes of furniture."""

import numpy as np

from catfree.synthetic._silhouettes import project_points
from catfree.synthetic.render._stage import Block, Cylinder, Sphere, Stage
from catfree.synthetic.render._textures import cloud
from catfree.types import Rig

OVERSAMPLING = 2  # rays per pixel along each axis; the picture is averaged down


class Canvas:
    """The rays of a camera on a stage and the nearest hit of each so far."""

    def __init__(self, stage: Stage, rig: Rig, camera: int) -> None:
        self.stage, self.rig, self.camera = stage, rig, camera
        width, height = (int(n) * OVERSAMPLING for n in rig.image_size[camera])
        self.center = np.asarray(rig.centers)[camera].astype(np.float32)
        # Sample positions in pixels of the picture, with the center of the first pixel at 0.
        u = (np.arange(width, dtype=np.float32) + 0.5) / OVERSAMPLING - 0.5
        v = (np.arange(height, dtype=np.float32) + 0.5) / OVERSAMPLING - 0.5
        inverse = (np.asarray(rig.R)[camera].T @ np.linalg.inv(rig.K[camera])).astype(np.float32)
        ray = u[None, :, None] * inverse[:, 0] + v[:, None, None] * inverse[:, 1] + inverse[:, 2]
        self.ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        self.distance = np.full((height, width), np.inf, np.float32)
        self.color = np.zeros((height, width, 3), np.float32)
        self.sunlit = np.zeros((height, width), np.float32)

    def window(self, outline: np.ndarray) -> tuple[slice, slice] | None:
        """Find rows and columns of the rays that may hit a convex hull, or None."""
        pixel, depth = project_points(self.rig, self.camera, outline)
        if depth.min() < 0.2:
            is_visible = depth.max() > 0.2 and not self._is_beside(outline)
            return (slice(None), slice(None)) if is_visible else None
        low = np.floor((pixel.min(0) - 1) * OVERSAMPLING).astype(int)
        high = np.ceil((pixel.max(0) + 2) * OVERSAMPLING).astype(int)
        height, width = self.distance.shape
        if (high <= 0).any() or low[0] >= width or low[1] >= height:
            return None
        return slice(max(low[1], 0), high[1]), slice(max(low[0], 0), high[0])

    def _is_beside(self, outline: np.ndarray) -> bool:
        """Return whether a convex hull is out of view beyond one edge of the picture.

        It is then beyond the plane through the camera center and that edge.
        """
        rig, camera = self.rig, self.camera
        matrix = np.asarray(rig.K)[camera] @ np.asarray(rig.R)[camera]
        # Not divided by the depth, so that points behind the camera count correctly.
        place = (outline - np.asarray(rig.centers)[camera]) @ matrix.T
        low, high = -2 * place[:, 2:], (rig.image_size[camera] + 1) * place[:, 2:]
        return bool((place[:, :2] < low).all(0).any() or (place[:, :2] > high).all(0).any())

    def put(self, window: tuple[slice, slice], distance: np.ndarray, color: np.ndarray) -> None:
        """Record a surface at `distance` (NaN: no hit) where it is the nearest hit."""
        nearer = distance < self.distance[window]
        np.copyto(self.distance[window], distance, where=nearer)
        np.copyto(self.color[window], color, where=nearer[..., None])


def cast_sphere(canvas: Canvas, window: tuple[slice, slice], solid: Sphere, index: int) -> None:
    """Draw a sphere of mottled color where the rays of a window hit it."""
    ray = canvas.ray[window]
    offset = (canvas.center - solid.center).astype(np.float32)
    b = ray @ offset
    distance = -b - np.sqrt(b**2 - (offset @ offset - solid.radius**2))
    normal = (offset + distance[..., None] * ray) / np.float32(solid.radius)
    rng = np.random.default_rng([canvas.stage.seed, 9, index, canvas.camera])
    leaves = 1 + solid.roughness * 0.45 * cloud(rng, distance.shape, 5)
    # The inside of foliage is dark: surfaces that face down get little light.
    shade = canvas.stage.light(normal) * leaves * (0.8 + 0.2 * normal[..., 2])
    canvas.put(window, distance, shade[..., None] * np.array(solid.color, np.float32))


def cast_cylinder(canvas: Canvas, window: tuple[slice, slice], solid: Cylinder) -> None:
    """Draw an upright cylinder with its lid where the rays of a window hit it."""
    stage, ray = canvas.stage, canvas.ray[window]
    offset = (canvas.center[:2] - solid.center).astype(np.float32)
    flat = ray[..., :2]
    a = (flat**2).sum(-1)
    b = flat @ offset
    distance = (-b - np.sqrt(b**2 - a * (offset @ offset - solid.radius**2))) / a
    up = canvas.center[2] + distance * ray[..., 2]
    side = (up >= solid.bottom) & (up <= solid.top) & (distance > 0)
    radial = (offset + distance[..., None] * flat) / np.float32(solid.radius)
    normal = np.concatenate([radial, np.zeros_like(radial[..., :1])], -1)
    color = _painted(solid, radial, up, stage.seed) * stage.light(normal)[..., None]
    canvas.put(window, np.where(side, distance, np.nan), color)
    lid = (solid.top - canvas.center[2]) / ray[..., 2]
    beyond = offset + lid[..., None] * flat
    on_lid = (lid > 0) & ((beyond**2).sum(-1) < solid.radius**2)
    top_light = np.float32(float(stage.light(np.array([0.0, 0.0, 1.0]))))
    top = np.broadcast_to(np.array(solid.color, np.float32) * top_light, color.shape)
    canvas.put(window, np.where(on_lid, lid, np.nan), top)


def _painted(solid: Cylinder, radial: np.ndarray, up: np.ndarray, seed: int) -> np.ndarray:
    """Color of each point on a cylinder's side: posters, bricks, bands or bark."""
    base = np.broadcast_to(np.array(solid.color, np.float32), (*up.shape, 3))
    angle = np.nan_to_num(np.arctan2(radial[..., 1], radial[..., 0]) / (2 * np.pi) + 0.5)
    level = np.nan_to_num(np.clip(up, 0, 10))
    if solid.style == "posters":
        rng = np.random.default_rng([seed, 10])
        bright = rng.uniform(0.15, 0.9, (6, 2, 3)).astype(np.float32)
        column, row = (angle * 6).astype(int) % 6, (level > 1.45).astype(int)
        inside = (np.mod(angle * 6, 1) > 0.07) & (np.mod(angle * 6, 1) < 0.93)
        inside &= (level > 0.4) & (level < 2.55) & (np.abs(level - 1.45) > 0.05)
        stripe = np.mod(level * 3 + column, 1) < 0.3
        poster = bright[column, row] * np.where(stripe, 0.6, 1.0)[..., None].astype(np.float32)
        return np.where(inside[..., None], poster, base)
    if solid.style == "bricks":
        course = np.floor(level / 0.12)
        joint = (np.mod(level, 0.12) < 0.015) | (np.mod(angle * 14 + 0.5 * course, 1) < 0.05)
        return np.where(joint[..., None], base * np.float32(1.3), base)
    if solid.style == "bands":
        return np.where((np.mod(angle * 10, 1) < 0.25)[..., None], base * np.float32(0.75), base)
    if solid.style == "bark":
        return base * (1 + 0.25 * np.sin(angle * 60 + 4 * level))[..., None].astype(np.float32)
    return base


def cast_block(canvas: Canvas, window: tuple[slice, slice], solid: Block) -> None:
    """Draw an upright box where the rays of a window hit it: the slab test in its own axes."""
    c, s = np.cos(solid.angle), np.sin(solid.angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float32)  # world to block
    middle = np.array([*solid.center, (solid.bottom + solid.top) / 2])
    half = np.array([*solid.half, (solid.top - solid.bottom) / 2], np.float32)
    origin = turn @ (canvas.center - middle).astype(np.float32)
    local = canvas.ray[window] @ turn.T
    low, high = (-half - origin) / local, (half - origin) / local
    entry = np.minimum(low, high)
    distance, leaving = entry.max(-1), np.maximum(low, high).min(-1)
    axis = entry.argmax(-1)
    sign = -np.sign(np.take_along_axis(local, axis[..., None], -1)[..., 0])
    shades = np.array(
        [[float(canvas.stage.light(side * turn[i])) for i in range(3)] for side in (-1.0, 1.0)],
        np.float32,
    )
    shade = shades[(sign > 0).astype(int), axis]
    hit = (distance < leaving) & (distance > 0)
    color = shade[..., None] * np.array(solid.color, np.float32)
    canvas.put(window, np.where(hit, distance, np.nan), color)
