"""Short per-camera tracks: boxes of consecutive frames joined by overlap, motion and appearance."""

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.association.matching import chain_labels, match_edges
from catfree.association.observations import Observations, appearance_distance, expand_ranges
from catfree.settings import TrackletSettings

PAIR_BLOCK = 65536  # pairs compared together


def link_tracklets(
    observations: Observations, settings: TrackletSettings | None = None
) -> Int[np.ndarray, " n"]:
    """Join detections of one camera in consecutive frames into tracklets.

    Each pair of consecutive frames of a camera is one Hungarian problem, solved twice: first with
    the boxes where they are, then with each box moved by the step that its first link implies.

    Args:
        observations: detections in canonical order.
        settings: gates; the defaults if None.

    Returns:
        (N,) tracklet of each observation, numbered from 0 over all cameras; a detection without a
        partner is a tracklet of its own.

    Source:
        Sec. "Pedestrian observations and ray reliability": "detections are linked into short
        per-camera tracks".
    """
    settings = settings or TrackletSettings()
    first, second = _consecutive_pairs(observations)
    if len(first) == 0:
        return np.arange(len(observations))
    box = observations.box.astype(np.float64)
    motion = np.zeros((len(observations), 4))
    predecessor = np.full(len(observations), -1)
    for _ in range(2):
        edge, cost = _possible_links(box, motion, first, second, settings)
        if observations.appearance is not None:
            difference = appearance_distance(observations.appearance, first[edge], second[edge])
            allowed = difference <= settings.appearance_threshold
            edge, cost = edge[allowed], cost[allowed] + difference[allowed]
        cell = observations.cell[first[edge]]
        chosen = edge[match_edges(cell, first[edge], second[edge], cost)]
        predecessor = np.full(len(observations), -1)
        predecessor[second[chosen]] = first[chosen]
        linked = np.flatnonzero(predecessor >= 0)
        motion = np.zeros_like(motion)
        step = box[linked] - box[predecessor[linked]]
        # The box moves with its foot; its size is kept, since heights flicker.
        motion[linked] = np.stack(
            [(step[:, 0] + step[:, 2]) / 2, step[:, 3], (step[:, 0] + step[:, 2]) / 2, step[:, 3]],
            axis=-1,
        )
    return chain_labels(predecessor)


def _possible_links(
    box: Float[np.ndarray, "n 4"],
    motion: Float[np.ndarray, "n 4"],
    first: Int[np.ndarray, " p"],
    second: Int[np.ndarray, " p"],
    settings: TrackletSettings,
) -> tuple[Int[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """Pairs whose boxes overlap or whose feet are near, and their cost without appearance.

    Worked off in slices: memory grows with what is near, not with all pairs.
    """
    height = box[:, 3] - box[:, 1]
    edges, costs = [np.zeros(0, np.int64)], [np.zeros(0)]
    for begin in range(0, len(first), PAIR_BLOCK):
        i, j = first[begin : begin + PAIR_BLOCK], second[begin : begin + PAIR_BLOCK]
        moved, target = box[i] + motion[i], box[j]
        overlap = box_overlap(moved, target)
        shift = np.hypot(
            (moved[:, 0] + moved[:, 2] - target[:, 0] - target[:, 2]) / 2,
            moved[:, 3] - target[:, 3],
        ) / np.minimum(height[i], height[j])
        near = (overlap >= settings.minimum_overlap) | (shift <= settings.maximum_shift)
        edges.append(begin + np.flatnonzero(near))
        costs.append((1 - overlap[near]) + shift[near])
    return np.concatenate(edges), np.concatenate(costs)


def box_overlap(
    first: Float[np.ndarray, "p 4"], second: Float[np.ndarray, "p 4"]
) -> Float[np.ndarray, " p"]:
    """Intersection over union of pairs of xyxy boxes, (P,)."""
    low = np.maximum(first[:, :2], second[:, :2])
    high = np.minimum(first[:, 2:], second[:, 2:])
    shared = np.prod(np.maximum(high - low, 0), axis=1)
    area = np.prod(first[:, 2:] - first[:, :2], axis=1) + np.prod(
        second[:, 2:] - second[:, :2], axis=1
    )
    return shared / (area - shared)


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
