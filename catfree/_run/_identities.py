"""Whom each detection shows, as far as the tracks say."""

import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment

from catfree.types import Fate, Localization, Origin, Scene


def identify_detections(
    localization: Localization, scene: Scene, count: int, *, radius: float
) -> Int[np.ndarray, " n"]:
    """The track that each detection supports.

    In every frame, the positions that were detected are matched one to one to the accepted
    candidates, and each candidate's detections take the identity of its track.

    Args:
        localization: what `localize` returned.
        scene: the scene it was made with.
        count: number of detections it was made from.
        radius: farthest that a track passes from its candidate, in scene units.

    Returns:
        (N,) track ids, -1 for detections that support no track.
    """
    tracks, candidates = localization.tracks, localization.candidates
    identity = np.full(count, -1)
    accepted = np.isin(candidates.fate, (Fate.ACCEPTED, Fate.RECOVERED))
    ground = np.asarray(scene.ground.project(np.asarray(candidates.position, np.float64)))
    for frame in np.unique(tracks.frame):
        rows = np.flatnonzero((tracks.frame == frame) & (tracks.origin == Origin.DETECTED))
        chosen = np.flatnonzero((candidates.frame == frame) & accepted)
        offset = tracks.position[rows, None, :] - ground[None, chosen, :]
        distance = np.linalg.norm(offset, axis=-1)
        gated = np.where(distance <= radius, distance, radius * (1 + len(rows)))
        for row, candidate in zip(*linear_sum_assignment(gated), strict=True):
            if distance[row, candidate] <= radius:
                support = candidates.support[chosen[candidate]]
                identity[support[support >= 0]] = tracks.track_id[rows[row]]
    return identity
