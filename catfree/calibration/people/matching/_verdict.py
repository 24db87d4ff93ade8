"""Judge whether a camera agrees with the others better than by chance.

A misplaced camera fitted to a dense crowd matches many people, but it matches equally many when its
boxes are shifted in time. A correct camera matches more people at the true time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.calibration.people.matching._group_people import (
    RigState,
    camera_map,
    group_people,
    seen_by_any,
)
from catfree.calibration.people.matching._mutual_nearest import (
    Judgment,
    chance_density,
    judge_candidate,
)
from catfree.calibration.people.matching._workspace import Workspace
from catfree.settings import CalibrationSettings


@dataclass(frozen=True)
class PlacementVerdict:
    """A camera's evidence against the rest of the rig, compared with chance.

    Attributes:
        judgment: at the true time.
        margin: its evidence above the highest at shifted times.
        shortcomings: reasons not to trust the camera, as text.
    """

    judgment: Judgment
    margin: float
    shortcomings: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """True if the camera can be trusted."""
        return not self.shortcomings


def judge_with_chance(
    candidate: GroundMap,
    others: GroundMap,
    others_expected: Bool[np.ndarray, "frame partner"],
    candidate_expected: Bool[np.ndarray, "frame slot"],
    settings: CalibrationSettings,
    shifts: tuple[float, ...],
) -> tuple[Judgment, float]:
    """Judge a camera at the true time and at circularly shifted times.

    Args:
        candidate: (T, N) the camera's map in world coordinates.
        others: (T, M) the map of the other cameras, same frames.
        others_expected: (T, M) whether the camera should see each person of the map.
        candidate_expected: (T, N) whether any other camera should see each person of the camera.
        settings: constants.
        shifts: time shifts for the comparison, as fractions of the sequence.

    Returns:
        The judgment at the true time, and its evidence minus the highest at shifted times.
    """
    density = chance_density(candidate)

    def at_shift(shift: int) -> Judgment:
        return judge_candidate(
            candidate.rolled(shift),
            others,
            density,
            others_expected,
            np.roll(candidate_expected, shift, axis=0),
            settings,
        )

    judgment = at_shift(0)
    frames = len(candidate.xy)
    steps = sorted({round(share * frames) % frames for share in shifts} - {0})
    chance = max((at_shift(step).evidence for step in steps), default=np.inf)
    return judgment, judgment.evidence - chance


def judge_camera(
    work: Workspace,
    state: RigState,
    camera: int,
    *,
    grid: BoxGrid | None = None,
    others: GroundMap | None = None,
) -> PlacementVerdict:
    """Judge a placed camera against the map of the other placed cameras.

    Args:
        work: the sequence.
        state: the rig with the camera.
        camera: index of the camera.
        grid: frames to judge on; all if None.
        others: the map of the other cameras on these frames; computed if None.
    """
    settings = work.settings
    grid = work.grid if grid is None else grid
    rest = state.without_camera(camera)
    if others is None:
        others = group_people(grid, rest, settings).ground
    camera_people = camera_map(grid, camera, state, settings)
    others_expected = seen_by_any(grid, state, np.array([camera]), others, work.smallest, settings)
    own_expected = seen_by_any(
        grid, rest, np.flatnonzero(rest.placed), camera_people, work.smallest, settings
    )
    judgment, margin = judge_with_chance(
        camera_people, others, others_expected, own_expected, settings, settings.chance_shifts
    )
    return PlacementVerdict(judgment, margin, _shortcomings(judgment, margin, settings))


def judge_cameras(work: Workspace, state: RigState) -> dict[int, PlacementVerdict]:
    """Judge every placed camera against the map of the others, on all frames."""
    return {int(c): judge_camera(work, state, int(c)) for c in np.flatnonzero(state.placed)}


def weakest(verdicts: dict[int, PlacementVerdict]) -> int | None:
    """The camera to remove next, if one is not accepted; at least two remain."""
    failing = [c for c, verdict in verdicts.items() if not verdict.accepted]
    if len(verdicts) <= 2:
        return None
    return min(failing, key=lambda c: verdicts[c].margin, default=None)


def _shortcomings(
    judgment: Judgment, margin: float, settings: CalibrationSettings
) -> tuple[str, ...]:
    """List the criteria that a camera fails, as text."""
    needed = max(settings.minimum_margin, settings.minimum_match_margin * judgment.matches)
    reasons = []
    if not judgment.matches > settings.minimum_matches:
        reasons.append(f"{judgment.matches} matches, more than {settings.minimum_matches} needed")
    if not judgment.association > settings.minimum_association:
        reasons.append(
            f"matches {100 * judgment.association:.0f} % of the people that it shares with the "
            f"others, more than {100 * settings.minimum_association:.0f} % needed"
        )
    if not margin > needed:
        reasons.append(f"evidence {margin:.0f} above chance, more than {needed:.0f} needed")
    return tuple(reasons)
