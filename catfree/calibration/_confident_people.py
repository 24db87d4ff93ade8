"""The most certain people of the evidence method, as correspondences for a bundle adjustment.

Certainty matters more than number: groups barely supported by three cameras are false often enough
to hold a wrong camera in place.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration._refinement import CAMERAS
from catfree.methods import evidence
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene

PLACE = 0.2  # body heights, the width of a body: the side of a place


class ConfidentPeople(NamedTuple):
    """Groups of boxes that almost certainly show one person in one frame.

    Attributes:
        member: (P, C) row of the person's detection in each camera, or -1.
        box_sd: (N, 3) standard deviations in pixels of horizontal center, top and bottom of every
            detection; NaN for detections without a group.
        height: median height of people in scene units.
        repeats: mean number of groups per track.
        stays: mean number of groups of a track at one place. The errors of boxes of somebody who
            stays are the same, not new ones.
    """

    member: Int[np.ndarray, "person cam"]
    box_sd: Float[np.ndarray, "n 3"]
    height: float
    repeats: float
    stays: float


def confident_people(
    detections: Detections, scene: Scene, settings: EvidenceSettings
) -> ConfidentPeople:
    """Select the strict clusters of the evidence method for a rig.

    Args:
        detections: (N,) boxes.
        scene: the rig used for grouping; unregistered cameras are ignored.
        settings: of the evidence method.

    Returns:
        The groups of `CAMERAS` boxes or more, possibly none.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    # Later rounds, with tracks as priors, add people who are less certain.
    once = replace(settings, passes=min(settings.passes, 1))
    solution = evidence.solve(detections, scene, once, finish=False)
    clusters = evidence.clusters_of(solution)
    is_confident = clusters.strict() & ((clusters.member >= 0).sum(1) >= CAMERAS)
    member, sigma = clusters.member[is_confident], clusters.sigma[is_confident]
    deviation = np.full((len(detections), 3), np.nan)
    present = member >= 0
    deviation[member[present]] = sigma[present]
    unit, track = float(solution.views.unit), clusters.track[is_confident]
    place = np.floor(clusters.ground_xy[is_confident] / (PLACE * unit)).astype(np.int64)
    tracks = len(np.unique(track))
    places = len(np.unique(np.column_stack([track, place]), axis=0))
    return ConfidentPeople(
        member, deviation, unit, len(member) / max(tracks, 1), len(member) / max(places, 1)
    )
