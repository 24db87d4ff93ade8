"""Place two cameras relative to each other by their common people, and adjust them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._alternate import AdjustedRig, alternate
from catfree.calibration.people.cameras._ground_map import visible
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._mutual_nearest import Judgment, mutual_nearest
from catfree.calibration.people.matching._placement import Placement, align_rigidly, moved_map, vote
from catfree.calibration.people.matching._verdict import judge_with_chance
from catfree.calibration.people.matching._workspace import Workspace

PLACEMENTS_PER_VOTE = 3
SHORTLIST = 30  # placements of a pair compared on few frames
FINALISTS = 6  # of these, placements compared on more frames
ROUNDS = (0.08, 0.05, 0.03)  # range tolerances of the first adjustment


@dataclass(frozen=True)
class PairHypothesis:
    """Two cameras placed relative to each other from their single-view planes.

    Attributes:
        cameras: indices of the two cameras.
        parameters: (2, 7) their parameters, the first with pan, X and Y zero.
        judgment: agreement of their people.
        margin: evidence minus the highest evidence at shifted times.
    """

    cameras: tuple[int, int]
    parameters: Float[np.ndarray, "2 7"]
    judgment: Judgment
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
    placements: list[tuple[Placement, np.ndarray, np.ndarray]] = []
    for share in settings.focal_shares:
        sides = [work.planes(c, float(np.log(share * longest[c]))) for c in (one, two)]
        maps = [
            [work.local_map(work.voting, c, p, settings.range_tolerance) for p in planes]
            for c, planes in zip((one, two), sides, strict=True)
        ]
        for p, target in zip(sides[0], maps[0], strict=True):
            for q, source in zip(sides[1], maps[1], strict=True):
                placements += [
                    (v, p, q) for v in vote(target, source, settings, PLACEMENTS_PER_VOTE)
                ]
    placements.sort(key=lambda item: -item[0].score)
    scored = []
    for placement, p, q in placements[:SHORTLIST]:
        placement = _settle(work, work.quick, one, two, p, q, placement)
        _, margin = _judge_pair(work, work.quick, one, two, p, placement.place(q), (0.5,))
        scored.append((margin, placement, p, q))
    scored.sort(key=lambda item: -item[0])
    best = None
    for _, placement, p, q in scored[:FINALISTS]:
        placement = _settle(work, work.scoring, one, two, p, q, placement)
        moved = placement.place(q)
        judgment, margin = _judge_pair(
            work, work.scoring, one, two, p, moved, settings.chance_shifts[1::2]
        )
        if best is None or margin > best.margin:
            best = PairHypothesis((one, two), np.stack([p, moved]), judgment, margin)
    return best


def _settle(
    work: Workspace,
    grid: BoxGrid,
    one: int,
    two: int,
    p: Float[np.ndarray, "7"],
    q: Float[np.ndarray, "7"],
    placement: Placement,
) -> Placement:
    """Align the second map to the first by iterated closest people."""
    target = work.local_map(grid, one, p, work.settings.range_tolerance)
    source = work.local_map(grid, two, q, work.settings.range_tolerance)
    for _ in range(3):
        moved = moved_map(source, placement)
        time, slot, partner, *_ = mutual_nearest(target, moved, work.settings.match_gate)
        if len(time) < 4:
            return placement
        spread = target.covariance[time, slot] + moved.covariance[time, partner]
        weight = 1 / spread.trace(axis1=1, axis2=2)
        angle, translation = align_rigidly(target.xy[time, slot], source.xy[time, partner], weight)
        placement = Placement(angle, translation, placement.score)
    return placement


def _judge_pair(
    work: Workspace,
    grid: BoxGrid,
    one: int,
    two: int,
    p: Float[np.ndarray, "7"],
    q: Float[np.ndarray, "7"],
    shifts: tuple[float, ...],
) -> tuple[Judgment, float]:
    """Judge whether two placed cameras see the same people; also return the margin over chance."""
    settings = work.settings
    a = work.local_map(grid, one, p, settings.range_tolerance)
    b = work.local_map(grid, two, q, settings.range_tolerance)
    size, smallest, offset = grid.size, work.smallest, settings.foot_offset
    return judge_with_chance(
        b,
        a,
        visible(q, size[two], smallest[two], a.xy, a.height, offset),
        visible(p, size[one], smallest[one], b.xy, b.height, offset),
        settings,
        shifts,
    )


def seed_rig(work: Workspace, pair: PairHypothesis) -> AdjustedRig:
    """Adjust a pair of cameras with separate focal lengths."""
    count = work.grid.camera_count
    parameters = np.full((count, 7), np.nan)
    placed = np.zeros(count, bool)
    for camera, values in zip(pair.cameras, pair.parameters, strict=True):
        parameters[camera], placed[camera] = values, True
    state = RigState(parameters, placed, work.settings.foot_offset, np.full(count, ROUNDS[0]))
    return alternate(work.grid, state, work.settings, shared_focal=False, tolerances=ROUNDS)
