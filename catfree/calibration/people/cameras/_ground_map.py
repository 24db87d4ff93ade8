"""Maps of the people seen by one camera, on the metric ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    X,
    Z,
    projection,
    rotation,
)
from catfree.geometry._person import ASPECT, NEAREST_DEPTH, box_ends, edges_of, height_at
from catfree.settings import CalibrationSettings

NEAREST = 0.3  # meters; nearer, a person is below the camera
USUAL_RANGE = 5.0  # meters; assumed for a foot out of reach, to compute its person's lean
FARTHEST = 80.0  # meters; beyond, the box of a person is a few pixels in any camera
RANGE_ERRORS = (0.08, 0.05, 0.03, 0.02, 0.01)  # relative; first of a view, last of an adjusted rig


@dataclass(frozen=True)
class GroundMap:
    """Ground positions and heights of the people in each frame, with uncertainties.

    Attributes:
        xy: (T, N, 2) ground positions in meters.
        covariance: (T, N, 2, 2) of the positions in square meters.
        height: (T, N) person heights in meters.
        height_sd: (T, N) standard deviations of the heights in meters.
        valid: (T, N) whether the slot holds a person.
    """

    xy: Float[np.ndarray, "frame slot 2"]
    covariance: Float[np.ndarray, "frame slot 2 2"]
    height: Float[np.ndarray, "frame slot"]
    height_sd: Float[np.ndarray, "frame slot"]
    valid: Bool[np.ndarray, "frame slot"]

    def rolled(self, frames: int) -> "GroundMap":
        """Shift everybody by a number of frames, circularly."""
        return GroundMap(*(np.roll(part, frames, axis=0) for part in vars(self).values()))


def _ground_range(
    parameters: Float[np.ndarray, "7"],
    R: Float[np.ndarray, "3 3"],
    u: Float[np.ndarray, "frame slot"],
    v: Float[np.ndarray, "frame slot"],
    level: float,
) -> tuple[Float[np.ndarray, "frame slot"], Float[np.ndarray, "frame slot 2"]]:
    """Horizontal distance at which a pixel's ray reaches the height `level`, and its heading."""
    focal = np.exp(parameters[LOG_FOCAL])
    direction = (u / focal)[..., None] * R[0] + (v / focal)[..., None] * R[1] + R[2]
    flat = np.linalg.norm(direction[..., :2], axis=-1)
    fall = (level - parameters[Z]) / np.where(direction[..., 2] == 0, 1e-9, direction[..., 2])
    return fall * flat, direction[..., :2] / flat[..., None]


def map_ground(
    parameters: Float[np.ndarray, "7"],
    box: Float[np.ndarray, "frame slot 3"],
    sd: Float[np.ndarray, "frame slot"],
    valid: Bool[np.ndarray, "frame slot"],
    settings: CalibrationSettings,
    *,
    range_tolerance: float,
) -> GroundMap:
    """Locate the people of one camera from their feet and heads.

    The foot row and the head row (with the prior on person height) are two measurements of the
    range. If they disagree, as for a hidden foot, the weight of the foot is reduced.

    Args:
        parameters: (7,) the camera.
        box: (T, N, 3) box center, top row, bottom row in pixels from the image center.
        sd: (T, N) standard deviations of the edges in pixels.
        valid: (T, N) which slots hold a box.
        settings: constants.
        range_tolerance: fraction of the range by which this camera's map may be wrong.

    Returns:
        The map in world coordinates.
    """

    def within_reach(away: Float[np.ndarray, "frame slot"]) -> Bool[np.ndarray, "frame slot"]:
        return valid & (away > NEAREST) & (away < FARTHEST)

    u, top, bottom = np.moveaxis(box, -1, 0)
    R = rotation(parameters)
    mean_height = settings.apparent_height
    # The body axis leans in the image of a tilted or rolled camera: estimate its slope once.
    first, heading = _ground_range(parameters, R, u, bottom, 0.0)
    matrix = projection(parameters)
    rough = parameters[X:Z] + heading * np.where(within_reach(first), first, USUAL_RANGE)[..., None]
    usual = np.concatenate([rough, np.full((*rough.shape[:-1], 1), mean_height)], -1)
    head, foot, _ = box_ends(matrix, usual, parameters[X:Z], 0.0)
    across, rise = foot[..., 0] - head[..., 0], foot[..., 1] - head[..., 1]
    slope = across / np.where(np.abs(rise) > 1, rise, 1.0)
    lean = np.clip(slope, -0.5, 0.5) * (bottom - top) / 2

    foot_range, heading = _ground_range(parameters, R, u + lean, bottom, 0.0)
    foot_next, _ = _ground_range(parameters, R, u + lean, bottom + 1.0, 0.0)
    foot_range_sd = np.abs(foot_next - foot_range) * sd + 0.03
    foot_range = foot_range + settings.foot_offset
    head_range, _ = _ground_range(parameters, R, u - lean, top, mean_height)
    head_next, _ = _ground_range(parameters, R, u - lean, top + 1.0, mean_height)
    taller, _ = _ground_range(parameters, R, u - lean, top, mean_height + settings.person_height_sd)
    head_sd = np.hypot((head_next - head_range) * sd, taller - head_range)
    foot_ok = within_reach(foot_range)
    # The head alone is uninformative if the camera is about at head height.
    head_ok = within_reach(head_range) & (head_sd < 0.5 * np.abs(head_range))
    gap = (foot_range - head_range) ** 2 / (foot_range_sd**2 + head_sd**2)
    both = foot_ok & head_ok
    belief = np.where(both, 1 / (1 + gap / 4) ** 2, 1.0)
    foot_weight = np.where(foot_ok, belief / np.maximum(foot_range_sd, 1e-6) ** 2, 0.0)
    head_weight = np.where(head_ok, 1 / np.maximum(head_sd, 1e-6) ** 2, 0.0)
    total = foot_weight + head_weight
    ok = total > 0
    total = np.where(ok, total, 1.0)
    reach = np.where(
        ok, (foot_weight * foot_range + head_weight * np.where(head_ok, head_range, 0)) / total, 1.0
    )
    reach_variance = 1 / total + (range_tolerance * reach) ** 2 + settings.body_sd**2
    side_variance = (
        (sd * reach / np.exp(parameters[LOG_FOCAL])) ** 2
        + (0.4 * range_tolerance * reach) ** 2
        + settings.body_sd**2
    )
    side = np.stack([-heading[..., 1], heading[..., 0]], -1)
    covariance = (
        reach_variance[..., None, None] * heading[..., :, None] * heading[..., None, :]
        + side_variance[..., None, None] * side[..., :, None] * side[..., None, :]
    )
    xy = parameters[X:Z] + heading * reach[..., None]
    height = height_at(matrix, xy, top)
    # The row moves by gain / depth per unit of height.
    depth = xy @ matrix[2, :2] + matrix[2, 3] + height * matrix[2, 2]
    gain = matrix[1, 2] - top * matrix[2, 2]
    height_sd = np.abs(depth * sd / np.where(np.abs(gain) < 1e-6, 1e-6, gain))
    prior = settings.person_height_sd
    share = prior**2 / (prior**2 + height_sd**2)
    return GroundMap(
        xy=xy,
        covariance=covariance,
        height=mean_height + share * (height - mean_height),
        height_sd=prior * np.sqrt(1 - share),
        valid=ok,
    )


def map_camera(
    grid: BoxGrid,
    camera: int,
    parameters: Float[np.ndarray, "7"],
    settings: CalibrationSettings,
    range_tolerance: float,
) -> GroundMap:
    """Locate the people of one camera of a grid.

    Args:
        grid: boxes of all cameras.
        camera: index of the camera.
        parameters: (7,) the camera.
        settings: constants.
        range_tolerance: as `map_ground`.
    """
    boxes = grid.box[camera], grid.sd[camera], grid.valid[camera]
    return map_ground(parameters, *boxes, settings, range_tolerance=range_tolerance)


def visible(
    parameters: Float[np.ndarray, "7"],
    size: Int[np.ndarray, "2"],
    smallest: float,
    people: GroundMap,
    settings: CalibrationSettings,
) -> Bool[np.ndarray, "frame slot"]:
    """Mark the people wholly inside a camera's image and large enough to be detected.

    Args:
        parameters: (7,) the camera.
        size: (2,) image width and height in pixels.
        smallest: box height in pixels below which the camera hardly detects people.
        people: (T, N) people to check.
        settings: constants.
    """
    person = np.concatenate([people.xy, people.height[..., None]], -1)
    head, foot, depth = box_ends(
        projection(parameters), person, parameters[X:Z], settings.foot_offset
    )
    box = edges_of(head, foot)
    limit = (size - 1) / 2 - settings.border * size[0]
    half_width = ASPECT / 2 * (box[..., 2] - box[..., 1])
    return (
        (depth > NEAREST_DEPTH)
        & (np.abs(box[..., 0]) + half_width < limit[0])
        & (box[..., 1] > -limit[1])
        & (box[..., 2] < limit[1])
        & (box[..., 2] - box[..., 1] > smallest)
    )
