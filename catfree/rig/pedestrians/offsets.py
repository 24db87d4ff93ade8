"""Clock offsets of single cameras, found from the same evidence as the rig.

A camera whose clock is off by a few frames agrees best with the others at another shift than zero;
one that is off by many is not placed at all until the right shift is tried.
"""

from dataclasses import replace

import numpy as np

from catfree.errors import CalibrationError
from catfree.rig.pedestrians.camera_model import LOG_FOCAL
from catfree.rig.pedestrians.constants import CalibrationSettings
from catfree.rig.pedestrians.observations import BoxGrid
from catfree.rig.pedestrians.people import RigState, group_people
from catfree.rig.pedestrians.registered import Progress, RegisteredRig, register_cameras
from catfree.rig.pedestrians.registration import vote
from catfree.rig.pedestrians.resection import resect
from catfree.rig.pedestrians.verdict import judge_camera
from catfree.rig.pedestrians.workspace import Workspace
from catfree.types import Detections

TRIED_OFFSETS = 4  # offsets of an unplaced camera that are refined
WIDE_TOLERANCE = 0.05  # share of the range, while people are met at the wrong instant


def remove_offsets(detections: Detections, frame_offset: np.ndarray) -> Detections:
    """Detections on a common clock: each camera's frame numbers less its offset.

    Args:
        detections: (N,) boxes.
        frame_offset: (C,) frames by which each camera's numbers are too high.
    """
    frame = detections.frame - np.asarray(frame_offset, np.int64)[detections.camera]
    return Detections(**(vars(detections) | {"frame": frame}))


def find_offsets(
    work: Workspace, registered: RegisteredRig, maximum: int, report: Progress
) -> tuple[Workspace, RegisteredRig, np.ndarray]:
    """Estimate an integer offset of each camera, correct it, and register again.

    Args:
        work: the sequence on the clocks as given.
        registered: what could be placed on them.
        maximum: largest offset in frames.
        report: progress callback (stage, done, total).

    Returns:
        The corrected sequence, its rig, and (C,) offsets in frame numbers.
    """
    grid, state = work.grid, registered.rig.state
    step = max(1, int(np.median(np.diff(grid.frames))))
    reach = min(maximum // step, grid.frame_count // 3)
    shifts = sorted(range(-reach, reach + 1), key=abs)
    found = np.zeros(grid.camera_count, np.int64)
    for camera in range(grid.camera_count):
        search = _offset_of_placed if state.placed[camera] else _offset_of_unplaced
        found[camera] = search(work, state, camera, shifts)
        report("offsets", camera + 1, grid.camera_count)
    # Only differences can be seen: most cameras keep their clock.
    found -= int(np.median(found[state.placed])) if state.placed.any() else 0
    if not found.any():
        return work, registered, found
    for camera in np.flatnonzero(found):
        grid = grid.shifted(int(camera), -int(found[camera]))
    corrected = Workspace(grid, work.settings)
    try:
        again = register_cameras(corrected, report)
    except CalibrationError:
        return work, registered, np.zeros_like(found)
    before, after = (
        (len(r.verdicts), sum(v.margin for v in r.verdicts.values())) for r in (registered, again)
    )
    if after <= before:
        return work, registered, np.zeros_like(found)
    return corrected, again, found * step


def _offset_of_placed(work: Workspace, state: RigState, camera: int, shifts: list[int]) -> int:
    """The shift at which a placed camera agrees best with the others."""
    wide = replace(state, range_tolerance=np.full(len(state.placed), WIDE_TOLERANCE))
    others = group_people(work.grid, wide, work.settings, without=camera).ground
    evidence = [
        judge_camera(
            work, wide, camera, grid=work.grid.shifted(camera, -shift), others=others
        ).judgement.evidence
        for shift in shifts
    ]
    best = int(np.argmax(evidence))
    # The clock as given is the first of the shifts; another one must be clearly better.
    return shifts[best] if evidence[best] > evidence[0] + work.settings.minimum_margin else 0


def _offset_of_unplaced(work: Workspace, state: RigState, camera: int, shifts: list[int]) -> int:
    """The shift at which an unplaced camera can be placed, or 0 if there is none."""
    settings = work.settings
    people = group_people(work.grid, state, settings).ground
    middle = float(np.median(state.parameters[state.placed, LOG_FOCAL]))
    planes = work.planes(camera, middle)
    candidates = []
    for shift in shifts:
        grid = work.grid.shifted(camera, -shift)
        sample = _thinned(grid, settings)
        fused = group_people(sample, state, settings).ground
        for plane in planes:
            own = work.local_map(sample, camera, plane, settings.range_tolerance)
            for placement in vote(fused, own, settings, 1):
                candidates.append((placement.score, shift, placement.place(plane)))
    candidates.sort(key=lambda item: -item[0])
    best = (0.0, 0)
    for _, shift, start in candidates[:TRIED_OFFSETS]:
        grid = work.grid.shifted(camera, -shift)
        parameters = resect(
            grid,
            camera,
            start,
            people,
            settings,
            foot_offset=state.foot_offset,
            log_focal=(middle, settings.focal_log_sd),
        )
        if parameters is None:
            continue
        verdict = judge_camera(
            work,
            state.with_camera(camera, parameters, WIDE_TOLERANCE),
            camera,
            grid=grid,
            others=people,
        )
        if verdict.accepted and verdict.margin > best[0]:
            best = verdict.margin, shift
    return best[1]


def _thinned(grid: BoxGrid, settings: CalibrationSettings) -> BoxGrid:
    """The frames that vote."""
    count = min(grid.frame_count, settings.voting_frames)
    return grid.at_frames(np.linspace(0, grid.frame_count - 1, count).round().astype(int))
