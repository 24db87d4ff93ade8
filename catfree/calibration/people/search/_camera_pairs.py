"""Relative placement of two cameras by their common people."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._placement import Placement, moved_map, vote
from catfree.calibration.people.matching._verdict import judge_camera
from catfree.calibration.people.matching._workspace import Workspace

PLACEMENTS_PER_VOTE = 3  # most likely placements per pair of planes
SHORTLIST = 30  # placements of a pair to compare on few frames
FINALISTS = 6  # of these, placements to compare on more frames


@dataclass(frozen=True)
class PairHypothesis:
    """Two cameras placed relative to each other from their single-view planes.

    Attributes:
        state: a rig of the two, the first with pan, X and Y zero.
        margin: evidence minus the highest evidence at shifted times.
    """

    state: RigState
    margin: float


def search_pair(work: Workspace, one: int, two: int) -> PairHypothesis | None:
    """Find the best relative placement of two cameras over focal lengths and plane hypotheses.

    Args:
        work: the sequence.
        one: index of the fixed camera.
        two: index of the camera to place.

    Returns:
        The pair, or None if no placement has any votes.
    """
    settings = work.settings
    longest = work.grid.size.max(1)
    found: list[tuple[float, Placement, np.ndarray, np.ndarray]] = []

    def pair(p: Float[np.ndarray, "7"], q: Float[np.ndarray, "7"]) -> RigState:
        parameters = np.full((work.grid.camera_count, 7), np.nan)
        parameters[[one, two]] = p, q
        return RigState(parameters, RANGE_ERRORS[0])

    for share in settings.focal_shares:
        targets, sources = (
            [
                (plane, work.local_map(work.voting, c, plane))
                for plane in work.planes(c, float(np.log(share * longest[c])))
            ]
            for c in (one, two)
        )
        for (p, target), (q, source) in product(targets, sources):
            votes = vote(target, source, settings, PLACEMENTS_PER_VOTE)
            found += [(score, placement, p, q) for score, placement in votes]
    for grid, count, shifts in (
        (work.voting, SHORTLIST, (0.5,)),
        (work.scoring, FINALISTS, settings.chance_shifts[1::2]),
    ):
        likeliest = sorted(found, key=lambda item: -item[0])[:count]
        found = []
        for _, placement, p, q in likeliest:
            target, source = (work.local_map(grid, c, own) for c, own in ((one, p), (two, q)))
            verdict = judge_camera(
                work,
                grid,
                pair(p, placement.place(q)),
                two,
                camera_people=moved_map(source, placement),
                others=target,
                shifts=shifts,
            )
            found.append((verdict.margin, placement, p, q))
    if not found:
        return None
    margin, placement, p, q = max(found, key=lambda item: item[0])
    return PairHypothesis(pair(p, placement.place(q)), margin)
