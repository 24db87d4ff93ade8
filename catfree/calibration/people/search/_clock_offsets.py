"""Estimate clock offsets of single cameras from the evidence used to register the rig.

A camera whose clock is off by a few frames agrees best with the others at a nonzero shift; a camera
whose clock is off by many frames can be placed only after its offset is corrected.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
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

TRIED_OFFSETS = 16  # offsets of an unplaced camera that are refined
CLIMB = 2  # shifts tried on either side of the best


def remove_offsets(detections: Detections, frame_offset: ArrayInput) -> Detections:
    """Correct clock offsets: subtract each camera's offset from its frame numbers.

    Args:
        detections: (N,) boxes.
        frame_offset: (C,) frames by which each camera's numbers are too high.

    Returns:
        (N,) the same boxes with corrected frame numbers.

    Raises:
        InvalidInputError: if an offset is not a whole number, or a camera with boxes has none.
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
        state = registered.state
        # One camera at a time, the clearest first: a wrong clock also distorts the fit of others.
        found = {
            c: (_offset_of_placed if state.placed[c] else offset_of_unplaced)(
                work, state, c, maximum // step
            )
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


def _offset_of_placed(
    work: Workspace, state: RigState, camera: int, maximum: int
) -> tuple[float, int]:
    """Gain in evidence and shift at which a placed camera agrees best after refitting."""
    # A wrong clock distorts the others, too.
    rest = replace(state.without_camera(camera), range_tolerance=RANGE_ERRORS[1])
    others = group_people(work.grid, rest, work.settings).ground
    evidence: dict[int, float] = {}
    best, shifts = 0, _shifts(work, maximum)
    while True:
        near = range(best - CLIMB, best + CLIMB + 1)
        untried = [shift for shift in near if shift in shifts and shift not in evidence]
        judged = judge_refined(
            work,
            state,
            camera,
            [(work.grid.shifted(camera, -s), state.parameters[camera]) for s in untried],
            others,
        )
        evidence |= dict.fromkeys(untried, -np.inf)
        evidence |= {untried[at]: verdict.evidence for at, (_, verdict) in judged.items()}
        top = max(evidence, key=lambda shift: (evidence[shift], -abs(shift)))
        if top == best:
            return evidence[best] - evidence[0], best
        best = top


def offset_of_unplaced(
    work: Workspace, state: RigState, camera: int, maximum: int
) -> tuple[float, int]:
    """Evidence and shift at which an unplaced camera can be placed; zeros if it cannot.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        maximum: largest shift to try, in instants by which its clock may be too high or too low.
    """
    settings = work.settings
    people = group_people(work.voting, state, settings).ground
    candidates = []
    for shift in _shifts(work, maximum):
        sample = work.grid.shifted(camera, -shift).thinned(settings.voting_frames)
        places = voted_places(work, state, camera, sample, people, 1)
        candidates += [(score, shift, start) for score, start in places]
    tried = sorted(candidates, key=lambda item: -item[0])[:TRIED_OFFSETS]
    judged = judge_refined(
        work,
        state,
        camera,
        [(work.grid.shifted(camera, -shift), start) for _, shift, start in tried],
        group_people(work.grid, state, settings).ground,
    )
    best = (0.0, 0)
    for at, (_, verdict) in judged.items():
        if verdict.accepted and verdict.margin > best[0]:
            best = verdict.margin, tried[at][1]
    return best


def _shifts(work: Workspace, maximum: int) -> list[int]:
    """Shifts to try in instants, the smallest first; at most a third of the sequence."""
    reach = min(maximum, work.grid.frame_count // 3)
    return sorted(range(-reach, reach + 1), key=abs)
