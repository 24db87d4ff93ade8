"""Detect cameras whose clock does not fit a known scene, without labels.

At one instant all cameras see the same people at the same ground positions. If a camera's boxes
agree with those of the other cameras better at another shift of its clock, by more than chance
reaches at all other shifts, its clock is off.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry.camera import rays_of_pixels
from catfree.settings import CalibrationSettings, EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._sampling import frame_step

LONGEST = 60  # instants: largest shift tried in either direction
BOXES = 600  # per camera that are compared, in evenly spread instants
FEWEST_CHANCES = 20  # shifts from which the effect of chance is measured


@dataclass(frozen=True)
class GroundFeet:
    """Ground positions of the boxes of one camera, padded per instant.

    Attributes:
        xy: (T, N, 2) ground coordinates in scene units.
        covariance: (T, N, 3) variance of x, covariance, variance of y.
        valid: (T, N) whether the slot holds a box that stands on the ground.
    """

    xy: Float[np.ndarray, "instant slot 2"]
    covariance: Float[np.ndarray, "instant slot 3"]
    valid: Bool[np.ndarray, "instant slot"]


def find_clock_offsets(detections: Detections, scene: Scene) -> Int[np.ndarray, " cam"]:
    """Estimate by how many frames the frame numbers of each camera are too high.

    Args:
        detections: (N,) boxes of cameras that should be synchronized.
        scene: known cameras and ground.

    Returns:
        (C,) frames to subtract, as `remove_offsets` does; 0 where the clock fits or cannot be
        judged. A camera that started late has a negative number.
    """
    count = scene.rig.camera_count
    found = np.zeros(count, np.int64)
    frames = np.unique(detections.frame)
    known = np.flatnonzero(scene.rig.registered).tolist()
    if len(frames) < 2 or len(known) < 2:
        return found
    step = frame_step(frames)
    instant = (detections.frame - frames[0]) // step
    feet = {c: stand_on_ground(detections, instant, scene, c) for c in known}
    reach = min(LONGEST, int(instant.max()) // 3)
    shifts = np.arange(-reach, reach + 1)
    for _ in known:
        # One camera at a time, the clearest first: its wrong clock also affects the others.
        offers = [
            (*_better_shift(agreement(feet, c, shifts), shifts), c) for c in known if not found[c]
        ]
        gain, shift, camera = max(offers, default=(0.0, 0, 0))
        if gain <= 0:
            break
        found[camera] = shift
        feet[camera] = _shifted(feet[camera], shift)
    return found * step


def stand_on_ground(
    detections: Detections, instant: Int[np.ndarray, " n"], scene: Scene, camera: int
) -> GroundFeet:
    """Project the middle of the lower edge of one camera's boxes to the ground.

    Args:
        detections: (N,) boxes of all cameras.
        instant: (N,) of each box, from 0.
        scene: cameras and ground.
        camera: index of a registered camera.
    """
    length = int(instant.max()) + 1
    rows = np.flatnonzero(detections.camera == camera)
    rows = rows[np.argsort(instant[rows], kind="stable")]
    time = instant[rows]
    slot = np.arange(len(rows)) - np.searchsorted(time, time)
    shape = (length, int(slot.max(initial=0)) + 1)
    feet = GroundFeet(np.zeros((*shape, 2)), np.ones((*shape, 3)), np.zeros(shape, bool))
    if not len(rows):
        return feet
    rig = scene.rig
    ray = rays_of_pixels(rig, camera, detections.foot[rows])
    center = np.asarray(rig.centers[camera], np.float64)
    normal, basis = (np.asarray(v, np.float64) for v in (scene.ground.normal, scene.ground.basis))
    down = ray @ normal
    edge = CalibrationSettings().edge_deviation(np.asarray(detections.height[rows]))
    edge = edge / float(rig.K[camera, 1, 1])
    noise = np.hypot(edge, EvidenceSettings.angular_noise)
    # A ray within its own noise of the horizon has no defined ground point.
    lands = down < -noise
    reach = -float(scene.ground.signed_distance(center)) / np.where(lands, down, -1.0)
    along = ray @ basis
    # Noise across the ray, at its length; along the ground it is stretched by the grazing angle.
    stretch = along[:, :, None] * along[:, None, :] / down[:, None, None] ** 2
    spread = (noise * reach)[:, None, None] ** 2 * (np.eye(2) + stretch)
    feet.xy[time, slot] = (center + reach[:, None] * ray) @ basis
    feet.covariance[time, slot] = spread[:, [0, 0, 1], [0, 1, 1]]
    feet.valid[time, slot] = lands
    return feet


def agreement(
    feet: dict[int, GroundFeet], camera: int, shifts: Int[np.ndarray, " shift"]
) -> Float[np.ndarray, " shift"]:
    """Measure how well a camera's boxes agree with those of the other cameras at shifted times.

    Args:
        feet: ground positions by camera.
        camera: the one whose clock is shifted.
        shifts: instants by which its clock may be too high.

    Returns:
        (S,) mean over its boxes of exp(-d²/2), d the Mahalanobis distance to the nearest box of
        another camera; 0 where none is near, NaN where no box can be compared.
    """
    own = feet[camera]
    others = [feet[c] for c in feet if c != camera]
    xy, covariance, valid = (
        np.concatenate([getattr(one, name) for one in others], axis=1)
        for name in ("xy", "covariance", "valid")
    )
    length = len(valid)
    boxes = own.valid.sum(axis=1)
    peopled = np.flatnonzero(boxes)
    wanted = max(1, int(np.ceil(len(peopled) * BOXES / max(boxes.sum(), 1))))
    chosen = peopled[np.linspace(0, len(peopled) - 1, min(wanted, len(peopled))).astype(int)]
    time, slot = np.nonzero(own.valid[chosen])
    time = chosen[time]
    xy_own, covariance_own = own.xy[time, slot], own.covariance[time, slot]
    scores = np.full(len(shifts), np.nan)
    for at, shift in enumerate(shifts):
        there = time - shift
        kept = np.flatnonzero((there >= 0) & (there < length))
        there = there[kept]
        if not len(kept):
            continue
        dx, dy = np.moveaxis(xy[there] - xy_own[kept, None], -1, 0)
        a, b, c = np.moveaxis(covariance[there] + covariance_own[kept, None], -1, 0)
        distance = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / (a * c - b * b)
        distance = np.where(valid[there], distance, np.inf)
        scores[at] = np.exp(-distance.min(axis=1) / 2).mean()
    return scores


def _better_shift(
    score: Float[np.ndarray, " shift"], shifts: Int[np.ndarray, " shift"]
) -> tuple[float, int]:
    """Return the gain of the best shift over no shift in excess of chance, and that shift.

    Chance is the range of the score at shifts farther from the best one than zero is. Both are 0 if
    there is no gain.
    """
    if not np.isfinite(score).any():
        return 0.0, 0
    best = int(np.nanargmax(score))
    far = np.abs(shifts - shifts[best]) > abs(shifts[best])
    chances = score[far & np.isfinite(score)]
    if shifts[best] == 0 or len(chances) < FEWEST_CHANCES:
        return 0.0, 0
    gain = float(score[best] - score[shifts == 0][0] - np.ptp(chances))
    return max(gain, 0.0), int(shifts[best])


def _shifted(feet: GroundFeet, shift: int) -> GroundFeet:
    """Shift the clock of ground positions by some instants; drop those outside the footage."""
    length = len(feet.valid)
    source = np.arange(length) + shift
    inside = (source >= 0) & (source < length)
    source = np.clip(source, 0, length - 1)
    return GroundFeet(
        feet.xy[source], feet.covariance[source], feet.valid[source] & inside[:, None]
    )
