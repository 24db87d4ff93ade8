"""Body boxes in each camera, and the shares of each body that nearer objects hide."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry.camera import pixels_of_points
from catfree.synthetic._walkers import Walkers
from catfree.types import Rig
from catfree.types._validation import as_rows

NEAREST = 0.5  # meters in front of a camera below which nothing is seen

# A body in units of its height: (across, ahead, up) of points on head, shoulders, hips and hands.
# The shoulder breadth of 0.26 and the other values are common anthropometric proportions.
_UPPER_BODY = np.array(
    [
        *[(0.055 * np.cos(a), 0.055 * np.sin(a), 0.985) for a in np.arange(8) * np.pi / 4],
        (0.0, 0.0, 1.0),
        *[(0.13 * np.cos(a), 0.07 * np.sin(a), 0.80) for a in np.arange(8) * np.pi / 4],
        *[(0.145 * np.cos(a), 0.08 * np.sin(a), 0.47) for a in np.arange(8) * np.pi / 4],
    ]
)
_FOOT_ACROSS = 0.055  # from the middle of the body to a foot's middle
_FOOT_HALF_WIDTH = 0.026
_TOE, _HEEL = 0.105, -0.045  # ahead of the ankle
# In free walking, an ankle swings this far ahead of and behind the body, is lifted this much on its
# way forward, and the rear heel rises this much. A larger swing would make feet slide on the
# ground.
STRIDE_SHARE, LIFT, HEEL_RISE = 0.165, 0.035, 0.045
FREE_SPEED = 1.3  # m/s, above which legs swing fully

# Visibility is sampled on rows and columns of each box.
ROWS, COLUMNS = 16, 4
_HALF_WIDTH = np.interp(np.arange(ROWS) + 0.5, [0, 2, 3, 8, 16], [0.3, 0.35, 0.9, 0.85, 0.6])


@dataclass(frozen=True)
class Silhouettes:
    """M bodies seen by cameras, sorted by camera, then frame, then distance.

    Attributes:
        camera, frame, person: (M,) indices.
        box: (M, 4) x1, y1, x2, y2 in pixels around the whole body, including hidden parts.
        visible: (M, ROWS) share of each row of the box, from head to feet, that the camera sees.
        hidden_by: (M,) the person who hides most of the body, or -1.
    """

    camera: Int[np.ndarray, " m"]
    frame: Int[np.ndarray, " m"]
    person: Int[np.ndarray, " m"]
    box: Float[np.ndarray, "m 4"]
    visible: Float[np.ndarray, "m row"]
    hidden_by: Int[np.ndarray, " m"]


def swing_leg(
    stride: Float[np.ndarray, "*n"], amount: Float[np.ndarray, "*n"], side: int
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Compute the ankle of one leg in the walking cycle, in body heights.

    Args:
        stride: phase of the walking cycle in radians.
        amount: how far the legs swing, in [0, 1]; 0 for standing people.
        side: -1 for the left leg, 1 for the right one.

    Returns:
        How far the ankle is ahead of the body, how much it is lifted, and how much the heel rises
        above that.
    """
    ahead = side * STRIDE_SHARE * amount * np.sin(stride)
    lift = LIFT * amount * np.maximum(0, side * np.cos(stride))
    return ahead, lift, HEEL_RISE * np.maximum(0, -ahead / STRIDE_SHARE)


def on_ground(
    body: Float[np.ndarray, "*n k 3"],
    position: Float[np.ndarray, "*n 2"],
    heading: Float[np.ndarray, "*n"],
    height: Float[np.ndarray, "*#n"],
) -> Float[np.ndarray, "*n k 3"]:
    """Place points in body axes (across, ahead and up, in body heights) in the world.

    Args:
        body: (..., K, 3) points of each person.
        position: (..., 2) points where the body axes meet the ground, in meters.
        heading: (...,) directions that the bodies face, in radians from world x.
        height: (...,) heights of the people in meters.
    """
    c, s = np.cos(heading)[..., None], np.sin(heading)[..., None]
    across, ahead, up = np.moveaxis(body * height[..., None, None], -1, 0)
    x = position[..., :1] + across * s + ahead * c
    y = position[..., 1:] - across * c + ahead * s
    return np.stack([x, y, up], -1)


def body_points(
    walkers: Walkers, frame: Int[np.ndarray, " n"], person: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n k 3"]:
    """Compute points (N, K, 3) on each body's outline in meters; the last 8 are heels and toes.

    The legs swing with the walking cycle, so the foot nearest to a camera, which sets the bottom
    of a box, is ahead of the body axis. Real boxes have the same bias.
    """
    at = frame, person
    amount = np.clip(np.linalg.norm(walkers.velocity[at], axis=-1) / FREE_SPEED, 0, 1)
    feet = []
    for side in (-1, 1):
        ankle, lift, rise = swing_leg(walkers.stride[at], amount, side)
        for across in (-_FOOT_HALF_WIDTH, _FOOT_HALF_WIDTH):
            x = np.full_like(ankle, side * _FOOT_ACROSS + across)
            feet.append(np.stack([x, ankle + _HEEL, lift + rise], -1))
            feet.append(np.stack([x, ankle + _TOE, lift], -1))
    upper = np.broadcast_to(_UPPER_BODY, (*amount.shape, *_UPPER_BODY.shape))
    body = np.concatenate([upper, np.stack(feet, -2)], -2)
    return on_ground(body, walkers.position[at], walkers.heading[at], walkers.height[person])


def cast_silhouettes(
    walkers: Walkers, rig: Rig, columns: Float[np.ndarray, "k 4"] | None = None
) -> Silhouettes:
    """Compute the box of each body in every camera, and the parts hidden by people and columns.

    Args:
        walkers: the people.
        rig: true cameras in meters, z up.
        columns: (K, 4) x, y, radius and height in meters of static occluders, or None.

    Returns:
        Every body that is partly inside an image, even if hidden completely.
    """
    # In a long sequence, few of the people are present in a frame.
    frame, person = np.nonzero(walkers.present)
    points = body_points(walkers, frame, person)
    fixed = _column_points(as_rows([] if columns is None else columns, 4, "columns"))
    views = [
        _observe_one(walkers, frame, person, points, fixed, rig, c) for c in range(rig.camera_count)
    ]
    return Silhouettes(
        **{name: np.concatenate([getattr(v, name) for v in views]) for name in vars(views[0])}
    )


def project_points(rig: Rig, camera: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Project world points (..., 3) to pixels (..., 2), and return their depths (...,).

    For lenses other than ideal pinholes, the depth is the distance, negative without an image.
    """
    if not rig.is_ideal:
        flat = points.reshape(-1, 3)
        pixel, imaged = pixels_of_points(rig, camera, flat)
        distance = np.linalg.norm(flat - np.asarray(rig.centers)[camera], axis=-1)
        depth = np.where(imaged, distance, -distance)
        return pixel.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1])
    in_camera = points @ np.asarray(rig.R[camera]).T + np.asarray(rig.t[camera])
    depth = in_camera[..., 2]
    pixel = in_camera @ np.asarray(rig.K[camera]).T
    return pixel[..., :2] / np.maximum(depth, 1e-3)[..., None], depth


def _observe_one(
    walkers: Walkers,
    frame: Int[np.ndarray, " n"],
    person: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "n k 3"],
    fixed: np.ndarray,
    rig: Rig,
    camera: int,
) -> Silhouettes:
    width, height = (int(pixels) for pixels in rig.image_size[camera])
    pixel, depth = project_points(rig, camera, points)
    box = np.concatenate([pixel.min(1), pixel.max(1)], -1)
    in_image = depth.min(1) > NEAREST
    in_image &= (box[..., 2] > 0) & (box[..., 0] < width)
    in_image &= (box[..., 3] > 0) & (box[..., 1] < height)
    axis = np.column_stack([walkers.position[frame, person], walkers.height[person] / 2])
    distance = np.linalg.norm(axis - np.asarray(rig.centers)[camera], axis=-1)
    rows = np.flatnonzero(in_image)
    rows = rows[np.lexsort((distance[rows], frame[rows]))]
    frame, person, box, distance = frame[rows], person[rows], box[rows], distance[rows]
    inside = _inside(box, width, height)
    hidden, hidden_by = _hidden_by_people(frame, person, box)
    column_pixel, column_depth = project_points(rig, camera, fixed)
    for corner, near in zip(column_pixel, column_depth, strict=True):
        if near.min() > NEAREST:
            outline = np.concatenate([corner.min(0), corner.max(0)])
            covered = _covered(box, np.broadcast_to(outline, box.shape), straight=True)
            hidden |= covered & (near.mean() < distance)[:, None, None]
    return Silhouettes(
        camera=np.full(len(frame), camera),
        frame=frame,
        person=person,
        box=box,
        visible=(inside & ~hidden).mean(-1),
        hidden_by=hidden_by,
    )


def _hidden_by_people(
    frame: np.ndarray, person: np.ndarray, box: np.ndarray
) -> tuple[Bool[np.ndarray, "m row column"], Int[np.ndarray, " m"]]:
    """Samples hidden by nearer bodies of the same frame; rows sorted by frame, then distance."""
    count = len(frame)
    hidden = np.zeros((count, ROWS, COLUMNS), bool)
    hidden_by = np.full(count, -1)
    most = np.zeros(count, int)
    per_frame = int(np.bincount(frame).max()) if count else 0
    # For each k, vectorized over all bodies: the body k places before may hide this one.
    for k in range(1, per_frame):
        back = np.flatnonzero(frame[k:] == frame[:-k]) + k
        a, b = box[back], box[back - k]
        meets = (
            (a[:, 0] < b[:, 2]) & (b[:, 0] < a[:, 2]) & (a[:, 1] < b[:, 3]) & (b[:, 1] < a[:, 3])
        )
        back = back[meets]
        covered = _covered(box[back], box[back - k])
        hidden[back] |= covered
        amount = covered.sum((1, 2))
        more = amount > most[back]
        most[back[more]] = amount[more]
        hidden_by[back[more]] = person[back[more] - k]
    return hidden, hidden_by


def _samples(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample positions x (M, ROWS, COLUMNS) and y (M, ROWS) inside the outline of each body."""
    middle, half = (box[:, 0] + box[:, 2]) / 2, (box[:, 2] - box[:, 0]) / 2
    share = ((np.arange(COLUMNS) + 0.5) / COLUMNS * 2 - 1)[None] * _HALF_WIDTH[:, None]
    x = middle[:, None, None] + half[:, None, None] * share
    y = box[:, 1:2] + (np.arange(ROWS) + 0.5) / ROWS * (box[:, 3:] - box[:, 1:2])
    return x, y


def _inside(box: np.ndarray, width: int, height: int) -> Bool[np.ndarray, "m row column"]:
    x, y = _samples(box)
    return (x >= 0) & (x <= width - 1) & ((y >= 0) & (y <= height - 1))[..., None]


def _covered(
    box: np.ndarray, cover: np.ndarray, *, straight: bool = False
) -> Bool[np.ndarray, "m row column"]:
    """Samples of each body inside the outline of the object in front of it."""
    x, y = _samples(box)
    up = (y - cover[:, 1:2]) / (cover[:, 3:] - cover[:, 1:2])
    row = np.clip((up * ROWS).astype(int), 0, ROWS - 1)
    width_share = np.ones_like(up) if straight else _HALF_WIDTH[row]
    half = width_share * (cover[:, 2:3] - cover[:, :1]) / 2
    middle = (cover[:, 0] + cover[:, 2])[:, None, None] / 2
    return (np.abs(x - middle) <= half[..., None]) & ((up >= 0) & (up <= 1))[..., None]


def _column_points(columns: np.ndarray) -> Float[np.ndarray, "k 16 3"]:
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    foot = columns[:, None, :2] + columns[:, None, 2:3] * ring
    up = np.broadcast_to(columns[:, None, 3:4], (len(columns), 8, 1))
    return np.concatenate(
        [np.concatenate([foot, np.zeros_like(up)], -1), np.concatenate([foot, up], -1)], 1
    )
