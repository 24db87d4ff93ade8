"""Two people do not stand in one place: of tracks that coincide, the better supported one stays.

Cameras that disagree about a person can fall into camps, each with a person of its own in almost
the same place. Boxes that resemble one another bind every camp together, and once tracked, each
confirms itself in the next pass.
"""

import numpy as np
from jaxtyping import Bool, Float

from catfree.evidence.tracking import Trails
from catfree.filters.selection import suppress_by_frame


def alone_in_place(
    trails: Trails,
    evidence: Float[np.ndarray, " node"],
    present: Bool[np.ndarray, " node"],
    radius: float,
) -> Bool[np.ndarray, " node"]:
    """Which people are there without a better supported one in the same place.

    Args:
        trails: the tracks.
        evidence: (M,) log-odds of each of their rows.
        present: (M,) which rows are people; the others take no part.
        radius: smallest distance of two people in H0.

    Returns:
        (M,) bool, false where `present` is; a track is supported by its rows together.
    """
    if not present.any():
        return present
    support = np.bincount(trails.track, np.where(present, evidence, 0.0))
    return suppress_by_frame(
        trails.frame, trails.mean[:, :2], support[trails.track][:, None], present, radius
    )
