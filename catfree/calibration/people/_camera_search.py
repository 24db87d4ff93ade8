"""Removal, re-placement or confirmation of cameras of a finished rig, given the others.

Registration judges a camera against maps that are accurate to several percent of the range. Once
the evidence method has refined the other cameras, the same search is far more selective: a missing
camera can be placed, and a misplaced one can be moved.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people._register import Calibration
from catfree.calibration.people.cameras._camera_model import of_rig, scene_of
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.cameras._rig_deviation import shape_deviation
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._verdict import (
    PlacementVerdict,
    judge_camera,
    judge_cameras,
    weakest,
)
from catfree.calibration.people.matching._workspace import Workspace, prepare
from catfree.calibration.people.search._clock_offsets import place_at_a_shift
from catfree.calibration.people.search._growth import best_candidate
from catfree.errors import CalibrationError
from catfree.settings import CalibrationSettings
from catfree.types import Detections, Rig
from catfree.types._sampling import frame_step
from catfree.types._validation import shown_camera


def reconsider(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> Calibration | None:
    """Search every camera's position again, given all others.

    Args:
        calibration: a refined rig.
        detections: (N,) the boxes of the calibration.
        settings: constants.

    Returns:
        The rig with cameras added, or moved to where their evidence is clearly higher; None if no
        camera changes. The uncertainties of changed cameras are NaN until a later refinement.
    """
    work, state = _resume(calibration, detections, settings)
    changed: dict[int, PlacementVerdict] = {}
    for camera in range(len(state.placed)):
        without = state.without_camera(camera)
        if not without.placed.any():
            continue
        least = 0.0
        if state.placed[camera]:
            current = judge_camera(work, work.scoring, state, camera)
            least = current.margin + settings.minimum_margin
        found = best_candidate(work, without, camera, least)
        if found is not None:
            parameters, changed[camera] = found
            state = state.with_camera(camera, parameters)
    return _with_cameras(calibration, state, changed) if changed else None


def without_camera(calibration: Calibration, camera: int) -> Calibration:
    """Unregister a camera, setting its parameters to NaN."""
    return _with_cameras(calibration, _state(calibration.scene.rig).without_camera(camera), {})


def doubtful_cameras(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> list[int]:
    """Find the cameras whose clocks may be wrong: missing ones, and the weakest.

    Args:
        calibration: a refined rig.
        detections: (N,) the boxes it was made from.
        settings: constants.
    """
    work, state = _resume(calibration, detections, settings)
    verdicts, _ = judge_cameras(work, state)
    missing = np.flatnonzero(~state.placed & work.useful).tolist()
    return [*missing, weakest(verdicts)]


def place_late_camera(
    calibration: Calibration,
    detections: Detections,
    camera: int,
    maximum: int,
    settings: CalibrationSettings,
) -> Calibration | None:
    """Place a camera at the clock offset at which it fits the others, if clearly better than now.

    Args:
        calibration: a rig with or without the camera.
        detections: (N,) the boxes of the calibration.
        camera: index of the camera.
        maximum: largest offset to try, in frame numbers.
        settings: constants.

    Returns:
        The rig with the camera, and the offset added to its `frame_offset`; None if the camera fits
        without an offset, or nowhere.
    """
    work, state = _resume(calibration, detections, settings)
    if not work.useful[camera]:
        return None
    step = frame_step(work.grid.frames)
    found = place_at_a_shift(work, state.without_camera(camera), camera, maximum // step)
    if found is None or found[0] == 0:
        return None
    shift, parameters, verdict = found
    if state.placed[camera]:
        current = judge_camera(work, work.scoring, state, camera)
        if verdict.margin <= current.margin + settings.minimum_margin:
            return None
    offset = calibration.frame_offset.copy()
    offset[camera] += shift * step
    placed = _with_cameras(calibration, state.with_camera(camera, parameters), {camera: verdict})
    return replace(placed, frame_offset=offset)


def confirm(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> Calibration:
    """Recompute the evidence of every camera and remove cameras with too little evidence.

    At least two cameras always remain.

    Args:
        calibration: a rig.
        detections: (N,) the boxes it was made from.
        settings: constants.

    Returns:
        The rig; rejected cameras are not registered and hold NaN.
    """
    work, state = _resume(calibration, detections, settings)
    while True:
        verdicts, worst = judge_cameras(work, state)
        if worst is None:
            return _with_cameras(calibration, state, verdicts)
        state = state.without_camera(worst)


def without_vague_cameras(
    calibration: Calibration,
    settings: CalibrationSettings,
    camera_names: Sequence[str] | None = None,
) -> Calibration:
    """Remove cameras whose focal length is poorly determined by their people.

    Args:
        calibration: the rig; a focal length with unknown standard deviation (NaN) is accepted.
        settings: constants.
        camera_names: for error messages.

    Returns:
        The rig; removed cameras are not registered and hold NaN.

    Raises:
        CalibrationError: if fewer than two cameras remain.
    """
    rig = calibration.scene.rig
    deviation = calibration.focal_sd / np.asarray(rig.K)[:, 0, 0]
    vague = np.flatnonzero(rig.registered & (deviation > settings.largest_focal_sd))
    if rig.registered.sum() - len(vague) < 2:
        each = ", ".join(
            f"camera {shown_camera(c, camera_names)} to {100 * deviation[c]:.0f} %"
            for c in vague.tolist()
        )
        raise CalibrationError(
            f"The focal lengths are too uncertain to trust the rig ({each}; "
            f"{100 * settings.largest_focal_sd:.0f} % needed); record longer, or until people have "
            "walked near and far."
        )
    for camera in vague:
        calibration = without_camera(calibration, int(camera))
    return calibration


def _resume(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> tuple[Workspace, RigState]:
    """Convert a finished rig to a rig under construction."""
    rig = calibration.scene.rig
    work = prepare(detections, rig.image_size, settings, None, RadialLenses.of(rig))
    return work, _state(rig)


def _state(rig: Rig) -> RigState:
    return RigState(of_rig(rig), RANGE_ERRORS[-1])


def _with_cameras(
    calibration: Calibration, state: RigState, verdicts: dict[int, PlacementVerdict]
) -> Calibration:
    """Replace the cameras of the calibration and update the evidence in `verdicts`.

    The uncertainties of cameras that were placed or moved become NaN.
    """
    rig = calibration.scene.rig
    kept = (state.parameters == of_rig(rig)).all(1)
    association = np.where(kept, calibration.association_rate, np.nan)
    evidence = np.where(kept, calibration.log_likelihood_ratio, np.nan)
    for camera, verdict in verdicts.items():
        association[camera], evidence[camera] = verdict.association, verdict.margin
    pairs = np.logical_and.outer(kept, kept)[:, None, :, None]
    present = np.logical_and.outer(state.placed, state.placed)[:, None, :, None]
    joint = np.where(pairs, calibration.camera_covariance, np.where(present, np.nan, 0.0))
    scene = scene_of(state.parameters, rig.image_size, RadialLenses.of(rig).k1)
    rig_sd = calibration.scene.rig_sd
    if (kept != (state.placed | rig.registered)).any():
        rig_sd = shape_deviation(state.parameters, joint, state.placed)
    return replace(
        calibration,
        scene=replace(scene, rig_sd=rig_sd),
        association_rate=association,
        log_likelihood_ratio=evidence,
        camera_covariance=joint,
        distortion_sd=np.where(kept, calibration.distortion_sd, np.nan),
        camera_residual=np.where(kept, calibration.camera_residual, np.nan),
        sightings=np.where(kept, calibration.sightings, 0),
    )
