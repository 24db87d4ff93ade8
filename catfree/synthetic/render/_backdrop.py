"""One still picture per camera, ray-cast from ground, house fronts, furniture and trees."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from catfree.synthetic.render._raycasting import (
    OVERSAMPLING,
    Canvas,
    cast_block,
    cast_cylinder,
    cast_sphere,
)
from catfree.synthetic.render._stage import Cylinder, Sphere, Stage
from catfree.synthetic.render._textures import (
    FRONT_HEIGHT,
    FRONT_TEXEL,
    TEXEL,
    cloud,
    front_picture,
    solid_outline,
)
from catfree.types import Rig

FAR_GROUND = 16.0  # meters beyond which the ground is sampled from a coarser picture
HAZE = 140.0  # meters over which haze removes about two thirds of the contrast
HAZE_COLOR = np.array([0.86, 0.8, 0.75], np.float32)


@dataclass(frozen=True)
class Background:
    """View of a camera without people.

    Attributes:
        picture: (H, W, 3) uint8 BGR.
        distance: (H, W) meters to furniture and trees, inf elsewhere.
        sunlit: (H, W) 255 where the ground is in the sun, so that people cast shadows.
    """

    picture: UInt8[np.ndarray, "row column 3"]
    distance: Float[np.ndarray, "row column"]
    sunlit: UInt8[np.ndarray, "row column"]


def render_background(
    stage: Stage,
    rig: Rig,
    camera: int,
    ground: tuple[UInt8[np.ndarray, "y x 3"], UInt8[np.ndarray, "y x"]],
) -> Background:
    """Render the picture, the furniture's distances and the sunlit ground of one camera.

    Args:
        stage: the static objects.
        rig: the true cameras in meters.
        camera: index of the camera.
        ground: `ground_picture(stage)`, the same for all cameras.
    """
    canvas = Canvas(stage, rig, camera)
    _sky(canvas)
    _ground(canvas, *ground)
    _fronts(canvas)
    behind = canvas.distance.copy()
    for index, solid in enumerate(stage.solids):
        window = canvas.window(solid_outline(solid))
        if window is None:
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            if isinstance(solid, Sphere):
                cast_sphere(canvas, window, solid, index)
            elif isinstance(solid, Cylinder):
                cast_cylinder(canvas, window, solid)
            else:
                cast_block(canvas, window, solid)
    is_solid = canvas.distance < behind
    haze = np.exp(-np.minimum(canvas.distance, 1e4) / HAZE)[..., None]
    color = canvas.color * haze + HAZE_COLOR * (1 - haze)
    size = tuple(int(n) for n in rig.image_size[camera])
    smooth = cv2.resize(color, size, interpolation=cv2.INTER_AREA)
    solid_distance = np.where(is_solid, canvas.distance, np.float32(np.inf))
    return Background(
        picture=np.clip(_vignette(smooth) * 255, 0, 255).astype(np.uint8),
        distance=solid_distance[::OVERSAMPLING, ::OVERSAMPLING].copy(),
        sunlit=cv2.resize(
            np.where(is_solid, 0, canvas.sunlit).astype(np.uint8),
            size,
            interpolation=cv2.INTER_AREA,
        ),
    )


def _vignette(picture: np.ndarray) -> np.ndarray:
    rows, columns = picture.shape[:2]
    y = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, columns, dtype=np.float32)[None, :]
    return picture * (1 - 0.07 * (x**2 + y**2))[..., None]


def _sky(canvas: Canvas) -> None:
    rng = np.random.default_rng([canvas.stage.seed, 8, canvas.camera])
    width = canvas.distance.shape[1]
    above = np.flatnonzero((canvas.ray[..., 2] > -0.02).any(-1))
    if not above.size:
        return
    height = int(above[-1]) + 1
    up = np.clip(canvas.ray[:height, :, 2], 0, 0.5)[..., None] * 2
    low, high = np.array([0.9, 0.84, 0.78], np.float32), np.array([0.85, 0.62, 0.42], np.float32)
    clouds = np.clip(0.3 * cloud(rng, (height, width), width / 6), 0, 1)[..., None]
    canvas.color[:height] = (low + (high - low) * up) * (1 - clouds) + clouds * 0.95


def _lookup(texture: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    return cv2.remap(
        texture,
        column.astype(np.float32),
        row.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _ground(canvas: Canvas, texture: np.ndarray, sunlit: np.ndarray) -> None:
    below = np.flatnonzero((canvas.ray[..., 2] < -1e-3).any(-1))
    if not below.size:
        return
    # The horizon is almost level: sample every row from its highest row down.
    rows = slice(int(below[0]), None)
    ray = canvas.ray[rows]
    steep = np.minimum(ray[..., 2], -1e-3)
    distance = -canvas.center[2] / steep
    corner = (canvas.center[:2] - canvas.stage.middle + canvas.stage.front).astype(np.float32)
    column = (corner[0] + distance * ray[..., 0]) / TEXEL - 0.5
    row = (corner[1] + distance * ray[..., 1]) / TEXEL - 0.5
    picture = _lookup(texture, column, row)
    # A far sample covers many texels: take it from a picture of a quarter of the size.
    coarse = cv2.resize(texture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    last = int(np.flatnonzero((distance > FAR_GROUND).any(-1)).max(initial=0)) + 1
    far = _lookup(coarse, (column[:last] + 0.5) / 4 - 0.5, (row[:last] + 0.5) / 4 - 0.5)
    share = np.clip(distance[:last] / FAR_GROUND - 1, 0, 1)[..., None]
    picture[:last] = picture[:last] * (1 - share) + far * share
    down = ray[..., 2] < -1e-3
    seen = np.where(down, distance, np.nan)
    canvas.put((rows, slice(None)), seen, picture * np.float32(1 / 255))
    canvas.sunlit[rows] = np.where(down, _lookup(sunlit, column, row), 0)


def _fronts(canvas: Canvas) -> None:
    stage = canvas.stage
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
        hit = (distance > 0) & (up >= 0) & (up < FRONT_HEIGHT)
        hit &= (along >= 0) & (along <= length)
        if not hit.any():
            continue
        picture = front_picture(stage, wall, length)
        normal = np.zeros(3)
        normal[axis] = -side
        column, row = np.where(hit, along, 0), np.where(hit, FRONT_HEIGHT - up, 0)
        color = _lookup(picture, column / FRONT_TEXEL, row / FRONT_TEXEL) * np.float32(
            float(stage.light(normal)) / 255
        )
        canvas.put(window, np.where(hit, distance, np.nan), color)
