"""Growth of a rig from a pair: place further cameras, accept them, and remove harmful ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._alternate import alternate
from catfree.calibration.people.adjustment._people_bundle import BundleResult
from catfree.calibration.people.adjustment._resection import resect
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, PAN, X, Z
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS, GroundMap, map_camera
from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._placement import CANDIDATES, Placement, vote
from catfree.calibration.people.matching._verdict import (
    PlacementVerdict,
    judge_camera,
    judge_cameras,
    weakest,
)
from catfree.calibration.people.matching._workspace import Workspace
from catfree.settings import CalibrationSettings

CHANCE_SHARES = (0.25, 0.5, 0.75)  # of the sequence; shifts of time that leave only chance


@dataclass(frozen=True)
class AdjustedRig:
    """A rig after bundle adjustment, and the agreement of its cameras.

    Attributes:
        state: the rig.
        bundle: the last adjustment.
        verdicts: one per camera.
    """

    state: RigState
    bundle: BundleResult
    verdicts: dict[int, PlacementVerdict]

    @property
    def quality(self) -> tuple[int, float]:
        """Number of trusted cameras, and the sum of their evidence above chance."""
        margins = [verdict.margin for verdict in self.verdicts.values() if verdict.accepted]
        return len(margins), float(sum(margins))


def grow_rig(work: Workspace, rig: AdjustedRig) -> AdjustedRig:
    """Add cameras to a pair as long as their evidence is sufficient.

    Args:
        work: the sequence.
        rig: two cameras.

    Returns:
        The grown rig.
    """
    while not rig.state.placed.all():
        state = rig.state
        for camera in np.flatnonzero(~state.placed):
            found = best_candidate(work, rig.state, int(camera))
            if found is not None:
                state = state.with_camera(int(camera), found[0])
        if state is rig.state:
            break
        grown = fit_rig(work, state)
        if grown is None or grown.quality[0] <= rig.quality[0]:
            break
        rig = grown
    return rig


def fit_rig(work: Workspace, state: RigState) -> AdjustedRig | None:
    """Adjust a rig and remove cameras that the others do not support, worst first.

    Args:
        work: the sequence.
        state: the rig before adjustment.

    Returns:
        The rig of the remaining cameras; at least two remain. None if no two of them see the same
        people.
    """
    while True:
        adjusted = alternate(work.grid, state, work.settings)
        if adjusted is None:
            return None
        state, bundle = adjusted
        verdicts, worst = judge_cameras(work, state)
        if worst is None:
            return AdjustedRig(state, bundle, verdicts)
        state = state.without_camera(worst)


def drop_harmful(work: Workspace, rig: AdjustedRig) -> AdjustedRig:
    """Remove the weakest camera as long as the evidence of the rig rises without it.

    A camera with a wrong clock, or a mirrored one, can match recurring patterns of the crowd (a
    path, a queue) better than chance, but it takes more evidence from the others than it adds.

    Args:
        work: the sequence.
        rig: the rig with all of its cameras.

    Returns:
        The rig of the remaining cameras.
    """
    while len(rig.verdicts) > 2:
        less = fit_rig(work, rig.state.without_camera(weakest(rig.verdicts)))
        if less is None or less.quality[1] <= rig.quality[1]:
            break
        rig = less
    return rig


def best_candidate(
    work: Workspace, state: RigState, camera: int, least: float = 0.0
) -> tuple[Float[np.ndarray, "7"], PlacementVerdict] | None:
    """Find the placement of a camera with the most evidence, if the evidence is sufficient.

    The best of many placements agrees with the others even by chance, so the same search is made
    with the camera's boxes shifted in time: evidence that it then reaches is not sufficient.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        least: margin that the placement must exceed.

    Returns:
        Refined parameters (7,) and verdict, or None.
    """
    voters, people = (
        group_people(g, state, work.settings).ground for g in (work.voting, work.scoring)
    )

    def search(share: float) -> list[tuple[Float[np.ndarray, "7"], PlacementVerdict]]:
        """Refine and judge placements at a shift of time, given as a share of the sequence."""
        voting, scoring = (
            grid.shifted(camera, round(share * grid.frame_count))
            for grid in (work.voting, work.scoring)
        )
        votes = voted_places(work, state, camera, voting, voters)
        placements = [(scoring, start) for start in _distinct(votes, work.settings)[:CANDIDATES]]
        return list(judge_refined(work, state, camera, placements, people).values())

    accepted = [one for one in search(0.0) if one[1].accepted and one[1].margin > least]
    best = max(accepted, key=lambda one: one[1].margin, default=None)
    if best is None:
        return None
    by_chance = (verdict.margin for share in CHANCE_SHARES for _, verdict in search(share))
    return None if any(margin >= best[1].margin for margin in by_chance) else best


def _distinct(
    votes: list[tuple[float, Float[np.ndarray, "7"]]], settings: CalibrationSettings
) -> list[Float[np.ndarray, "7"]]:
    """Placements that are not near a better one, most likely first."""
    kept: list[np.ndarray] = []
    for _, start in sorted(votes, key=lambda item: -item[0]):
        place = Placement(start[PAN], start[X:Z])
        if not any(place.is_near(Placement(o[PAN], o[X:Z]), settings) for o in kept):
            kept.append(start)
    return kept


def voted_places(
    work: Workspace, state: RigState, camera: int, grid: BoxGrid, people: GroundMap
) -> list[tuple[float, Float[np.ndarray, "7"]]]:
    """Find placements of a camera on each of its planes, by votes against the rig's people.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        grid: the boxes that vote.
        people: people of the rig in the same frames.

    Returns:
        Scores and parameters (7,).
    """
    settings, places = work.settings, []
    for plane in work.planes(camera, _expected_focal(state, camera)):
        camera_map = map_camera(grid, camera, plane, settings, RANGE_ERRORS[0])
        votes = vote(people, camera_map, settings, CANDIDATES)
        places += [(score, placement.place(plane)) for score, placement in votes]
    return places


def judge_refined(
    work: Workspace,
    state: RigState,
    camera: int,
    placements: Sequence[tuple[BoxGrid, Float[np.ndarray, "7"]]],
    people: GroundMap,
) -> dict[int, tuple[Float[np.ndarray, "7"], PlacementVerdict]]:
    """Refine placements of a camera against a fixed map of the others' people, and judge them.

    Args:
        work: the sequence.
        state: the rig, with or without the camera.
        camera: index of the camera.
        placements: all boxes and (7,) initial parameters of each placement.
        people: map of the other cameras for the same frames.

    Returns:
        Parameters (7,) and verdict by index of the placement, for those that `resect` refines.
    """
    log_focal = _expected_focal(state, camera)
    refined = resect(camera, placements, people, work.settings, log_focal=log_focal)
    judged = {}
    for at, parameters in refined.items():
        # It is not yet adjusted together with the others.
        fitted = replace(state.with_camera(camera, parameters), range_tolerance=RANGE_ERRORS[1])
        verdict = judge_camera(work, placements[at][0], fitted, camera, others=people)
        judged[at] = parameters, verdict
    return judged


def _expected_focal(state: RigState, camera: int) -> float:
    """Log focal length of a camera or, if it is not placed, the usual one of the others."""
    placed = state.placed
    return float(np.median(state.parameters[camera if placed[camera] else placed, LOG_FOCAL]))
