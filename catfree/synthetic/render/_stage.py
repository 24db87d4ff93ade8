"""The stage of a rendered world: sun, furniture, trees and buildings, with their sizes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from catfree.errors import InvalidInputError, quoted
from catfree.synthetic._walkers import Area, middle_and_half
from catfree.synthetic._world import World

# Furniture as (radius, height) in meters; people walk around the circle.
PILLAR = (0.17, 4.0)
ADVERTISING_COLUMN = (0.55, 2.7)
PLANTER = (0.95, 0.75)
BENCH = (0.85, 0.46)
FURNITURE = (PILLAR, PILLAR, PILLAR, PLANTER, BENCH, ADVERTISING_COLUMN, PLANTER)

PLAZA_MARGIN = 5.0  # meters of paving beyond the area
LAWN_WIDTH = 3.0
BUILDING_DISTANCE = 13.0  # meters from the border of the area to the house fronts

Color = tuple[float, float, float]  # blue, green, red in [0, 1]


@dataclass(frozen=True)
class Sphere:
    """A sphere of one color, in meters."""

    center: Float[np.ndarray, "3"]
    radius: float
    color: Color
    roughness: float


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder; its style paints stripes, posters, bricks or bark on it."""

    center: Float[np.ndarray, "2"]
    radius: float
    bottom: float
    top: float
    color: Color
    style: str = "plain"


@dataclass(frozen=True)
class Block:
    """An upright box turned by `angle` about the vertical."""

    center: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    bottom: float
    top: float
    angle: float
    color: Color


Solid = Sphere | Cylinder | Block


@dataclass(frozen=True)
class Stage:
    """Everything that does not move.

    Attributes:
        middle, half: (2,) center and half extents of the evaluation area in meters.
        front: half extents (x, y) of the rectangle of house fronts around its middle.
        sun: (3,) unit vector towards the sun.
        sunlight, skylight: brightness of the two lights.
        shadow_blur: meters over which the edge of a shadow fades.
        solids: furniture and trees.
        seed: seed of the textures.
    """

    middle: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    front: Float[np.ndarray, "2"]
    sun: Float[np.ndarray, "3"]
    sunlight: float
    skylight: float
    shadow_blur: float
    solids: tuple[Solid, ...]
    seed: int

    def light(self, normal: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Compute brightness (...,) of unshadowed surfaces with these unit normals (..., 3)."""
        sky = self.skylight * (0.75 + 0.25 * normal[..., 2])
        sun = np.maximum(normal @ self.sun.astype(normal.dtype), 0)
        return np.asarray(sky + self.sunlight * sun)


def street_furniture(
    area: Area,
    seed: int = 0,
    *,
    cameras: Float[np.ndarray, "cam 3"] | None = None,
) -> Float[np.ndarray, "k 4"]:
    """Spread pillars, advertising columns, planters and benches over an area.

    Args:
        area: evaluation area (x_min, x_max, y_min, y_max) in meters.
        seed: determines all random draws.
        cameras: (C, 3) camera centers, from which tall objects keep 5 m or more away if there is
            room, or None.

    Returns:
        (K, 4) x, y, radius, height in meters: the `columns` of `make_world`. Objects keep 2.5 m
        apart if there is room.
    """
    rng = np.random.default_rng([seed, 4])
    middle, half = middle_and_half(area)
    placed: list[tuple[float, float, float, float]] = []
    for radius, height in FURNITURE:
        # Objects that block the view stand near the border, as in a real square.
        lowest = 0.0 if height < 1 else 0.3
        clear = 2.5 + 2 * radius
        best, best_gap = np.zeros(2), -np.inf
        for _ in range(30):
            share = rng.uniform(-0.85, 0.85, 2)
            point = middle + share * half
            gaps = [np.hypot(*(point - other[:2])) - other[2] - radius for other in placed]
            if cameras is not None and height > 1:
                gaps += [np.hypot(*(point - camera[:2])) - clear for camera in cameras]
            gap = min(gaps, default=np.inf) if np.abs(share).max() >= lowest else -np.inf
            if gap > best_gap:
                best, best_gap = point, gap
            if gap > 2.5:
                break
        placed.append((float(best[0]), float(best[1]), radius, height))
    return np.array(placed).reshape(-1, 4)


def build_stage(world: World, shadows: str | None = None) -> Stage:
    """Build a square among houses, with trees behind the cameras.

    Args:
        world: its columns become furniture, and houses and trees stay behind its cameras; its seed
            determines sun, weather and colors.
        shadows: "hard" for a clear day, "soft" for thin clouds, None to draw one.

    Returns:
        The stage.

    Raises:
        InvalidInputError: if `shadows` is none of these.
    """
    if shadows not in (None, "hard", "soft"):
        raise InvalidInputError(f"shadows is {quoted(shadows)}; it must be 'hard', 'soft' or None.")
    rng = np.random.default_rng([world.seed, 5])
    hard = rng.uniform() < 0.5 if shadows is None else shadows == "hard"
    bearing, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(38, 58))
    sun = np.array(
        [
            np.cos(bearing) * np.cos(elevation),
            np.sin(bearing) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    middle, half = middle_and_half(world.area)
    outermost = np.abs(world.true_centres[:, :2] - middle).max(0)
    front = np.maximum(half + BUILDING_DISTANCE, outermost + 8.0)
    solids = [solid for column in world.columns for solid in _furniture(rng, column)]
    solids += [solid for place in _tree_places(rng, middle, front) for solid in _tree(rng, place)]
    return Stage(
        middle=middle,
        half=half,
        front=front,
        sun=sun,
        sunlight=0.85 if hard else 0.5,
        skylight=0.52 if hard else 0.78,
        shadow_blur=0.03 if hard else 0.35,
        solids=tuple(solids),
        seed=world.seed,
    )


def _furniture(rng: np.random.Generator, column: np.ndarray) -> list[Solid]:
    """Solids of the furniture that a column of this radius and height represents."""
    place, radius, height = column[:2], float(column[2]), float(column[3])
    if height >= 3.5 or radius < 0.4:
        dark = (0.16, 0.15, 0.15)
        return [
            Cylinder(place, radius, 0.0, height, (0.24, 0.23, 0.22), "bands"),
            Cylinder(place, radius * 1.35, 0.0, 0.25, dark),
            Cylinder(place, radius * 1.35, height - 0.12, height, dark),
        ]
    if height >= 1.5:
        return [
            Cylinder(place, radius, 0.0, height, (0.75, 0.78, 0.8), "posters"),
            Cylinder(place, radius * 1.12, height - 0.3, height, (0.25, 0.32, 0.2)),
            Cylinder(place, radius * 1.08, 0.0, 0.3, (0.3, 0.3, 0.32)),
        ]
    if height > 0.5:
        planter: list[Solid] = [
            Cylinder(place, radius, 0.0, 0.6 * height, (0.42, 0.47, 0.52), "bricks"),
        ]
        for _ in range(9):
            offset = rng.uniform(0, 0.62) * radius * _bearing(rng)
            green = (0.16, 0.36 + rng.uniform(-0.06, 0.08), 0.2 + rng.uniform(-0.04, 0.06))
            center = np.array([*(place + offset), 0.6 * height])
            planter.append(Sphere(center, rng.uniform(0.22, 0.34), green, 0.35))
        return planter
    angle = rng.uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    wood, iron = (0.22, 0.36, 0.52), (0.2, 0.2, 0.2)
    slat = np.array([0.95 * radius, 0.07])
    bench: list[Solid] = [
        Block(place + across * shift, slat, height - 0.05, height, angle, wood)
        for shift in (-0.17, 0.0, 0.17)
    ]
    bench += [
        Block(place + along * side, np.array([0.04, 0.22]), 0.0, height - 0.05, angle, iron)
        for side in (-0.75 * radius, 0.75 * radius)
    ]
    return bench


def _tree_places(rng: np.random.Generator, middle: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Two trees per side, 3 m in front of the houses and behind every camera."""
    places = []
    for axis in (0, 1):
        for side in (-1, 1):
            for share in (-0.45, 0.4):
                place = np.zeros(2)
                place[axis] = side * (front[axis] - 3.0)
                place[1 - axis] = (share + rng.uniform(-0.15, 0.15)) * front[1 - axis]
                places.append(middle + place)
    return np.array(places)


def _tree(rng: np.random.Generator, place: np.ndarray) -> list[Solid]:
    trunk = rng.uniform(1.9, 2.6)
    tree: list[Solid] = [Cylinder(place, 0.16, 0.0, trunk + 0.8, (0.2, 0.27, 0.34), "bark")]
    tone = rng.uniform(-0.05, 0.05)
    for _ in range(12):
        shift = np.array([*(rng.uniform(0.2, 1.1) * _bearing(rng)), rng.uniform(0.2, 2.0)])
        green = (0.15, 0.38 + tone + rng.uniform(-0.05, 0.05), 0.24 + tone)
        center = np.array([*place, trunk]) + shift
        tree.append(Sphere(center, rng.uniform(0.7, 1.1), green, 0.5))
    return tree


def _bearing(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])
