"""Tilt, roll and height of one camera from its own boxes, given a focal length.

A single view cannot separate its focal length from the bias of box bottoms, so several focal
lengths are tried: for each, the ground plane is fitted so that people have realistic heights.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, TILT, X, Z, projection
from catfree.geometry._buckets import padded
from catfree.geometry._least_squares import (
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    cauchy,
    minimize,
    robust,
)
from catfree.geometry._person import drop_to_height, height_at, visible_foot
from catfree.settings import CalibrationSettings
from catfree.types._sampling import evenly_spread

TRIALS = 400  # minimal samples; if half of the boxes are good, all 400 fail with probability e^-53
TOLERANCE = 0.10  # of the predicted box height: twice the spread of heights
LARGEST_SAMPLE = 1500  # boxes per fit; fewer are padded to this number
FEWEST_BOXES = 12  # per camera; fewer fit any plane
LARGEST_MISFIT = 30.0  # standard deviations, to which larger misfits are clipped
HEIGHTS = (0.8, 40.0)  # meters; of a camera
TILTS = (-0.3, 1.4)  # radians; of a camera
LARGEST_ROLL = 0.6  # radians; of a camera
SAME_ANGLE = 0.009  # radians; planes that differ by less, and by less than `SAME_HEIGHT`, are one
SAME_HEIGHT = 0.03  # relative; of the camera above the planes
FLATTEST = 1e3  # camera heights; feet farther away are near the horizon


def fit_planes(
    grid: BoxGrid, camera: int, focal: float, settings: CalibrationSettings
) -> Float[np.ndarray, "plane 7"]:
    """Fit ground planes under one camera on which its boxes have people's heights.

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
    boxes, sd = grid.box[camera, valid], grid.sd[camera, valid]
    # Repeated boxes of standing people count once.
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
    start = np.array([_sample_plane(boxes[few], focal, settings, generator) for few in subsets])
    # Both edges change the implied height; the lower one also changes the range.
    by_edges = 2.0 * settings.apparent_height * sd / np.maximum(box_height, 1.0)
    spread = np.hypot(settings.person_height_sd, by_edges)
    with jax.enable_x64(True):
        sample = _Sample(
            padded(boxes, LARGEST_SAMPLE),
            padded(1 / spread, LARGEST_SAMPLE),
            jnp.asarray(settings.apparent_height),
            jnp.asarray(settings.foot_offset),
            jnp.asarray(1 / settings.roll_sd),
        )
        member = padded(np.stack(subsets), len(subsets), LARGEST_SAMPLE)
        planes, quality = map(np.asarray, _polish(jax.device_put(start), member, sample))
    fits: list[tuple[float, np.ndarray]] = []
    for support, plane in zip(quality.tolist(), planes, strict=True):
        if _is_sensible(plane) and not any(_same_plane(plane, other) for _, other in fits):
            fits.append((support, plane))
    fits.sort(key=lambda item: -item[0])
    return np.array([plane for _, plane in fits]).reshape(-1, 7)


def _sample_plane(
    boxes: Float[np.ndarray, "b 3"],
    focal: float,
    settings: CalibrationSettings,
    generator: np.random.Generator,
) -> Float[np.ndarray, "7"]:
    """RANSAC on box height as a linear function of the foot pixel; its zero is the horizon.

    Returns:
        (7,) camera parameters, NaN if there is no such plane.
    """
    nothing = np.full(7, np.nan)
    if len(boxes) < FEWEST_BOXES:
        return nothing
    design = np.stack([boxes[:, 0] / focal, boxes[:, 2] / focal, np.ones(len(boxes))], -1)
    tall = (boxes[:, 2] - boxes[:, 1]) / focal
    triples = generator.integers(0, len(boxes), (TRIALS, 3))
    matrices, values = design[triples], tall[triples]
    good = np.abs(np.linalg.det(matrices)) > 1e-6
    if not good.any():
        return nothing
    lines = np.linalg.solve(matrices[good], values[good][..., None])[..., 0]
    # Boxes grow downward, and the camera is neither upside down nor on its side.
    lines = lines[(lines[:, 1] > 0.05) & (np.abs(lines[:, 0]) < 0.36 * lines[:, 1])]
    if not len(lines):
        return nothing
    # A threaded matrix product would spend more time on synchronization than on multiplication.
    predicted = np.maximum(np.einsum("lk,bk->lb", lines, design), 1e-3)
    misfit = (tall / predicted - 1) / TOLERANCE
    line = lines[np.argmax((1 / (1 + misfit**2)).sum(1))]
    normal = line / np.linalg.norm(line)
    plane = np.zeros(7)
    plane[LOG_FOCAL] = np.log(focal)
    plane[TILT] = np.arcsin(np.clip(normal[2], -0.99, 0.99))
    plane[ROLL] = np.arctan2(normal[0], normal[1])
    # Descent of the line of sight to the foot, and ascent of that to the head.
    fall, rise = design @ normal, normal[1] - (design[:, 1] - tall) * normal[2]
    known = (fall > 1 / FLATTEST) & (rise > 1 / FLATTEST)
    if known.sum() < FEWEST_BOXES:
        return nothing
    in_camera_heights = tall[known] / (fall[known] * rise[known])
    plane[Z] = settings.apparent_height / np.median(in_camera_heights)
    return plane


class _Sample(NamedTuple):
    """Boxes (n, 3) of one camera, their inverse deviations, and the expected people."""

    box: Float[Array, "n 3"]
    precision: Float[Array, " n"]
    height: Float[Array, ""]
    foot_offset: Float[Array, ""]
    roll_precision: Float[Array, ""]


def _height(
    plane: Float[Array, "7"], box: Float[Array, "3"], foot_offset: Float[Array, ""]
) -> Float[Array, ""]:
    """Height of a person that a box implies over a plane; NaN above the horizon."""
    matrix = projection(plane)
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 3]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    inverse = adjugate / (a @ adjugate[0])
    ground = drop_to_height(inverse, box[jnp.array([0, 2])])
    depth = matrix[2, :2] @ ground + matrix[2, 3]
    position = jnp.stack(visible_foot(ground, plane[X:Z], -foot_offset))
    height = height_at(matrix, position, box[1])
    gain = matrix[1, 2] - box[1] * matrix[2, 2]
    known = (depth > 0) & (depth < FLATTEST * plane[Z])
    known &= jnp.abs(gain) * FLATTEST > jnp.exp(plane[LOG_FOCAL])
    return jnp.where(known, height, jnp.nan)


def _misfit(plane: Float[Array, "7"], sample: _Sample) -> Float[Array, " n"]:
    """Standardized deviation of implied from expected person heights; the largest if undefined."""
    height = jax.vmap(_height, (None, 0, None))(plane, sample.box, sample.foot_offset)
    known = jnp.isfinite(height)
    misfit = (jnp.where(known, height, 0) - sample.height) * sample.precision
    misfit = jnp.where(known, jnp.clip(misfit, -LARGEST_MISFIT, LARGEST_MISFIT), LARGEST_MISFIT)
    return jnp.where(sample.precision > 0, misfit, 0)


def _problem(
    unknowns: Unknowns, args: tuple[Float[Array, "0"], tuple[Array, _Sample]]
) -> tuple[Residuals, Residuals]:
    """Residuals of tilt, roll and log camera height (1, 3)."""
    log_focal, sample = args[1]
    misfit = _misfit(_plane(unknowns.view[0], log_focal), sample)
    residuals = Residuals(
        misfit[None, :, None, None], unknowns.view[:, 1] * sample.roll_precision, unknowns.block
    )
    return robust(residuals, partial(cauchy, width=1.0))


def _plane(view: Float[Array, "3"], log_focal: Float[Array, ""]) -> Float[Array, "7"]:
    zero = jnp.zeros_like(log_focal)
    return jnp.stack([log_focal, view[0], view[1], zero, zero, zero, jnp.exp(view[2])])


@jax.jit
def _polish(
    start: Float[Array, "fit 7"], member: Bool[Array, "fit n"], sample: _Sample
) -> tuple[Float[Array, "fit 7"], Float[Array, " fit"]]:
    """Cauchy least squares on implied person heights over tilt, roll and log camera height.

    Returns:
        (F, 7) planes, and (F,) the mean weight of all boxes over each of them.
    """
    solver = SchurLevenbergMarquardt()

    def fit(one: tuple[Array, Array]) -> tuple[Array, Array]:
        start, member = one
        view = jnp.stack([start[TILT], start[ROLL], jnp.log(start[Z])])[None]
        unknowns = Unknowns(view, jnp.zeros((len(member), 0), view.dtype))
        inliers = sample._replace(precision=jnp.where(member, sample.precision, 0))
        args = jnp.zeros(0, view.dtype), (start[LOG_FOCAL], inliers)
        solution = minimize(_problem, unknowns, args, solver).value.view[0]
        plane = _plane(solution, start[LOG_FOCAL])
        weight = 1 / (1 + _misfit(plane, sample) ** 2)
        return plane, jnp.mean(weight, where=sample.precision > 0)

    return jax.lax.map(fit, (start, member))  # each ends when it converges


def _is_sensible(plane: Float[np.ndarray, "7"]) -> bool:
    return bool(
        HEIGHTS[0] < plane[Z] < HEIGHTS[1]
        and TILTS[0] < plane[TILT] < TILTS[1]
        and abs(plane[ROLL]) < LARGEST_ROLL
    )


def _same_plane(one: Float[np.ndarray, "7"], other: Float[np.ndarray, "7"]) -> bool:
    return bool(
        abs(one[TILT] - other[TILT]) < SAME_ANGLE
        and abs(one[ROLL] - other[ROLL]) < SAME_ANGLE
        and abs(np.log(one[Z] / other[Z])) < SAME_HEIGHT
    )
