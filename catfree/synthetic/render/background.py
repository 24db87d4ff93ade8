"""One still picture a camera: rays cast at the ground, the house fronts, furniture and trees."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from catfree.synthetic.render.stage import Block, Cylinder, Sphere, Stage
from catfree.synthetic.render.textures import (
    FRONT_TEXEL,
    TEXEL,
    cloud,
    front_picture,
    ground_picture,
    solid_outline,
)
from catfree.synthetic.silhouettes import project
from catfree.types import Rig

OVERSAMPLING = 2  # rays a pixel and direction; the picture is averaged down
FRONT_HEIGHT = 10.5  # metres
FAR_GROUND = 16.0  # metres from which the ground is looked up in a coarser picture
HAZE = 140.0  # metres in which the air takes about two thirds of the contrast
HAZE_COLOUR = np.array([0.86, 0.8, 0.75], np.float32)

RowColumn = Float[np.ndarray, "row column"]


@dataclass(frozen=True)
class Background:
    """What a camera sees without people.

    Attributes:
        picture: (H, W, 3) uint8 BGR.
        distance: (H, W) metres to furniture and trees, inf where there are none.
        sunlit: (H, W) 255 where the ground is in the sun: where people throw shadows.
    """

    picture: UInt8[np.ndarray, "row column 3"]
    distance: Float[np.ndarray, "row column"]
    sunlit: UInt8[np.ndarray, "row column"]


class _Canvas:
    """The rays of a camera and the nearest thing that each has met so far."""

    def __init__(self, rig: Rig, camera: int) -> None:
        self.rig, self.camera = rig, camera
        width, height = (int(n) * OVERSAMPLING for n in rig.image_size[camera])
        self.center = np.asarray(rig.centers)[camera].astype(np.float32)
        # Sample positions are in pixels of the picture, whose first pixel has its centre at 0.
        u = (np.arange(width, dtype=np.float32) + 0.5) / OVERSAMPLING - 0.5
        v = (np.arange(height, dtype=np.float32) + 0.5) / OVERSAMPLING - 0.5
        inverse = (np.asarray(rig.R)[camera].T @ np.linalg.inv(rig.K[camera])).astype(np.float32)
        ray = u[None, :, None] * inverse[:, 0] + v[:, None, None] * inverse[:, 1] + inverse[:, 2]
        self.ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        self.distance = np.full((height, width), np.inf, np.float32)
        self.colour = np.zeros((height, width, 3), np.float32)
        self.solid = np.zeros((height, width), bool)
        self.sunlit = np.zeros((height, width), np.float32)

    def window(self, outline: np.ndarray) -> tuple[slice, slice] | None:
        """Rows and columns of the rays that may meet a convex hull, or None."""
        pixel, depth = project(self.rig, self.camera, outline)
        if depth.min() < 0.2:
            return (slice(None), slice(None)) if depth.max() > 0.2 else None
        low = np.floor((pixel.min(0) - 1) * OVERSAMPLING).astype(int)
        high = np.ceil((pixel.max(0) + 2) * OVERSAMPLING).astype(int)
        height, width = self.distance.shape
        if (high <= 0).any() or low[0] >= width or low[1] >= height:
            return None
        return slice(max(low[1], 0), high[1]), slice(max(low[0], 0), high[0])

    def put(self, window: tuple[slice, slice], distance: np.ndarray, colour: np.ndarray) -> None:
        """Where a solid at `distance` (NaN: missed) is nearer, it is what the rays meet."""
        nearer = distance < self.distance[window]
        np.copyto(self.distance[window], distance, where=nearer)
        np.copyto(self.colour[window], colour, where=nearer[..., None])
        self.solid[window] |= nearer


def render_background(
    stage: Stage,
    rig: Rig,
    camera: int,
    ground: tuple[UInt8[np.ndarray, "y x 3"], UInt8[np.ndarray, "y x"]] | None = None,
) -> Background:
    """The picture, the furniture's distances and the sunlit ground of one camera.

    Args:
        stage: what stands there.
        rig: the true cameras in metres.
        camera: which of them.
        ground: `ground_picture(stage)` where it is known already.
    """
    canvas = _Canvas(rig, camera)
    _sky(canvas, stage)
    _ground(canvas, ground_picture(stage) if ground is None else ground, stage)
    _fronts(canvas, stage)
    for index, solid in enumerate(stage.solids):
        window = canvas.window(solid_outline(solid))
        if window is None:
            continue
        ray = canvas.ray[window]
        with np.errstate(invalid="ignore", divide="ignore"):
            if isinstance(solid, Sphere):
                _sphere(canvas, window, ray, solid, stage, index)
            elif isinstance(solid, Cylinder):
                _cylinder(canvas, window, ray, solid, stage)
            else:
                _block(canvas, window, ray, solid, stage)
    haze = np.exp(-np.minimum(canvas.distance, 1e4) / HAZE)[..., None]
    colour = canvas.colour * haze + HAZE_COLOUR * (1 - haze)
    size = tuple(int(n) for n in rig.image_size[camera])
    smooth = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    solid_distance = np.where(canvas.solid, canvas.distance, np.float32(np.inf))
    return Background(
        picture=np.clip(_vignette(smooth) * 255, 0, 255).astype(np.uint8),
        distance=solid_distance[::OVERSAMPLING, ::OVERSAMPLING].copy(),
        sunlit=cv2.resize(
            np.where(canvas.solid, 0, canvas.sunlit).astype(np.uint8),
            size,
            interpolation=cv2.INTER_AREA,
        ),
    )


def _vignette(picture: np.ndarray) -> np.ndarray:
    rows, columns = picture.shape[:2]
    y = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, columns, dtype=np.float32)[None, :]
    return picture * (1 - 0.07 * (x**2 + y**2))[..., None]


def light(normal: np.ndarray, stage: Stage) -> np.ndarray:
    """Brightness (..., ) of surfaces with these unit normals, out of any shadow."""
    sky = stage.skylight * (0.75 + 0.25 * normal[..., 2])
    return sky + stage.sunlight * np.maximum(normal @ stage.sun.astype(normal.dtype), 0)


def _sky(canvas: _Canvas, stage: Stage) -> None:
    rng = np.random.default_rng([stage.seed, 8, canvas.camera])
    width = canvas.distance.shape[1]
    above = np.flatnonzero((canvas.ray[..., 2] > -0.02).any(-1))
    if not above.size:
        return
    height = int(above[-1]) + 1
    up = np.clip(canvas.ray[:height, :, 2], 0, 0.5)[..., None] * 2
    low, high = np.array([0.9, 0.84, 0.78], np.float32), np.array([0.85, 0.62, 0.42], np.float32)
    clouds = np.clip(0.3 * cloud(rng, (height, width), width / 6), 0, 1)[..., None]
    canvas.colour[:height] = (low + (high - low) * up) * (1 - clouds) + clouds * 0.95


def _lookup(texture: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    return cv2.remap(
        texture,
        column.astype(np.float32),
        row.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _ground(canvas: _Canvas, ground: tuple[np.ndarray, np.ndarray], stage: Stage) -> None:
    texture, sunlit = ground
    below = np.flatnonzero((canvas.ray[..., 2] < -1e-3).any(-1))
    if not below.size:
        return
    # The horizon is almost level: everything from its highest row on is looked up.
    rows = slice(int(below[0]), None)
    ray = canvas.ray[rows]
    steep = np.minimum(ray[..., 2], -1e-3)
    distance = -canvas.center[2] / steep
    corner = (canvas.center[:2] - stage.middle + stage.front).astype(np.float32)
    column = (corner[0] + distance * ray[..., 0]) / TEXEL - 0.5
    row = (corner[1] + distance * ray[..., 1]) / TEXEL - 0.5
    picture = _lookup(texture, column, row)
    # Far away a sample covers many texels: look into a picture of a quarter of the size there.
    coarse = cv2.resize(texture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    last = int(np.flatnonzero((distance > FAR_GROUND).any(-1)).max(initial=0)) + 1
    far = _lookup(coarse, (column[:last] + 0.5) / 4 - 0.5, (row[:last] + 0.5) / 4 - 0.5)
    share = np.clip(distance[:last] / FAR_GROUND - 1, 0, 1)[..., None]
    picture[:last] = picture[:last] * (1 - share) + far * share
    down = ray[..., 2] < -1e-3
    canvas.colour[rows] = np.where(
        down[..., None], picture * np.float32(1 / 255), canvas.colour[rows]
    )
    canvas.distance[rows] = np.where(down, distance, np.inf)
    canvas.sunlit[rows] = np.where(down, _lookup(sunlit, column, row), 0)


def _fronts(canvas: _Canvas, stage: Stage) -> None:
    for wall, (axis, side) in enumerate([(0, -1), (0, 1), (1, -1), (1, 1)]):
        other = 1 - axis
        plane = stage.middle[axis] + side * stage.front[axis]
        length = 2 * float(stage.front[other])
        ends = np.zeros((4, 3))
        ends[:, axis] = plane
        ends[:, other] = stage.middle[other] + np.array([-1, 1, -1, 1]) * stage.front[other]
        ends[2:, 2] = FRONT_HEIGHT
        window = canvas.window(ends)
        if window is None:
            continue
        ray = canvas.ray[window]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = float(plane - canvas.center[axis]) / ray[..., axis]
            along = distance * ray[..., other]
            up = canvas.center[2] + distance * ray[..., 2]
        along += float(canvas.center[other] - stage.middle[other] + stage.front[other])
        hit = (distance > 0) & (distance < canvas.distance[window])
        hit &= (up >= 0) & (up < FRONT_HEIGHT)
        hit &= (along >= 0) & (along <= length)
        if not hit.any():
            continue
        picture = front_picture(stage, wall, length, FRONT_HEIGHT)
        normal = np.zeros(3)
        normal[axis] = -side
        column, row = np.where(hit, along, 0), np.where(hit, FRONT_HEIGHT - up, 0)
        colour = _lookup(picture, column / FRONT_TEXEL, row / FRONT_TEXEL) * np.float32(
            float(light(normal, stage)) / 255
        )
        np.copyto(canvas.colour[window], colour, where=hit[..., None])
        np.copyto(canvas.distance[window], distance, where=hit)


def _sphere(
    canvas: _Canvas,
    window: tuple[slice, slice],
    ray: np.ndarray,
    solid: Sphere,
    stage: Stage,
    index: int,
) -> None:
    offset = (canvas.center - solid.center).astype(np.float32)
    b = ray @ offset
    distance = -b - np.sqrt(b**2 - (offset @ offset - solid.radius**2))
    normal = (offset + distance[..., None] * ray) / np.float32(solid.radius)
    rng = np.random.default_rng([stage.seed, 9, index, canvas.camera])
    leaves = 1 + solid.roughness * 0.45 * cloud(rng, distance.shape, 5)
    # The inside of foliage is dark: what faces down gets little light.
    shade = light(normal, stage) * leaves * (0.8 + 0.2 * normal[..., 2])
    canvas.put(window, distance, shade[..., None] * np.array(solid.colour, np.float32))


def _cylinder(
    canvas: _Canvas,
    window: tuple[slice, slice],
    ray: np.ndarray,
    solid: Cylinder,
    stage: Stage,
) -> None:
    offset = (canvas.center[:2] - solid.center).astype(np.float32)
    flat = ray[..., :2]
    a = (flat**2).sum(-1)
    b = flat @ offset
    distance = (-b - np.sqrt(b**2 - a * (offset @ offset - solid.radius**2))) / a
    up = canvas.center[2] + distance * ray[..., 2]
    side = (up >= solid.bottom) & (up <= solid.top) & (distance > 0)
    radial = (offset + distance[..., None] * flat) / np.float32(solid.radius)
    normal = np.concatenate([radial, np.zeros_like(radial[..., :1])], -1)
    colour = _painted(solid, radial, up, stage) * light(normal, stage)[..., None]
    canvas.put(window, np.where(side, distance, np.nan), colour)
    lid = (solid.top - canvas.center[2]) / ray[..., 2]
    beyond = offset + lid[..., None] * flat
    on_lid = (lid > 0) & ((beyond**2).sum(-1) < solid.radius**2)
    top_light = np.float32(float(light(np.array([0.0, 0.0, 1.0]), stage)))
    top = np.broadcast_to(np.array(solid.colour, np.float32) * top_light, colour.shape)
    canvas.put(window, np.where(on_lid, lid, np.nan), top)


def _painted(solid: Cylinder, radial: np.ndarray, up: np.ndarray, stage: Stage) -> np.ndarray:
    """The colour of each point of a cylinder's side: posters, bricks, bands or bark."""
    base = np.broadcast_to(np.array(solid.colour, np.float32), (*up.shape, 3))
    angle = np.nan_to_num(np.arctan2(radial[..., 1], radial[..., 0]) / (2 * np.pi) + 0.5)
    level = np.nan_to_num(np.clip(up, 0, 10))
    if solid.style == "posters":
        rng = np.random.default_rng([stage.seed, 10])
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


def _block(
    canvas: _Canvas, window: tuple[slice, slice], ray: np.ndarray, solid: Block, stage: Stage
) -> None:
    c, s = np.cos(solid.angle), np.sin(solid.angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float32)  # world to block
    middle = np.array([*solid.center, (solid.bottom + solid.top) / 2])
    half = np.array([*solid.half, (solid.top - solid.bottom) / 2], np.float32)
    origin = turn @ (canvas.center - middle).astype(np.float32)
    local = ray @ turn.T
    low, high = (-half - origin) / local, (half - origin) / local
    entry = np.minimum(low, high)
    distance, leaving = entry.max(-1), np.maximum(low, high).min(-1)
    axis = entry.argmax(-1)
    sign = -np.sign(np.take_along_axis(local, axis[..., None], -1)[..., 0])
    shades = np.array(
        [[float(light(direction * turn[i], stage)) for i in range(3)] for direction in (-1.0, 1.0)],
        np.float32,
    )
    shade = shades[(sign > 0).astype(int), axis]
    hit = (distance < leaving) & (distance > 0)
    colour = shade[..., None] * np.array(solid.colour, np.float32)
    canvas.put(window, np.where(hit, distance, np.nan), colour)
