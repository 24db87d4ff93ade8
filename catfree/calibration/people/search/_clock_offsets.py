"""Clock offsets of single cameras from the evidence used to register the rig.

A camera whose clock is off by a few frames agrees best with the others at a nonzero shift; a camera
whose clock is off by many frames can be placed only after its offset is corrected.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS, GroundMap
from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import (
    AdjustedRig,
    judge_refined,
    voted_places,
)
from catfree.calibration.people.search._register_cameras import register_cameras
from catfree.errors import CalibrationError, InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.types import Detections
from catfree.types._annotations import Progress
from catfree.types._sampling import frame_step
from catfree.types._validation import as_integer, require_shape

TRIED_TOGETHER = 16  # placements of an unplaced camera, until one agrees with the others
CLIMB = 2  # shifts tried on either side of the best


def remove_offsets(detections: Detections, frame_offset: ArrayInput) -> Detections:
    """Correct clock offsets: subtract each camera's offset from its frame numbers.

    Args:
        detections: (N,) boxes.
        frame_offset: (C,) frames by which each camera's numbers are too high.

    Returns:
        (N,) the same boxes with corrected frame numbers.

    Raises:
        InvalidInputError: if an offset is not an integer, or a camera with boxes has no offset.
    """
    offset = as_integer(frame_offset, "frame_offset")
    require_shape(offset, (None,), "frame_offset")
    cameras = int(detections.camera.max(initial=-1)) + 1
    if len(offset) < cameras:
        raise InvalidInputError(
            f"frame_offset has {len(offset)} entries, but there are boxes of {cameras} cameras."
        )
    return replace(detections, frame=detections.frame - offset[detections.camera])


def find_offsets(
    work: Workspace, registered: AdjustedRig, maximum: int, report: Progress
) -> tuple[Workspace, AdjustedRig, Int[np.ndarray, " cam"]]:
    """Estimate an integer offset of each camera, correct it, and register again.

    Args:
        work: the sequence with uncorrected clocks.
        registered: the rig registered from it.
        maximum: largest offset in frames.
        report: called as `report(stage, done, total)`.

    Returns:
        The corrected sequence, its rig, and (C,) offsets in frame numbers.
    """
    grid = work.grid
    step = frame_step(grid.frames)
    offset = np.zeros(grid.camera_count, np.int64)
    for done in range(grid.camera_count):
        # One camera at a time, the clearest first, because a wrong clock also distorts the others'
        # fit.
        found = {
            c: _offset_of(work, registered, c, maximum // step)
            for c in np.flatnonzero(offset == 0).tolist()
        }
        report("offsets", done + 1, grid.camera_count)
        camera = max(found, key=lambda c: found[c][0])
        gain, shift = found[camera]
        if gain <= work.settings.minimum_margin:
            break
        corrected = Workspace(work.grid.shifted(camera, -shift), work.settings, work.lenses)
        try:
            proposed = register_cameras(corrected, report)
        except CalibrationError:
            break
        if proposed.quality <= registered.quality:
            break
        work, registered = corrected, proposed
        offset[camera] = shift
    return work, registered, offset * step


def _offset_of(
    work: Workspace, registered: AdjustedRig, camera: int, maximum: int
) -> tuple[float, int]:
    """Gain in evidence, and the shift at which a camera agrees best, at its place or elsewhere."""
    state = registered.state
    if not state.placed[camera]:
        return offset_of_unplaced(work, state, camera, maximum)
    # A wrong clock distorts the others, too.
    rest = replace(state.without_camera(camera), range_tolerance=RANGE_ERRORS[1])
    others = group_people(work.grid, rest, work.settings).ground
    shift, evidence = _climb(work, state, camera, (0, state.parameters[camera]), others, maximum)
    found = evidence[shift] - evidence[0], shift
    if camera == registered.weakest:
        # With a wrong clock, the camera may have been placed where it matches other people.
        margin, shift = offset_of_unplaced(work, state.without_camera(camera), camera, maximum)
        found = max(found, (margin - registered.verdicts[camera].margin, shift))
    return found


def _climb(
    work: Workspace,
    state: RigState,
    camera: int,
    start: tuple[int, Float[np.ndarray, "7"]],
    others: GroundMap,
    maximum: int,
) -> tuple[int, dict[int, float]]:
    """Climb from a shift and a placement to the best shift; return it and all evidence."""
    evidence: dict[int, float] = {}
    (best, place), shifts = start, _shifts(work, maximum)
    while True:
        near = range(best - CLIMB, best + CLIMB + 1)
        untried = [shift for shift in near if shift in shifts and shift not in evidence]
        placements = [(work.grid.shifted(camera, -shift), place) for shift in untried]
        judged = judge_refined(work, state, camera, placements, others)
        evidence |= dict.fromkeys(untried, -np.inf)
        evidence |= {untried[at]: verdict.evidence for at, (_, verdict) in judged.items()}
        top = max(evidence, key=lambda shift: (evidence[shift], -abs(shift)))
        if top == best:
            return best, evidence
        best = top


def offset_of_unplaced(
    work: Workspace, state: RigState, camera: int, maximum: int
) -> tuple[float, int]:
    """Evidence above chance, and the shift at which an unplaced camera fits; zeros if none does.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        maximum: largest shift to try, in instants by which its clock may be too high or too low.
    """
    settings = work.settings
    voters = group_people(work.voting, state, settings).ground
    candidates = []
    for shift in _shifts(work, maximum):
        sample = work.grid.shifted(camera, -shift).thinned(settings.voting_frames)
        places = voted_places(work, state, camera, sample, voters, 1)
        candidates += [(score, shift, place) for score, place in places]
    candidates.sort(key=lambda item: -item[0])
    people = group_people(work.grid, state, settings).ground
    best, margin, found = -np.inf, 0.0, None
    for begin in range(0, len(candidates), TRIED_TOGETHER):
        tried = candidates[begin : begin + TRIED_TOGETHER]
        placements = [(work.grid.shifted(camera, -shift), place) for _, shift, place in tried]
        judged = judge_refined(work, state, camera, placements, people)
        for at, (place, verdict) in judged.items():
            if verdict.accepted and verdict.evidence > best:
                best, margin, found = verdict.evidence, verdict.margin, (tried[at][1], place)
        if best > 0:  # positive: the same people rather than the same places
            break
    if found is None:
        return 0.0, 0
    shift, evidence = _climb(work, state, camera, found, people, maximum)
    return margin + evidence[shift] - best, shift


def _shifts(work: Workspace, maximum: int) -> list[int]:
    """Shifts to try in instants, smallest first; at most a third of the sequence."""
    reach = min(maximum, work.grid.frame_count // 3)
    return sorted(range(-reach, reach + 1), key=abs)
