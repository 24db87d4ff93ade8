"""Judgment of whether a camera agrees with the others better than by chance.

A misplaced camera fitted to a dense crowd matches many people, but it matches equally many when its
boxes are shifted in time. A correct camera matches more people at the true time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._ground_map import GroundMap, map_camera, visible
from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._mutual_nearest import chance_density, mutual_nearest
from catfree.calibration.people.matching._workspace import Workspace
from catfree.settings import CalibrationSettings


@dataclass(frozen=True)
class PlacementVerdict:
    """Agreement of a camera's people with a map made without that camera, relative to chance.

    Attributes:
        evidence: log-likelihood ratio of "same people" against "same places, other times".
        association: matched fraction of the people that both sides should see.
        matches: number of matched people.
        margin: evidence minus the highest evidence at shifted times.
        shortcomings: reasons not to trust the camera, as text.
    """

    evidence: float
    association: float
    matches: int
    margin: float
    shortcomings: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """True if the camera can be trusted."""
        return not self.shortcomings


def judge_camera(
    work: Workspace,
    grid: BoxGrid,
    state: RigState,
    camera: int,
    others: GroundMap | None = None,
) -> PlacementVerdict:
    """Judge a placed camera against the map of the others, at the true and at shifted times.

    Args:
        work: the sequence.
        grid: the boxes to judge by.
        state: the rig with the camera.
        camera: index of the camera.
        others: the map of the other cameras; computed if None.
    """
    settings = work.settings
    rest = state.without_camera(camera)
    if others is None:
        others = group_people(grid, rest, settings).ground
    parameters, tolerance = state.parameters[camera], state.range_tolerance
    camera_people = map_camera(grid, camera, parameters, settings, tolerance)

    def seen_by(one: int, people: GroundMap) -> Bool[np.ndarray, "frame person"]:
        """Mark the people that a camera should see."""
        size, smallest = grid.size[one], float(work.smallest[one])
        return visible(state.parameters[one], size, smallest, people, settings)

    others_expected = seen_by(camera, others)
    own_expected = np.any([seen_by(int(c), camera_people) for c in np.flatnonzero(rest.placed)], 0)
    density = chance_density(camera_people)

    def at_shift(shift: int) -> tuple[float, float, int]:
        """Weigh the camera's people against the map of the others; missing people count against it.

        Returns:
            Evidence, association and matches.
        """
        mine = camera_people.rolled(shift)
        time, slot, partner, distance, log_determinant = mutual_nearest(
            mine, others, settings.match_gate
        )
        theirs, own = others_expected & others.valid, np.roll(own_expected, shift, 0) & mine.valid
        missed = int(theirs.sum() - theirs[time, partner].sum())
        unmatched = int(own.sum() - own[time, slot].sum())
        matches = len(time)
        # Maximum likelihood detection rate, within the usual range of detectors.
        rate = 2 * matches / max(1, 2 * matches + missed + unmatched)
        low, high = settings.detection_rates
        rate = min(max(rate, low), high)
        miss = np.log(1 - rate)
        chance = density(mine.xy[time, slot])
        log_ratio = (
            np.log(rate) - distance / 2 - log_determinant / 2 - np.log(2 * np.pi) - np.log(chance)
        )
        # A match less likely than two separate people counts as two separate people.
        evidence = float(np.maximum(log_ratio, 2 * miss).sum() + miss * (missed + unmatched))
        rates = [matches / max(1, matches + count) for count in (missed, unmatched)]
        return evidence, max(rates), matches

    evidence, association, matches = at_shift(0)
    frames = grid.frame_count
    steps = sorted({round(share * frames) % frames for share in settings.chance_shifts} - {0})
    margin = evidence - max((at_shift(step)[0] for step in steps), default=np.inf)
    shortcomings = _shortcomings(association, margin, settings)
    return PlacementVerdict(evidence, association, matches, margin, shortcomings)


def judge_cameras(
    work: Workspace, state: RigState
) -> tuple[dict[int, PlacementVerdict], int | None]:
    """Judge every placed camera against the map of the others, on all frames.

    Returns:
        The verdicts and, if a camera is not accepted, the one to remove next; at least two remain.
    """
    cameras = np.flatnonzero(state.placed).tolist()
    verdicts = {c: judge_camera(work, work.grid, state, c) for c in cameras}
    failing = [c for c in cameras if len(cameras) > 2 and not verdicts[c].accepted]
    return verdicts, min(failing, key=lambda c: verdicts[c].margin, default=None)


def weakest(verdicts: dict[int, PlacementVerdict]) -> int:
    """Return the camera with the least evidence per match."""
    return min(verdicts, key=lambda c: verdicts[c].margin / max(1, verdicts[c].matches))


def _shortcomings(
    association: float, margin: float, settings: CalibrationSettings
) -> tuple[str, ...]:
    """List the criteria that a camera fails, as text."""
    needed = settings.minimum_margin
    reasons = []
    if not association > settings.minimum_association:
        reasons.append(
            f"matches {100 * association:.0f} % of the people that it shares with the "
            f"others, more than {100 * settings.minimum_association:.0f} % needed"
        )
    if not margin > needed:
        reasons.append(f"evidence {margin:.0f} above chance, more than {needed:.0f} needed")
    return tuple(reasons)
