"""The most certain people of the evidence method, as correspondences for bundle adjustment.

Certainty matters more than number: groups with bare support from three cameras are wrong often
enough to hold a wrong camera in place.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.calibration._refinement import CAMERAS
from catfree.methods import evidence
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene

PLACE = 0.2  # body heights: the side of a place, a body's width
SURE = 3.0  # log-odds, from one frame alone, that the person exists


class ConfidentPeople(NamedTuple):
    """Groups of boxes that almost certainly show one person in one frame.

    Attributes:
        member: (P, C) row of the person's detection in each camera, or -1.
        box_sd: (N, 3) standard deviations in pixels of horizontal center, top and bottom of every
            detection; NaN for detections without a group, and for edges cut by the image border.
        height: median height of people in scene units.
        repeats: mean number of groups per track.
        stays: mean number of groups of a track at one place. Box errors of a person who stays in
            place are repeated, not independent.
    """

    member: Int[np.ndarray, "person cam"]
    box_sd: Float[np.ndarray, "n 3"]
    height: float
    repeats: float
    stays: float


def confident_people(
    detections: Detections, scene: Scene, settings: EvidenceSettings
) -> ConfidentPeople:
    """Select the groups of the evidence method to trust: almost certain, and in a track.

    Args:
        detections: (N,) boxes.
        scene: the rig used for grouping; unregistered cameras are ignored.
        settings: settings of the evidence method.

    Returns:
        The groups that are `well_seen`, possibly none.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    # Later rounds, with tracks as priors, add less certain people.
    once = replace(settings, passes=min(settings.passes, 1))
    s = evidence.solve(detections, scene, once, finish=False)
    track = np.full(len(s.groups), -1)
    track[s.trails.group[s.shown]] = s.identity[s.shown]
    chosen = (track >= 0) & well_seen(s.groups.member) & (s.existence.log_odds > SURE)
    member, track, unit = s.groups.member[chosen], track[chosen], float(s.views.unit)
    box = member[member >= 0]
    deviation = np.full((len(detections), 3), np.nan)
    deviation[s.boxes.row[box]] = np.where(
        s.measurements.used[box], s.measurements.noise[box], np.nan
    )
    xy = s.place[chosen, :2] * unit + s.views.origin
    place = np.floor(xy / (PLACE * unit)).astype(np.int64)
    tracks = len(np.unique(track))
    places = len(np.unique(np.column_stack([track, place]), axis=0))
    return ConfidentPeople(
        np.where(member >= 0, s.boxes.row[member], -1),
        deviation,
        unit,
        len(member) / max(tracks, 1),
        len(member) / max(places, 1),
    )


def well_seen(member: Int[np.ndarray, "person cam"]) -> Bool[np.ndarray, " person"]:
    """Mark people seen by at least `CAMERAS` cameras, and by half of those that see anybody."""
    seen = member >= 0
    cameras = int(seen.any(0).sum())
    return seen.sum(1) >= max(CAMERAS, -(-cameras // 2))
