"""Clock offsets of single cameras: the shift in time at which a camera can be placed."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._verdict import PlacementVerdict
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import judge_refined, voted_places
from catfree.errors import InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.types import Detections
from catfree.types._validation import as_integer, require_shape


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


def place_at_a_shift(
    work: Workspace, state: RigState, camera: int, maximum: int
) -> tuple[int, Float[np.ndarray, "7"], PlacementVerdict] | None:
    """Find the shift in time, and the placement, at which a camera has the most evidence.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        maximum: largest shift to try, in instants by which its clock may be too high or too low; at
            most a third of the sequence.

    Returns:
        Shift, parameters (7,) and verdict; None if the evidence is nowhere sufficient.
    """
    settings, reach = work.settings, min(maximum, work.grid.frame_count // 3)
    voters, people = (group_people(g, state, settings).ground for g in (work.voting, work.scoring))
    shifts, placements = [], []
    for shift in range(-reach, reach + 1):
        shifted = work.grid.shifted(camera, -shift)
        voting, scoring = (
            shifted.thinned(count) for count in (settings.voting_frames, settings.scoring_frames)
        )
        votes = voted_places(work, state, camera, voting, voters)
        if votes:
            shifts.append(shift)
            placements.append((scoring, max(votes, key=lambda item: item[0])[1]))
    judged = judge_refined(work, state, camera, placements, people).items()
    found = [(shifts[at], *one) for at, one in judged if one[1].accepted]
    return max(found, key=lambda one: one[2].margin, default=None)
