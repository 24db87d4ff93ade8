"""Linking of accepted positions in consecutive frames into tracks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.methods.paper.association._match_edges import chain_labels, match_edges
from catfree.methods.paper.association._observe import appearance_distance, unit_vectors
from catfree.settings import TrajectorySettings
from catfree.types._sampling import expand_ranges


class Positions(NamedTuple):
    """Positions sorted by frame, one row each; lengths are shares of E.

    Attributes:
        frame_index: (M,) index of the frame.
        ground_xy: (M, 2) position on the ground.
        member: (M, C) supporting observation of each camera, or -1.
        track: (M,) track of each position, or -1.
        origin: (M,) `Origin` values.
    """

    frame_index: Int[np.ndarray, " m"]
    ground_xy: Float[np.ndarray, "m 2"]
    member: Int[np.ndarray, "m cam"]
    track: Int[np.ndarray, " m"]
    origin: Int[np.ndarray, " m"]


def position_appearance(
    appearance: Float[np.ndarray, "n d"], member: Int[np.ndarray, "m cam"]
) -> Float[np.ndarray, "m d"]:
    """Compute the supporting detections' unit mean appearance, (M, D); zero without any."""
    total = np.zeros((len(member), appearance.shape[1]), np.float32)
    for column in member.T:  # one camera at a time bounds the memory
        present = column >= 0
        total[present] += appearance[column[present]]
    return unit_vectors(total)


def link_positions(
    positions: Positions,
    time: Int[np.ndarray, " f"],
    appearance: Float[np.ndarray, "n d"] | None,
    settings: TrajectorySettings,
) -> Int[np.ndarray, " m"]:
    """Link positions of consecutive frames one to one.

    Only positions within the link radius can be linked. Among them the Hungarian algorithm makes as
    many links as possible at the smallest sum of distance / radius + weight x appearance distance.

    Args:
        positions: accepted positions, sorted by frame.
        time: (F,) whole time step of each frame.
        appearance: (N, D) unit vectors of the observations, or None.
        settings: radius and weight.

    Returns:
        (M,) track of each position, numbered from 0 in order of first appearance.

    Source:
        Sec. "Trajectories".
    """
    frame = positions.frame_index
    start = np.searchsorted(frame, np.arange(len(time) + 1))
    following = np.minimum(frame + 1, len(time) - 1)
    consecutive = time[following] - time[frame] == 1
    low = start[following]
    first, second = expand_ranges(low, np.where(consecutive, start[following + 1], low))
    step = positions.ground_xy[second] - positions.ground_xy[first]
    distance = np.hypot(step[:, 0], step[:, 1])
    near: Bool[np.ndarray, " e"] = distance <= settings.link_radius
    first, second = first[near], second[near]
    cost = distance[near] / settings.link_radius
    if appearance is not None and settings.appearance_in_linking:
        position_looks = position_appearance(appearance, positions.member)
        difference = appearance_distance(position_looks, first, second)
        cost = cost + settings.appearance_weight * difference
    chosen = match_edges(frame[first], first, second, cost)
    predecessor = np.full(len(frame), -1)
    predecessor[second[chosen]] = first[chosen]
    return chain_labels(predecessor)


def drop_short(
    track: Int[np.ndarray, " m"],
    ground_xy: Float[np.ndarray, "m 2"],
    settings: TrajectorySettings,
) -> Bool[np.ndarray, " m"]:
    """Mark the positions of tracks that are long enough, and not short and static.

    Args:
        track: (M,) track numbers from 0.
        ground_xy: (M, 2) positions as shares of E.
        settings: minimum length, and the rule for short static tracks.

    Returns:
        (M,) bool.
    """
    length = np.bincount(track)
    keep = length >= settings.minimum_length
    if settings.remove_short_static:
        low = np.full((len(length), 2), np.inf)
        high = np.full((len(length), 2), -np.inf)
        np.minimum.at(low, track, ground_xy)
        np.maximum.at(high, track, ground_xy)
        static = np.linalg.norm(high - low, axis=1) <= settings.static_radius
        keep &= ~(static & (length <= settings.static_length))
    return keep[track]
