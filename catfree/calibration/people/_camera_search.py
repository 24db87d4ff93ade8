"""Cameras of a finished rig: taken out, placed anew, or confirmed, given the others.

Registration judges a camera against maps that are good to several percent of the range. Once the
evidence method has refined the rest, the same search tells a right place from a wrong one far
better: a missing camera can be found, and one that settled beside its place can be moved.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from catfree.calibration.people._register import Calibration, prepare
from catfree.calibration.people.cameras._camera_model import from_matrices, to_matrices
from catfree.calibration.people.matching._group_people import RigState, group_people
from catfree.calibration.people.matching._verdict import Verdict, judge_camera, judge_cameras
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._clock_offsets import offset_of_unplaced
from catfree.calibration.people.search._growth import accepted_candidates, best_candidate
from catfree.errors import CalibrationError
from catfree.settings import CalibrationSettings
from catfree.types import Detections, Rig, Scene


def reconsider(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> Calibration | None:
    """Search every camera's place anew, given all others.

    Args:
        calibration: a refined rig.
        detections: (N,) the boxes that it came from.
        settings: constants.

    Returns:
        The rig with cameras added, or moved to where their evidence is clearly higher; None if
        every camera stays as it is. Uncertainties of such cameras are those of a later refinement.
    """
    work, state = _resume(calibration, detections, settings)
    changed: dict[int, Verdict] = {}
    for camera in range(len(state.placed)):
        rest = state.without_camera(camera)
        if rest.placed.sum() < 2:
            continue
        best = best_candidate(work, rest, camera, [], calibration.shared_focal)
        if best is None:
            continue
        parameters, verdict = best
        if state.placed[camera]:
            others = group_people(work.scoring, rest, settings).ground
            now = judge_camera(work, state, camera, grid=work.scoring, others=others)
            if verdict.margin < now.margin + settings.minimum_margin:
                continue
        state = state.with_camera(camera, parameters, settings.fine_range_tolerance)
        changed[camera] = verdict
    return _with_cameras(calibration, state, changed, anew=list(changed)) if changed else None


def without_camera(
    calibration: Calibration, camera: int, settings: CalibrationSettings
) -> Calibration:
    """The calibration with a camera flagged as not to be trusted.

    Args:
        calibration: a rig.
        camera: which camera.
        settings: constants.

    Returns:
        The rig in which the camera is not registered and holds NaN.
    """
    return _with_cameras(calibration, _state(calibration, settings).without_camera(camera), {})


def places_for(
    calibration: Calibration, detections: Detections, camera: int, settings: CalibrationSettings
) -> list[Calibration]:
    """The rig with a camera that is missing in it, once for each place that its boxes allow.

    Args:
        calibration: a rig without the camera.
        detections: (N,) the boxes that it came from.
        camera: which camera.
        settings: constants.

    Returns:
        A rig for each place; none if the boxes allow no place.
    """
    work, state = _resume(calibration, detections, settings)
    tolerance = settings.fine_range_tolerance
    return [
        _with_cameras(
            calibration,
            state.with_camera(camera, parameters, tolerance),
            {camera: verdict},
            anew=[camera],
        )
        for parameters, verdict in accepted_candidates(
            work, state, camera, [], calibration.shared_focal
        )
    ]


def offset_for(
    calibration: Calibration,
    detections: Detections,
    camera: int,
    maximum: int,
    settings: CalibrationSettings,
) -> int:
    """The clock offset with which a camera that is missing in a rig can be placed.

    Args:
        calibration: a rig without the camera.
        detections: (N,) the boxes that it came from.
        camera: which camera.
        maximum: largest offset to try in instants.
        settings: constants.

    Returns:
        Frames by which its frame numbers are too high; 0 if it fits nowhere, or as it is.
    """
    work, state = _resume(calibration, detections, settings)
    grid = work.grid
    if grid.valid[camera].sum() <= settings.minimum_matches:
        return 0
    reach = min(maximum, grid.frame_count // 3)
    shifts = sorted(range(-reach, reach + 1), key=abs)
    _, shift = offset_of_unplaced(work, state, camera, shifts)
    return shift * max(1, int(np.median(np.diff(grid.frames))))


def confirm(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> Calibration:
    """The rig with fresh evidence for every camera, and without those that do not stand up to it.

    Fewer than two cameras never remain: the best two stay as they are.

    Args:
        calibration: a rig.
        detections: (N,) the boxes that it came from.
        settings: constants.

    Returns:
        The rig; cameras that fail are not registered and hold NaN.
    """
    work, state = _resume(calibration, detections, settings)
    while True:
        verdicts = judge_cameras(work, state)
        failing = [c for c, verdict in verdicts.items() if not verdict.accepted]
        if not failing or len(verdicts) <= 2:
            return _with_cameras(calibration, state, verdicts)
        state = state.without_camera(min(failing, key=lambda c: verdicts[c].margin))


def without_vague_cameras(
    calibration: Calibration, settings: CalibrationSettings, names: Sequence[str] | None = None
) -> Calibration:
    """The rig without cameras that few people, or people in few places, hardly pin down.

    Args:
        calibration: the rig; a focal length of unknown deviation (NaN) is let pass.
        settings: constants.
        names: of all cameras, for messages.

    Returns:
        The rig; vague cameras are not registered and hold NaN.

    Raises:
        CalibrationError: if fewer than two cameras are known well enough.
    """
    rig = calibration.scene.rig
    deviation = calibration.focal_sd / np.asarray(rig.K)[:, 0, 0]
    vague = np.flatnonzero(rig.registered & (deviation > settings.largest_focal_sd))
    if rig.registered.sum() - len(vague) < 2:
        each = ", ".join(
            f"camera {names[int(c)] if names else c} to {100 * deviation[c]:.0f} %" for c in vague
        )
        raise CalibrationError(
            f"The focal lengths are known too badly to trust the rig ({each}; "
            f"{100 * settings.largest_focal_sd:.0f} % needed). Record longer, or until people have "
            "walked near and far."
        )
    for camera in vague:
        calibration = without_camera(calibration, int(camera), settings)
    return calibration


def _resume(
    calibration: Calibration, detections: Detections, settings: CalibrationSettings
) -> tuple[Workspace, RigState]:
    """A finished rig as a rig under construction."""
    rig = calibration.scene.rig
    names = [str(c) for c in range(rig.camera_count)]
    work = prepare(detections, np.asarray(rig.image_size), settings, names)
    return work, _state(calibration, settings)


def _state(calibration: Calibration, settings: CalibrationSettings) -> RigState:
    """The cameras of a finished rig."""
    rig = calibration.scene.rig
    placed = np.asarray(rig.registered)
    parameters = from_matrices(np.asarray(rig.K), np.asarray(rig.R), np.asarray(rig.t))
    tolerance = np.full(len(placed), settings.fine_range_tolerance)
    parameters = np.where(placed[:, None], parameters, np.nan)
    return RigState(parameters, placed.copy(), calibration.foot_offset, tolerance)


def _with_cameras(
    calibration: Calibration,
    state: RigState,
    verdicts: dict[int, Verdict],
    *,
    anew: Sequence[int] = (),
) -> Calibration:
    """The calibration with the cameras of a state, and the evidence of some of them.

    What was known of the precision of cameras that are placed anew holds no longer.
    """
    size = np.asarray(calibration.scene.rig.image_size)
    K, R, t = to_matrices(state.parameters, size)
    K[~state.placed] = np.nan
    association = np.where(state.placed, calibration.association_rate, np.nan)
    evidence = np.where(state.placed, calibration.log_likelihood_ratio, np.nan)
    for camera, verdict in verdicts.items():
        association[camera] = verdict.judgement.association
        evidence[camera] = verdict.margin
    kept = state.placed & ~np.isin(np.arange(len(state.placed)), anew)
    covariance = np.where(kept[:, None, None], calibration.center_covariance, np.nan)
    return replace(
        calibration,
        scene=Scene.from_rig(
            Rig(K, R, t, size, registered=state.placed), calibration.scene.ground, metric=True
        ),
        association_rate=association,
        log_likelihood_ratio=evidence,
        focal_sd=np.where(kept, calibration.focal_sd, np.nan),
        center_covariance=covariance,
        camera_residual=np.where(kept, calibration.camera_residual, np.nan),
        sightings=np.where(kept, calibration.sightings, 0),
    )
