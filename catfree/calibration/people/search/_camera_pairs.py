"""Relative placement of two cameras by their common people."""

from itertools import combinations, product

import numpy as np

from catfree.calibration.people.cameras._camera_model import usual_focal
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._placement import CANDIDATES, vote
from catfree.calibration.people.matching._verdict import judge_camera
from catfree.calibration.people.matching._workspace import Workspace
from catfree.types._annotations import Progress


def rank_pairs(work: Workspace, report: Progress) -> list[tuple[int, int]]:
    """Order the pairs of cameras by the votes for their best placement, most votes first.

    One vote, with the usual focal lengths and the best planes, costs a twentieth of a search.

    Args:
        work: the sequence.
        report: called as `report("pairs", done, total)`.
    """
    cameras, settings = range(work.grid.camera_count), work.settings
    focal = np.log(usual_focal(work.grid.size, settings))
    planes = [work.planes(c, float(focal[c])) for c in cameras]
    maps = [work.local_map(c, planes[c][0]) if len(planes[c]) else None for c in cameras]
    couples, votes = list(combinations(cameras, 2)), {}
    for done, (one, two) in enumerate(couples, start=1):
        target, source = maps[one], maps[two]
        best = [] if target is None or source is None else vote(target, source, settings, 1)
        votes[one, two] = best[0][0] if best else 0.0
        report("pairs", done, len(couples))
    return sorted(couples, key=lambda couple: -votes[couple])


def search_pair(work: Workspace, one: int, two: int) -> RigState | None:
    """Find the best relative placement of two cameras over focal lengths and plane hypotheses.

    Args:
        work: the sequence.
        one: index of the fixed camera, with pan, X and Y zero.
        two: index of the camera to place.

    Returns:
        A rig of the two, placed relative to each other from their single-view planes; None if no
        placement has more evidence than the same boxes at shifted times.
    """
    settings = work.settings
    longest = work.grid.size.max(1)
    states: list[RigState] = []
    for share in settings.focal_shares:
        targets, sources = (
            [
                (plane, work.local_map(c, plane))
                for plane in work.planes(c, float(np.log(share * longest[c])))
            ]
            for c in (one, two)
        )
        for (p, target), (q, source) in product(targets, sources):
            for _, placement in vote(target, source, settings, CANDIDATES):
                parameters = np.full((work.grid.camera_count, 7), np.nan)
                parameters[[one, two]] = p, placement.place(q)
                states.append(RigState(parameters, RANGE_ERRORS[0]))
    margins = [judge_camera(work, work.scoring, state, two).margin for state in states]
    best = int(np.argmax([0.0, *margins]))
    return states[best - 1] if best else None
