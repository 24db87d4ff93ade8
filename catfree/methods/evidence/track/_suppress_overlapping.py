"""Two people do not stand in one place: of tracks that coincide, the better supported one stays.

Cameras that disagree about a person can fall into camps, each with a person of its own in almost
the same place. Boxes that resemble one another bind every camp together, and once tracked, each
confirms itself in the next pass.
"""

import numpy as np
from jaxtyping import Bool, Float

from catfree.methods.evidence.track._tracking import Trails
from catfree.methods.paper._select import suppress_by_frame


def alone_in_place(
    trails: Trails,
    evidence: Float[np.ndarray, " node"],
    present: Bool[np.ndarray, " node"],
    radius: float,
) -> Bool[np.ndarray, " node"]:
    """Which people are there without a better supported one in the same place.

    Somebody who was seen in a frame stays before somebody in a gap between sightings; among those,
    the one whose track has more evidence in all; among equals, the one whose place is sharper.

    Args:
        trails: the tracks.
        evidence: (M,) log-odds of each of their rows.
        present: (M,) which rows are people; the others take no part.
        radius: distance in H0 up to which two are in one place; 0 keeps everybody.

    Returns:
        (M,) bool, false where `present` is.
    """
    if radius <= 0 or not present.any():
        return present
    support = np.bincount(trails.track, np.where(present, evidence, 0.0))[trails.track]
    vagueness = np.trace(trails.covariance[:, :2, :2], axis1=1, axis2=2)
    priority = np.column_stack([trails.group >= 0, support, -vagueness])
    return suppress_by_frame(trails.frame, trails.mean[:, :2], priority, present, radius)
