"""Extension of tracks beyond both ends while the cameras still see the person."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.filters import otsu
from catfree.geometry._buckets import padded_length
from catfree.methods.paper._select import outside_by_frame, suppress_by_frame
from catfree.methods.paper.association._observe import appearance_distance, unit_vectors
from catfree.methods.paper.trajectories._link import Positions, position_appearance
from catfree.settings import TrajectorySettings
from catfree.types import Origin
from catfree.types._sampling import equal_pairs

SAMPLE_BLOCK = 16384  # distances are padded to this times a power of four

Recount = Callable[
    [Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]],
    tuple[Int[np.ndarray, "k cam"], Float[np.ndarray, " k"]],
]


_otsu = jax.jit(otsu)


def appearance_threshold(
    track_looks: Float[np.ndarray, "t d"],
    positions: Positions,
    appearance: Float[np.ndarray, "n d"],
) -> float:
    """Estimate the largest appearance distance between a track and an extension.

    It is Otsu's threshold between the distances of positions to their own track and to the other
    tracks of the same frame. Each distance is to the most similar supporting detection, as in the
    extension.

    Args:
        track_looks: (T, D) mean appearance of each track.
        positions: linked positions, sorted by frame.
        appearance: (N, D) unit vectors of the observations.

    Returns:
        The threshold; inf without distances.

    Source:
        Sec. "Trajectories".
    """
    row, other = equal_pairs(positions.frame_index, positions.frame_index)
    distance = _closest(track_looks, positions.track[other], appearance, positions.member[row])
    length = padded_length(len(distance), SAMPLE_BLOCK)
    sample = np.pad(distance, (0, length - len(distance)), constant_values=np.inf)
    return float(_otsu(sample))


def track_appearance(
    positions: Positions, appearance: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "t d"]:
    """Compute the unit mean appearance of each track, (T, D)."""
    each = position_appearance(appearance, positions.member)
    total = np.zeros((positions.track.max(initial=-1) + 1, each.shape[1]), np.float32)
    np.add.at(total, positions.track, each)
    return unit_vectors(total)


def extend_tracks(
    positions: Positions,
    time: Int[np.ndarray, " f"],
    appearance: Float[np.ndarray, "n d"] | None,
    recount: Recount,
    settings: TrajectorySettings,
    *,
    occupied_radius: float,
) -> tuple[Positions, float | None]:
    """Predict each track beyond its ends, and keep the predictions that detections confirm.

    All tracks are extended together, one step at a time, first forward, then backward. A prediction
    is added if enough cameras support it, no other track is within the suppression radius, and one
    supporting detection looks like the track. A track stops at its first failure.

    Args:
        positions: linked positions, tracks numbered from 0.
        time: (F,) whole time step of each frame.
        appearance: (N, D) unit vectors of the observations, or None.
        recount: maps frame index and ground position to the supporting observation of each camera
            and the weighted support.
        settings: limits of the extension.
        occupied_radius: radius around a person that excludes other tracks, as a share of E.

    Returns:
        The positions with the extensions, sorted by frame, and the appearance threshold used.

    Source:
        Sec. "Trajectories".
    """
    if len(positions.track) == 0:
        return positions, None
    threshold, track_looks = None, None
    if appearance is not None and settings.appearance_in_extension:
        track_looks = track_appearance(positions, appearance)
        threshold = appearance_threshold(track_looks, positions, appearance)
    for direction in (1, -1):
        end_xy, end_time, velocity, moving = _ends(positions, time, direction, settings)
        active = moving
        for step in range(1, settings.extension_frames + 1):
            track = np.flatnonzero(active)
            row, frame = equal_pairs(end_time[track] + direction * step, time)
            track = track[row]
            active = np.zeros_like(active)
            if len(track) == 0:
                break
            xy = end_xy[track] + direction * step * velocity[track]
            member, weight = recount(frame, xy)
            good = (member >= 0).sum(1) >= settings.extension_cameras
            good &= _unoccupied(positions, frame, xy, occupied_radius)
            if track_looks is not None and appearance is not None and threshold is not None:
                good &= _closest(track_looks, track, appearance, member) <= threshold
            # If several tracks reach one place, the best supported track keeps it.
            good = suppress_by_frame(frame, xy, weight[:, None], good, occupied_radius)
            active[track[good]] = True
            positions = Positions(
                np.concatenate([positions.frame_index, frame[good]]),
                np.concatenate([positions.ground_xy, xy[good]]),
                np.concatenate([positions.member, member[good]]),
                np.concatenate([positions.track, track[good]]),
                np.concatenate([positions.origin, np.full(good.sum(), int(Origin.EXTENDED))]),
            )
    order = np.lexsort([positions.track, positions.frame_index])
    return Positions(*(column[order] for column in positions)), threshold


def _ends(
    positions: Positions,
    time: Int[np.ndarray, " f"],
    direction: int,
    settings: TrajectorySettings,
) -> tuple[
    Float[np.ndarray, "t 2"],
    Int[np.ndarray, " t"],
    Float[np.ndarray, "t 2"],
    Bool[np.ndarray, " t"],
]:
    """Last position, its time, velocity per time step, and whether there is one, for each track.

    The velocity is the mean of the last steps at that end, because a single step is mostly noise.
    """
    order = np.lexsort([direction * time[positions.frame_index], positions.track])
    track = positions.track[order]
    count = np.bincount(track)
    last = np.cumsum(count) - 1
    earlier = last - np.minimum(count - 1, settings.velocity_steps)
    when = time[positions.frame_index[order]]
    xy = positions.ground_xy[order]
    span = when[last] - when[earlier]
    moving = span != 0
    velocity = (xy[last] - xy[earlier]) / np.where(moving, span, 1)[:, None]
    return xy[last], when[last], velocity, moving


def _closest(
    track_looks: Float[np.ndarray, "t d"],
    track: Int[np.ndarray, " k"],
    appearance: Float[np.ndarray, "n d"],
    member: Int[np.ndarray, "k cam"],
) -> Float[np.ndarray, " k"]:
    """Appearance distance of each track to its most similar supporting detection; inf if none."""
    closest = np.full(len(track), np.inf, np.float32)
    both = np.concatenate([track_looks, appearance])
    for column in member.T:  # one camera at a time bounds the memory
        row = np.flatnonzero(column >= 0)
        distance = appearance_distance(both, track[row], len(track_looks) + column[row])
        closest[row] = np.minimum(closest[row], distance)
    return closest


def _unoccupied(
    positions: Positions,
    frame: Int[np.ndarray, " k"],
    xy: Float[np.ndarray, "k 2"],
    radius: float,
) -> Bool[np.ndarray, " k"]:
    """Mark the places that are farther than the radius from all positions of the same frame."""
    taken = np.concatenate([np.isin(positions.frame_index, frame), np.zeros(len(frame), bool)])
    tested = np.concatenate([np.zeros(len(positions.track), bool), np.ones(len(frame), bool)])
    return outside_by_frame(
        np.concatenate([positions.frame_index, frame]),
        np.concatenate([positions.ground_xy, xy]),
        taken,
        tested,
        radius,
    )[tested]
