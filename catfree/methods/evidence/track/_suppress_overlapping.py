"""Suppression of overlapping tracks: at each position, the one with most evidence is kept.

Cameras that disagree about a person can split into subsets that place the person at slightly
different positions. Similar boxes hold each subset together, and in the next pass each track
confirms itself.
"""

import numpy as np
from jaxtyping import Bool, Float

from catfree.methods.evidence.track._tracking import Trails
from catfree.methods.paper._select import suppress_by_frame


def suppress_overlapping_tracks(
    trails: Trails,
    evidence: Float[np.ndarray, " node"],
    present: Bool[np.ndarray, " node"],
    radius: float,
) -> Bool[np.ndarray, " node"]:
    """Keep only the best supported person at each position.

    A person seen in the frame takes precedence over one in a gap; then more total evidence of the
    track decides, then the more precise position.

    Args:
        trails: the tracks.
        evidence: (M,) log-odds of each row.
        present: (M,) whether the row is a person; other rows are ignored.
        radius: distance in H0 below which two people overlap; 0 disables the suppression.

    Returns:
        (M,) whether the row is kept; false where `present` is false.
    """
    total = np.bincount(trails.track, np.where(present, evidence, 0.0)).astype(float)
    return one_per_place(trails, total[trails.track], present, radius)


def one_per_place(
    trails: Trails,
    support: Float[np.ndarray, " node"],
    present: Bool[np.ndarray, " node"],
    radius: float,
) -> Bool[np.ndarray, " node"]:
    """Suppress as `suppress_overlapping_tracks`, given the total evidence of each row's track."""
    if radius <= 0 or not present.any():
        return present
    vagueness = np.trace(trails.covariance[:, :2, :2], axis1=1, axis2=2)
    priority = np.column_stack([trails.group >= 0, support, -vagueness])
    return suppress_by_frame(trails.frame, trails.mean[:, :2], priority, present, radius)
