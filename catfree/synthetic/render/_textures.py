"""Painted surfaces: the ground with its paving, lawn, road and baked shadows, and house fronts."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from catfree.synthetic.render._stage import LAWN_WIDTH, PLAZA_MARGIN, Cylinder, Solid, Sphere, Stage

TEXEL = 0.025  # meters of ground per texel
FRONT_HEIGHT = 10.5  # meters
FRONT_TEXEL = 0.04  # meters of house front per texel
TILE = 0.6  # meters, side of a paving slab

Picture = UInt8[np.ndarray, "row column 3"]


def cloud(
    rng: np.random.Generator, shape: tuple[int, int], scale: float | int
) -> Float[np.ndarray, "row column"]:
    """Draw smooth noise of unit standard deviation with features of about `scale` pixels."""
    rows, columns = shape
    coarse = rng.standard_normal((int(rows / scale) + 4, int(columns / scale) + 4))
    smooth = cv2.resize(coarse.astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC)
    return smooth / max(float(smooth.std()), 1e-6)


def ground_picture(stage: Stage) -> tuple[Picture, UInt8[np.ndarray, "row column"]]:
    """Paint the ground seen from above, with a mask of the sunlit ground (255; shadow 0).

    Rows run along y and columns along x from the corner `middle - front`, `TEXEL` meters each.
    """
    rng = np.random.default_rng([stage.seed, 6])
    columns, rows = (int(np.ceil(2 * extent / TEXEL)) for extent in stage.front)
    shape = (rows, columns)
    x = ((np.arange(columns) + 0.5) * TEXEL - stage.front[0]).astype(np.float32)
    y = ((np.arange(rows) + 0.5) * TEXEL - stage.front[1]).astype(np.float32)
    half_x, half_y = (float(half) for half in stage.half)
    away = np.maximum(np.abs(x)[None, :] - half_x, np.abs(y)[:, None] - half_y)
    wear = 0.03 * rng.standard_normal(shape, np.float32)
    wear += 0.03 * cloud(rng, shape, 90) + 0.02 * cloud(rng, shape, 18)

    picture = _paving(rng, x, y, stage)
    lawn_from, road_from = PLAZA_MARGIN, PLAZA_MARGIN + LAWN_WIDTH
    for start, surface in (
        (lawn_from, (0.2, 0.44, 0.31)),
        (road_from, (0.38, 0.38, 0.37)),
        (road_from + 3.6, (0.62, 0.63, 0.64)),
    ):
        picture[away > start] = surface
        picture[(away > start - 0.12) & (away < start + 0.03)] = 0.72
    grass = (away > lawn_from + 0.03) & (away < road_from - 0.12)
    wear += np.where(grass, 0.06 * cloud(rng, shape, 6), 0)
    sideways = np.abs(x)[None, :] - half_x > np.abs(y)[:, None] - half_y
    along = np.where(sideways, y[:, None], x[None, :])
    picture[(np.abs(away - road_from - 1.8) < 0.07) & (np.mod(along, 3.0) < 1.4)] = 0.85
    picture += wear[..., None]

    shade = _baked_shadows(stage, shape)
    contact = _contact_shadows(stage, shape)
    light = stage.skylight * contact + stage.sunlight * float(stage.sun[2]) * (1 - shade)
    picture = np.clip(picture * (255 * light)[..., None], 0, 255).astype(np.uint8)
    return picture, np.clip((1 - shade) * 255, 0, 255).astype(np.uint8)


def _paving(
    rng: np.random.Generator, x: np.ndarray, y: np.ndarray, stage: Stage
) -> Float[np.ndarray, "row column 3"]:
    """Slabs of slightly different grays with joints, darker bands, and rings in the middle."""
    column, row = np.floor(x / TILE).astype(int), np.floor(y / TILE).astype(int)
    column, row = column - column.min(), row - row.min()
    tone = 0.64 + 0.035 * rng.standard_normal((row.max() + 1, column.max() + 1))
    warm = 0.015 * rng.standard_normal(tone.shape)
    band = (np.arange(column.max() + 1) % 9 == 4)[None, :] | (np.arange(row.max() + 1) % 9 == 4)[
        :, None
    ]
    slab = np.stack([tone - warm - 0.02, tone, tone + warm + 0.02], -1)
    slab = np.where(band[..., None], slab * [0.62, 0.68, 0.8], slab).astype(np.float32)
    picture = slab[row[:, None], column[None, :]]
    joint = (np.mod(x, TILE) < 0.025)[None, :] | (np.mod(y, TILE) < 0.025)[:, None]
    radius = np.hypot(x[None, :], y[:, None]) / float(min(stage.half))
    edge = TEXEL / float(min(stage.half))
    for inner, outer, color in (
        (-1.0, 0.1, (0.6, 0.68, 0.82)),
        (0.24, 0.29, (0.46, 0.54, 0.92)),
        (0.42, 0.48, (0.66, 0.56, 0.5)),
    ):
        ring = np.clip(np.minimum(radius - inner, outer - radius) / edge + 0.5, 0, 1)[..., None]
        picture *= 1 - ring * (1 - np.array(color, np.float32))
    picture[joint] *= 0.72
    return picture


def _baked_shadows(stage: Stage, shape: tuple[int, int]) -> Float[np.ndarray, "row column"]:
    """Shadows of furniture and trees on the ground, 1 where the sun is hidden."""
    mask = np.zeros(shape, np.uint8)
    for solid in stage.solids:
        outline = solid_outline(solid)
        shadow = outline[:, :2] - outline[:, 2:] * stage.sun[:2] / stage.sun[2]
        texel = (shadow - stage.middle + stage.front) / TEXEL
        hull = cv2.convexHull(texel.astype(np.float32))
        cv2.fillConvexPoly(mask, np.round(hull * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    blur = max(stage.shadow_blur / TEXEL / 2, 0.7)
    return cv2.GaussianBlur(mask, (0, 0), blur).astype(np.float32) / 255


def _contact_shadows(stage: Stage, shape: tuple[int, int]) -> Float[np.ndarray, "row column"]:
    """Share of skylight left on the ground beside objects that stand on it."""
    mask = np.zeros((shape[0] // 4, shape[1] // 4), np.uint8)
    for solid in stage.solids:
        outline = solid_outline(solid)
        if outline[:, 2].min() > 0.3:
            continue
        texel = (outline[:, :2] - stage.middle + stage.front) / TEXEL / 4
        hull = cv2.convexHull(texel.astype(np.float32))
        cv2.fillConvexPoly(mask, np.round(hull * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    soft = cv2.GaussianBlur(mask, (0, 0), 3.0)
    soft = cv2.resize(soft, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return 1 - 0.5 * soft.astype(np.float32) / 255


def solid_outline(solid: Solid) -> Float[np.ndarray, "n 3"]:
    """Return points whose convex hull is the solid, in meters."""
    angle = np.arange(16) * np.pi / 8
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    if isinstance(solid, Sphere):
        rise = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 7))
        rings = [np.column_stack([np.sqrt(1 - up**2) * circle, np.full(16, up)]) for up in rise]
        return solid.center + solid.radius * np.concatenate(rings)
    if isinstance(solid, Cylinder):
        flat = solid.center + solid.radius * circle
    else:
        c, s = np.cos(solid.angle), np.sin(solid.angle)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * solid.half
        flat = solid.center + corners @ np.array([[c, s], [-s, c]])
    return np.concatenate(
        [np.insert(flat, 2, solid.bottom, axis=1), np.insert(flat, 2, solid.top, axis=1)]
    )


def front_picture(stage: Stage, wall: int, length: float | int) -> Picture:
    """Draw a house front with windows and a cornice: columns run along the wall, rows down."""
    rng = np.random.default_rng([stage.seed, 7, wall])
    columns, rows = int(length / FRONT_TEXEL), int(FRONT_HEIGHT / FRONT_TEXEL)
    base = np.array(
        [(0.52, 0.66, 0.76), (0.4, 0.45, 0.66), (0.62, 0.66, 0.68), (0.56, 0.62, 0.56)][
            (wall + stage.seed) % 4
        ]
    )
    picture = np.ones((rows, columns, 3), np.float32) * base.astype(np.float32)
    shape = (rows, columns)
    picture += (0.02 * cloud(rng, shape, 40) + 0.015 * cloud(rng, shape, 5))[..., None]
    course = np.mod(np.arange(rows), int(0.3 / FRONT_TEXEL)) == 0
    picture[course] *= 0.93
    storey, bay = 3.2, rng.uniform(2.4, 3.2)
    for level in range(int(FRONT_HEIGHT / storey)):
        top = rows - int((level * storey + 2.6) / FRONT_TEXEL)
        bottom = rows - int((level * storey + (0.9 if level else 0.15)) / FRONT_TEXEL)
        for column in range(int(length / bay)):
            left = int((column * bay + 0.28 * bay) / FRONT_TEXEL)
            right = int((column * bay + 0.72 * bay) / FRONT_TEXEL)
            _window(rng, picture, top, bottom, left, right)
    picture[: int(0.5 / FRONT_TEXEL)] = base * 0.6
    picture[-int(0.4 / FRONT_TEXEL) :] *= 0.65
    return np.clip(picture * 255, 0, 255).astype(np.uint8)


def _window(
    rng: np.random.Generator, picture: np.ndarray, top: int, bottom: int, left: int, right: int
) -> None:
    """Draw a window with a light frame, a sill and panes that mirror the sky differently."""
    frame = 3
    picture[top - frame : bottom + frame, left - frame : right + frame] = 0.86
    pane = np.array([0.42, 0.36, 0.3]) * rng.uniform(0.5, 1.1)
    rows = np.linspace(1.25, 0.8, bottom - top, dtype=np.float32)[:, None, None]
    picture[top:bottom, left:right] = np.clip(rows * pane.astype(np.float32), 0, 1)
    middle = (left + right) // 2
    picture[top:bottom, middle - 1 : middle + 1] = 0.82
    third = top + (bottom - top) // 3
    picture[third - 1 : third + 1, left:right] = 0.82
    picture[bottom + frame : bottom + frame + 3, left - 5 : right + 5] = 0.45
