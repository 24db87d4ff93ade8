"""Judge whether a camera agrees with the others better than by chance.

A misplaced camera fitted to a dense crowd matches many people, but it matches equally many when its
boxes are shifted in time. A correct camera matches more people at the true time.
"""

from dataclasses import dataclass

import numpy as np

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


def judge_camera(
    work: Workspace,
    state: RigState,
    camera: int,
    *,
    grid: BoxGrid | None = None,
    others: GroundMap | None = None,
    shifts: tuple[float, ...] | None = None,
) -> PlacementVerdict:
    """Judge a placed camera against the map of the others, at the true and at shifted times.

    Args:
        work: the sequence.
        state: the rig with the camera.
        camera: index of the camera.
        grid: frames to judge on; all if None.
        others: the map of the other cameras on these frames; computed if None.
        shifts: circular shifts of time to compare with, as fractions of the sequence; those of the
            settings if None.
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
    density = chance_density(camera_people)

    def at_shift(shift: int) -> Judgment:
        return judge_candidate(
            camera_people.rolled(shift),
            others,
            density,
            others_expected,
            np.roll(own_expected, shift, axis=0),
            settings,
        )

    judgment = at_shift(0)
    frames = grid.frame_count
    shares = settings.chance_shifts if shifts is None else shifts
    steps = sorted({round(share * frames) % frames for share in shares} - {0})
    margin = judgment.evidence - max((at_shift(step).evidence for step in steps), default=np.inf)
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
