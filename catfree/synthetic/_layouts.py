"""Layouts of simulated cameras: rings, and layouts like those of the public benchmarks.

No real calibration is copied: every layout is drawn from the generic parameters stated here.
World coordinates are meters, z up, ground z = 0, with the evaluation area centered on the origin.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from catfree.errors import InvalidInputError, quoted
from catfree.synthetic._walkers import Area, middle_and_half, seeded
from catfree.types import Lens, Rig, Scene
from catfree.types._scene import metric_scene
from catfree.types._validation import as_count, as_finite, as_integer, as_positive, require_shape

# Self-calibration may try 0.5, 0.7 and 0.9 image widths first. Focal lengths are drawn between
# these bounds and at least 6 % away from each guess, so that no guess is right by chance.
FOCAL_RANGE = (0.53, 0.86)
LONG_FOCAL_RANGE = (0.75, 1.1)  # cameras that watch a long area
ASSUMED_FOCALS = (0.5, 0.7, 0.9)
FOCAL_CLEARANCE = 0.06
FOCAL_SPREAD = 0.05  # relative standard deviation between the cameras of one world
ROLL = 1.0  # degrees, standard deviation: cameras are never mounted perfectly level
SHOP_LENS = (-0.02, 0.004, -0.001, 0.0, 0.0)  # k1 to k4 of a fisheye, and the zero of its row
SCENE_POINT_HEIGHT = 0.9  # meters: cameras look at the middle of people's bodies


@dataclass(frozen=True)
class Layout:
    """Cameras around an evaluation area.

    Attributes:
        name: name of the layout.
        rig: the true cameras in meters, z up.
        area: evaluation area (x_min, x_max, y_min, y_max) in meters.
        fps: frames per second of the footage.
        people: usual number of people in the area.
    """

    name: str
    rig: Rig
    area: Area
    fps: float | int
    people: int

    @property
    def scene(self) -> Scene:
        """The true scene: ground z = 0, metric."""
        return metric_scene(self.rig)


def ring(
    cameras: int = 6,
    *,
    seed: int = 0,
    side: float | int = 16.0,
    height: tuple[float, float] = (4.5, 5.0),
    image_size: tuple[int, int] = (1920, 1080),
    fps: float | int = 5.0,
    people: int = 14,
) -> Layout:
    """Place cameras evenly around a square of `side` meters, all aimed near its middle.

    Args:
        cameras: number of cameras.
        seed: determines all random draws.
        side: length of the area's sides in meters.
        height: range of the cameras' heights in meters.
        image_size: width and height in pixels.
        fps: frames per second.
        people: usual number of people.

    Returns:
        The layout; the cameras stand 1 to 3 m outside the square's inscribed circle.

    Raises:
        InvalidInputError: if a count, a length, a size or the frame rate is invalid.
    """
    cameras = as_count(cameras, "cameras", least=1)
    side, fps = as_positive(side, "side"), as_positive(fps, "fps")
    people = as_count(people, "people", least=0)
    low, high = np.sort(as_finite(height, (2,), "height"))
    size = as_integer(image_size, "image_size")
    require_shape(size, (2,), "image_size")
    width, rows = size.tolist()
    rng = seeded(seed, cameras)
    bearing = 2 * np.pi * (np.arange(cameras) + rng.uniform(-0.2, 0.2, cameras)) / cameras
    bearing = bearing + rng.uniform(0, 2 * np.pi)
    radius = side / 2 + rng.uniform(1.0, 3.0, cameras)
    ground = radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], -1)
    aim = rng.normal(0, side / 16, (cameras, 2))
    center = np.column_stack([ground, rng.uniform(low, high, cameras)])
    focal = width * draw_focals(rng, cameras)
    rig = _aimed_rig(rng, center, aim, (width, rows), focal)
    half = side / 2
    return Layout(f"ring{cameras}", rig, (-half, half, -half, half), fps, people)


def wildtrack_like(seed: int = 0) -> Layout:
    """Place seven cameras around 12 x 36 m, 2 fps; most look at one half of the area.

    Cameras stand 1 to 5 m outside the border at heights of 2.2 to 3.5 m; five look into the
    near half, two along the whole length.

    Args:
        seed: determines all random draws.

    Returns:
        The layout in meters.

    Source: extent, number of cameras and frame rate of WildTrack (Chavdarova et al. 2018).
    """
    rng = seeded(seed, 7)
    area = (-6.0, 6.0, -18.0, 18.0)
    beside = np.array([-1, 1, -1, 1, -1]) * (6 + rng.uniform(1.0, 4.0, 5))
    along = np.linspace(-17, 4, 5) + rng.uniform(-1.5, 1.5, 5)
    ends = np.stack([rng.uniform(-5, 5, 2), [-18, 18] + np.array([-1, 1]) * 3], -1)
    ground = np.concatenate([np.stack([beside, along], -1), ends])
    aim = np.concatenate(
        [
            np.stack([rng.uniform(-3, 3, 5), rng.uniform(-12, -1, 5)], -1),
            np.array([[0.0, -2.0], [0.0, 4.0]]) + rng.normal(0, 1, (2, 2)),
        ]
    )
    center = np.column_stack([ground, rng.uniform(2.2, 3.5, 7)])
    focal = 1920 * draw_focals(rng, 7, LONG_FOCAL_RANGE)
    rig = _aimed_rig(rng, center, aim, (1920, 1080), focal)
    return Layout("wildtrack", rig, area, 2.0, 24)


def multiviewx_like(seed: int = 0) -> Layout:
    """Place six cameras around 16 x 25 m, 2 to 3 m high, aimed at the middle; 2 fps, crowded.

    Args:
        seed: determines all random draws.

    Returns:
        The layout in meters.

    Source: extent, number of cameras and frame rate of MultiviewX (Hou et al. 2020).
    """
    rng = seeded(seed, 16)
    area = (-8.0, 8.0, -12.5, 12.5)
    return _around("multiviewx", rng, area, 6, height=(2.0, 3.0), people=37)


def gmvd_like(seed: int = 0, *, cameras: int = 6) -> Layout:
    """Place six or eight cameras around a 20 x 24 m courtyard, 4 to 6 m high, 2 fps.

    Args:
        seed: determines all random draws.
        cameras: number of cameras.

    Returns:
        The layout in meters.

    Source: numbers of cameras of scene 5 of GMVD (Vora et al. 2023), configurations 1 and 2.
    """
    cameras = as_count(cameras, "cameras", least=1)
    rng = seeded(seed, 5, cameras)
    area = (-10.0, 10.0, -12.0, 12.0)
    return _around(f"gmvd{cameras}", rng, area, cameras, height=(4.0, 6.0), people=33)


def shop(seed: int = 0, *, fisheye: bool = True) -> Layout:
    """Place four cameras in the ceiling corners of a shop of 12 x 9 m, 3 m high, 5 fps.

    Args:
        seed: determines all random draws.
        fisheye: whether the lenses are fisheyes of 180 degrees along the rows of 1920 x 1440
            pixels; otherwise they are pinholes of 124 x 115 degrees in the same places, which see
            the same people.

    Returns:
        The layout in meters.
    """
    rng = seeded(seed, 99)
    half = np.array([6.0, 4.5])
    corner = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    aim = 0.35 * corner + rng.normal(0, 0.3, (4, 2))
    center = np.column_stack([corner, np.full(4, 3.0)])
    if fisheye:
        rig = _aimed_rig(rng, center, aim, (1920, 1440), np.full(4, 1920 / np.pi))
        lens, kind = np.tile(SHOP_LENS, (4, 1)), np.full(4, Lens.FISHEYE)
        rig = replace(rig, distortion=lens, lens=kind)
    else:
        rig = _aimed_rig(rng, center, aim, (2400, 2000), np.full(4, 640.0))
    x, y = half - 0.3
    return Layout("shop", rig, (-x, x, -y, y), 5.0, 10)


LAYOUTS: dict[str, Callable[[int], Layout]] = {
    "wildtrack": wildtrack_like,
    "multiviewx": multiviewx_like,
    "gmvd6": lambda seed: gmvd_like(seed, cameras=6),
    "gmvd8": lambda seed: gmvd_like(seed, cameras=8),
}


def make_layout(name: str, seed: int = 0) -> Layout:
    """Make a layout by name.

    Args:
        name: `wildtrack`, `multiviewx`, `gmvd6`, `gmvd8`, or `ringN` with N cameras.
        seed: determines all random draws.

    Returns:
        The layout in meters.

    Raises:
        InvalidInputError: if there is no layout of that name, or the seed is not a whole number, 0
            or more.
    """
    text = name if isinstance(name, str) else ""
    if text in LAYOUTS:
        return LAYOUTS[text](seed)
    count = text.removeprefix("ring")
    if text.startswith("ring") and count.isdecimal() and len(count) < 5 and int(count) >= 2:
        return ring(int(count), seed=seed)
    raise InvalidInputError(
        f"There is no layout {quoted(name)}. Use one of {', '.join(LAYOUTS)}, or ringN with N >= 2."
    )


def draw_focals(
    rng: np.random.Generator, count: int, focal_range: tuple[float, float] = FOCAL_RANGE
) -> Float[np.ndarray, " cam"]:
    """Draw focal lengths in image widths: one level per world, little spread, no usual guess."""

    def clear(focal: np.ndarray) -> np.ndarray:
        ratio = np.abs(np.log(focal[:, None] / np.array(ASSUMED_FOCALS)))
        return np.all(ratio > FOCAL_CLEARANCE, axis=-1)

    def redraw(draw: Callable[[int], np.ndarray], size: int) -> np.ndarray:
        focal = draw(size)
        while not (good := clear(focal)).all():
            focal = np.where(good, focal, draw(size))
        return focal

    low, high = np.log(focal_range)
    level = redraw(lambda size: np.exp(rng.uniform(low, high, size)), 1)
    return redraw(lambda size: level * np.exp(FOCAL_SPREAD * rng.standard_normal(size)), count)


def look_at(
    center: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], roll: float = 0.0
) -> Float[np.ndarray, "3 3"]:
    """Compute the world-to-camera rotation of a camera at `center` looking at `target`, z up.

    Args:
        center: (3,) camera center, meters.
        target: (3,) the point at the image center, meters, not straight below.
        roll: rotation about the viewing axis in radians.

    Returns:
        (3, 3) rotation with OpenCV axes.
    """
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ np.stack([right, down, forward])


def _around(
    name: str,
    rng: np.random.Generator,
    area: Area,
    cameras: int,
    *,
    height: tuple[float, float],
    people: int,
) -> Layout:
    """Place cameras evenly along a rectangle 0.5 to 2.5 m outside the area, at 2 fps."""
    middle, half = middle_and_half(area)
    bearing = 2 * np.pi * (np.arange(cameras) + rng.uniform(-0.25, 0.25, cameras)) / cameras
    direction = np.stack([np.cos(bearing), np.sin(bearing)], -1)
    border = direction / np.abs(direction / half).max(-1, keepdims=True)
    ground = middle + border + direction * rng.uniform(0.5, 2.5, (cameras, 1))
    aim = middle + rng.normal(0, 0.12, (cameras, 2)) * half
    center = np.column_stack([ground, rng.uniform(*height, cameras)])
    rig = _aimed_rig(rng, center, aim, (1920, 1080), 1920 * draw_focals(rng, cameras))
    return Layout(name, rig, area, 2.0, people)


def _aimed_rig(
    rng: np.random.Generator,
    center: Float[np.ndarray, "cam 3"],
    aim: Float[np.ndarray, "cam 2"],
    image_size: tuple[int, int],
    focal: Float[np.ndarray, " cam"],
) -> Rig:
    """Rig of cameras that look at people at `aim`; `focal` in pixels, rolls are drawn."""
    cameras = len(center)
    width, rows = image_size
    K = np.zeros((cameras, 3, 3))
    K[:, 0, 0] = K[:, 1, 1] = focal
    K[:, :, 2] = [(width - 1) / 2, (rows - 1) / 2, 1.0]
    target = np.column_stack([aim, np.full(cameras, SCENE_POINT_HEIGHT)])
    roll = np.deg2rad(ROLL) * rng.standard_normal(cameras)
    R = np.stack([look_at(*view) for view in zip(center, target, roll, strict=True)])
    return Rig(K, R, -np.einsum("cij,cj->ci", R, center), image_size)
