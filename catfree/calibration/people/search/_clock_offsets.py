"""Clock offsets of single cameras: the shift in time at which a camera can be placed."""

from dataclasses import replace

from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._placement import CANDIDATES
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import judge_refined, voted_places
from catfree.errors import InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.types import Detections
from catfree.types._validation import as_integer, require_shape

TRIED = 16  # placements, of all shifts, to compare by their evidence


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


def offset_of_unplaced(
    work: Workspace, state: RigState, camera: int, maximum: int
) -> tuple[float, int]:
    """Evidence above chance, and the shift at which an unplaced camera fits; zeros if none does.

    Args:
        work: the sequence.
        state: the rig without the camera.
        camera: index of the camera.
        maximum: largest shift to try, in instants by which its clock may be too high or too low; at
            most a third of the sequence.
    """
    settings, reach = work.settings, min(maximum, work.grid.frame_count // 3)
    voters = group_people(work.voting, state, settings).ground
    candidates = []
    for shift in range(-reach, reach + 1):
        sample = work.grid.shifted(camera, -shift).thinned(settings.voting_frames)
        places = voted_places(work, state, camera, sample, voters, CANDIDATES)
        candidates += [(score, shift, place) for score, place in places]
    candidates = sorted(candidates, key=lambda item: -item[0])[:TRIED]
    people = group_people(work.grid, state, settings).ground
    placements = [(work.grid.shifted(camera, -shift), place) for _, shift, place in candidates]
    judged = judge_refined(work, state, camera, placements, people).items()
    found = [(one.margin, candidates[at][1]) for at, (_, one) in judged if one.accepted]
    return max(found, default=(0.0, 0))
