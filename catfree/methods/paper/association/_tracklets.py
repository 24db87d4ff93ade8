"""Short per-camera tracks: boxes of consecutive frames linked by distance and appearance."""

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.methods.paper.association._match_edges import chain_labels, match_edges
from catfree.methods.paper.association._observe import (
    Observations,
    appearance_distance,
)
from catfree.settings import TrackletSettings
from catfree.types._sampling import expand_ranges

PAIR_BLOCK = 65536  # pairs compared together


def link_tracklets(observations: Observations, settings: TrackletSettings) -> Int[np.ndarray, " n"]:
    """Join detections of one camera in consecutive frames into tracklets.

    Each pair of consecutive frames of a camera is one Hungarian problem: as many links as possible
    at the smallest sum of foot displacement, in box heights, and appearance distance.

    Args:
        observations: detections in canonical order.
        settings: gates.

    Returns:
        (N,) tracklet of each observation, numbered from 0 over all cameras; an unlinked detection
        is its own tracklet.

    Source:
        Sec. "Pedestrian observations and ray reliability": "detections are linked into short
        per-camera tracks".
    """
    first, second = _consecutive_pairs(observations)
    predecessor = np.full(len(observations), -1)
    near, cost = _near_pairs(observations, first, second, settings.maximum_shift)
    first, second = first[near], second[near]
    if observations.appearance is not None:
        difference = appearance_distance(observations.appearance, first, second)
        similar = difference <= settings.appearance_threshold
        first, second = first[similar], second[similar]
        cost = cost[similar] + difference[similar]
    chosen = match_edges(observations.cell[first], first, second, cost)
    predecessor[second[chosen]] = first[chosen]
    return chain_labels(predecessor)


def _near_pairs(
    observations: Observations,
    first: Int[np.ndarray, " p"],
    second: Int[np.ndarray, " p"],
    maximum_shift: float,
) -> tuple[Int[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """Select pairs whose feet are near, with their displacement in heights of the smaller box.

    The box height is the person's height, so this is a length in body heights anywhere in the
    image. Box overlap is useless: at two frames per second a walker leaves the previous box.
    Computed in slices: memory grows with the number of near pairs, not of all pairs.
    """
    kept = observations.kept
    foot, height = kept.foot.astype(np.float64), kept.height.astype(np.float64)
    edges, shifts = [np.zeros(0, np.int64)], [np.zeros(0)]
    for begin in range(0, len(first), PAIR_BLOCK):
        i, j = first[begin : begin + PAIR_BLOCK], second[begin : begin + PAIR_BLOCK]
        shift = np.hypot(*(foot[j] - foot[i]).T) / np.minimum(height[i], height[j])
        near = shift <= maximum_shift
        edges.append(begin + np.flatnonzero(near))
        shifts.append(shift[near])
    return np.concatenate(edges), np.concatenate(shifts)


def _consecutive_pairs(
    observations: Observations,
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """All pairs of one camera in frames that are one time step apart."""
    cameras = observations.camera_count
    frame = observations.frame_index
    last = frame == len(observations.frames) - 1
    following: Bool[np.ndarray, " n"] = ~last
    following[~last] = np.diff(observations.time)[frame[~last]] == 1
    cell = np.where(following, observations.cell + cameras, observations.cell)
    start = observations.cell_start[cell]
    stop = np.where(following, observations.cell_start[cell + 1], start)
    return expand_ranges(start, stop)
