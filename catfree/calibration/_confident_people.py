"""The people whom the evidence method is surest of, as correspondences for a bundle adjustment.

Strictness matters more than number: groups that three cameras barely support are ghosts often
enough to hold a wrong camera where it is.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.methods import evidence
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene


class SurePeople(NamedTuple):
    """Groups of boxes that are one person in one frame beyond doubt.

    Attributes:
        member: (P, C) row of the detections in each camera, or -1.
        box_sd: (N, 3) standard deviations in pixels of horizontal centre, top and bottom of every
            detection, NaN of those in no group.
        height: median height of people in units of the scene.
        repeats: how many of the groups, on average, are one and the same person at other times.
    """

    member: Int[np.ndarray, "person cam"]
    box_sd: Float[np.ndarray, "n 3"]
    height: float
    repeats: float


def sure_people(
    detections: Detections, scene: Scene, settings: EvidenceSettings, *, fewest_views: int = 3
) -> SurePeople:
    """Strict clusters of the evidence method with a rig.

    Args:
        detections: (N,) boxes.
        scene: the rig to group them with; cameras that are not registered see nobody.
        settings: of the evidence method.
        fewest_views: cameras that must see a person, if more than strictness asks for.

    Returns:
        The people, possibly none.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    solution = evidence.solve(detections, scene, settings)
    clusters = evidence.clusters_of(solution)
    sure = clusters.strict() & ((clusters.member >= 0).sum(1) >= fewest_views)
    member, sigma = clusters.member[sure], clusters.sigma[sure]
    deviation = np.full((len(detections), 3), np.nan)
    present = member >= 0
    deviation[member[present]] = sigma[present]
    tracks = len(np.unique(clusters.track[sure]))
    return SurePeople(member, deviation, float(solution.views.unit), len(member) / max(tracks, 1))
