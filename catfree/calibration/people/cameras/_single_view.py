"""Estimate tilt, roll and height of one camera from its own boxes, given a focal length.

A single view cannot separate its focal length from the bias of box bottoms, so several focal
lengths are tried: for each, the ground plane is fitted so that people have realistic heights.
"""

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, TILT, Z, rotation
from catfree.settings import CalibrationSettings
from catfree.types._sampling import evenly_spread

TRIALS = 400  # minimal samples; if half of the boxes are good, all 400 fail with probability e^-53
TOLERANCE = 0.10  # relative to the predicted box height: twice the spread of heights
LARGEST_SAMPLE = 1500  # boxes per fit
FEWEST_BOXES = 12


def fit_planes(
    grid: BoxGrid, camera: int, focal: float, settings: CalibrationSettings
) -> Float[np.ndarray, "plane 7"]:
    """Fit ground planes under one camera on which its boxes have the heights of people.

    People on stairs, on ramps or behind railings do not fit the ground plane, so up to three
    hypotheses are kept: from the lower half of the feet, from the tallest 30 % of the boxes, and
    from all boxes.

    Args:
        grid: all boxes.
        camera: index of the camera.
        focal: focal length in pixels.
        settings: constants.

    Returns:
        (P, 7) camera parameters with pan, X and Y zero, best supported first; (0, 7) if there are
        too few boxes or none fits.
    """
    valid = grid.valid[camera]
    boxes = np.stack(
        [grid.u[camera][valid], grid.top[camera][valid], grid.bottom[camera][valid]], -1
    )
    sd = grid.sd[camera][valid]
    # Repeated boxes of people who stand still count once.
    cells = np.round(boxes / 8).astype(np.int64)
    _, keep = np.unique(cells, axis=0, return_index=True)
    keep = evenly_spread(np.sort(keep), LARGEST_SAMPLE)
    boxes, sd = boxes[keep], sd[keep]
    if len(boxes) < FEWEST_BOXES:
        return np.zeros((0, 7))
    box_height = boxes[:, 2] - boxes[:, 1]
    subsets = (
        boxes[:, 2] >= np.quantile(boxes[:, 2], 0.5),
        box_height >= np.quantile(box_height, 0.7),
        np.ones(len(boxes), bool),
    )
    generator = np.random.default_rng(0)
    fits: list[tuple[float, np.ndarray]] = []
    for chosen in subsets:
        start = _sample_plane(boxes[chosen], focal, settings, generator)
        if start is None:
            continue
        for members in (chosen, np.ones(len(boxes), bool)):
            fitted = _polish(start, boxes[members], sd[members], settings)
            if fitted is None:
                continue
            quality = float(np.mean(1 / (1 + _misfit(fitted, boxes, sd, settings) ** 2)))
            if not any(_same_plane(fitted, other) for _, other in fits):
                fits.append((quality, fitted))
            break
    fits.sort(key=lambda item: -item[0])
    return np.array([plane for _, plane in fits]).reshape(-1, 7)


def _sample_plane(
    boxes: Float[np.ndarray, "n 3"],
    focal: float,
    settings: CalibrationSettings,
    generator: np.random.Generator,
) -> Float[np.ndarray, "7"] | None:
    """RANSAC on box height as a linear function of the foot pixel; its zero is the horizon."""
    if len(boxes) < FEWEST_BOXES:
        return None
    scale = focal
    design = np.stack([boxes[:, 0] / scale, boxes[:, 2] / scale, np.ones(len(boxes))], -1)
    tall = (boxes[:, 2] - boxes[:, 1]) / scale
    triples = generator.integers(0, len(boxes), (TRIALS, 3))
    matrices, values = design[triples], tall[triples]
    good = np.abs(np.linalg.det(matrices)) > 1e-6
    if not good.any():
        return None
    lines = np.linalg.solve(matrices[good], values[good][..., None])[..., 0]
    # Boxes grow downwards, and the camera is neither upside down nor lying on its side.
    lines = lines[(lines[:, 1] > 0.05) & (np.abs(lines[:, 0]) < 0.36 * lines[:, 1])]
    if not len(lines):
        return None
    predicted = np.maximum(lines @ design.T, 1e-3)
    misfit = (tall - predicted) / (TOLERANCE * predicted)
    line = lines[np.argmax((1 / (1 + misfit**2)).sum(1))]
    normal = line / np.linalg.norm(line)
    plane = np.zeros(7)
    plane[LOG_FOCAL] = np.log(focal)
    plane[TILT] = np.arcsin(np.clip(normal[2], -0.99, 0.99))
    plane[ROLL] = np.arctan2(normal[0], normal[1])
    plane[Z] = 1.0
    height = _heights(plane, boxes, 0.0)
    usable = np.isfinite(height) & (height > 0)
    if usable.sum() < FEWEST_BOXES:
        return None
    plane[Z] = settings.apparent_height / np.median(height[usable])
    return plane


def _heights(
    plane: Float[np.ndarray, "7"], boxes: Float[np.ndarray, "n 3"], foot_offset: float
) -> Float[np.ndarray, " n"]:
    """Person heights (n,) that boxes (n, 3) imply over a plane; NaN above the horizon."""
    R, focal = rotation(plane), np.exp(plane[LOG_FOCAL])
    foot = (boxes[:, :1] / focal) * R[0] + (boxes[:, 2:] / focal) * R[1] + R[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = foot * (-plane[Z] / np.where(foot[:, 2] < -1e-3, foot[:, 2], np.nan))[:, None]
    flat = np.linalg.norm(ground[:, :2], axis=-1, keepdims=True)
    ground = ground[:, :2] * (1 + foot_offset / flat)
    base = ground @ R[:, :2].T - plane[Z] * R[:, 2]
    row = boxes[:, 1] / focal
    gain = row * R[2, 2] - R[1, 2]
    return (base[:, 1] - row * base[:, 2]) / np.where(np.abs(gain) < 1e-3, np.nan, gain)


def _misfit(
    plane: Float[np.ndarray, "7"],
    boxes: Float[np.ndarray, "n 3"],
    sd: Float[np.ndarray, " n"],
    settings: CalibrationSettings,
) -> Float[np.ndarray, " n"]:
    """Standardized deviation of implied from expected person heights; 30 where undefined."""
    height = _heights(plane, boxes, settings.foot_offset)
    tall = np.maximum(boxes[:, 2] - boxes[:, 1], 1.0)
    # Both edges change the implied height; the lower one also changes the range.
    spread = np.hypot(settings.person_height_sd, 2.0 * settings.apparent_height * sd / tall)
    misfit = (height - settings.apparent_height) / spread
    return np.where(np.isfinite(misfit), np.clip(misfit, -30, 30), 30.0)


def _polish(
    start: Float[np.ndarray, "7"],
    boxes: Float[np.ndarray, "n 3"],
    sd: Float[np.ndarray, " n"],
    settings: CalibrationSettings,
) -> Float[np.ndarray, "7"] | None:
    """Cauchy least squares on implied person heights over tilt, roll and log camera height."""
    plane = start.copy()
    steps = np.array([1e-4, 1e-4, 1e-4])

    def moved(change: Float[np.ndarray, "3"]) -> Float[np.ndarray, "7"]:
        out = plane.copy()
        out[[TILT, ROLL]] += change[:2]
        out[Z] *= np.exp(change[2])
        return out

    for _ in range(12):
        base = _misfit(plane, boxes, sd, settings)
        weight = 1 / (1 + base**2)
        slope = np.stack(
            [(_misfit(moved(d), boxes, sd, settings) - base) / 1e-4 for d in np.diag(steps)], -1
        )
        slope = np.where(np.abs(slope) < 1e4, slope, 0.0)
        normal = slope.T @ (weight[:, None] * slope) + 1e-6 * np.eye(3)
        target = slope.T @ (weight * base)
        normal[1, 1] += settings.roll_sd**-2
        target[1] += plane[ROLL] * settings.roll_sd**-2
        change = np.clip(-np.linalg.solve(normal, target), -0.2, 0.2)
        plane = moved(change)
        if np.abs(change).max() < 1e-5:
            break
    sensible = 0.8 < plane[Z] < 40 and abs(plane[ROLL]) < 0.6 and -0.3 < plane[TILT] < 1.4
    return plane if sensible else None


def _same_plane(one: Float[np.ndarray, "7"], other: Float[np.ndarray, "7"]) -> bool:
    return bool(
        abs(one[TILT] - other[TILT]) < 0.009
        and abs(one[ROLL] - other[ROLL]) < 0.009
        and abs(np.log(one[Z] / other[Z])) < 0.03
    )
