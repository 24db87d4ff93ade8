"""Calibrate a metric rig from boxes alone: registration, then refinement by evidence."""

from collections.abc import Sequence

from catfree.calibration._evidence_loop import EvidenceLoop
from catfree.calibration.people import (
    Anchor,
    Calibration,
    anchored,
    confirm,
    register,
    resolve_anchors,
    without_vague_cameras,
)
from catfree.calibration.people._register import camera_sizes
from catfree.geometry._arrays import ArrayInput
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections
from catfree.types._annotations import Progress, as_progress
from catfree.types._detections import is_confident
from catfree.types._processes import require_own_process
from catfree.types._validation import as_count, require_instance


def calibrate(
    detections: Detections,
    image_size: ArrayInput,
    settings: Settings | CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    anchors: Sequence[Anchor] = (),
    progress: Progress | None = None,
) -> Calibration:
    """Estimate cameras and ground in meters from boxes of walking people.

    The known range of people's heights yields each camera's tilt, roll, height and a metric map of
    the ground; people seen by two cameras at the same time join the maps. The evidence method then
    groups the boxes, and its most certain groups refine the rig. Every camera's position is
    searched again in the refined rig, and a camera that fits far worse than the others is removed.
    Finally, late cameras are corrected by whole frames if the rig then fits better, and the
    evidence for each camera is checked again.

    Args:
        detections: (N,) boxes of synchronized static cameras; boxes with a score below
            `settings.confidence` are ignored.
        image_size: (2,) width and height in pixels for all cameras, or (C, 2).
        settings: settings of a run, or of the calibration alone; None for the defaults.
        camera_names: names for error messages.
        maximum_offset: largest clock offset, in frames, at which to search for cameras that fit
            nowhere with the given frame numbers, and for the one that fits worst. Lags of a few
            frames are corrected in any case.
        anchors: independently known lengths, cameras and points (`KnownDistance`, `KnownCamera`,
            `SurveyedPoint`). Without them the scale rests on the height of the people alone: a
            crowd of children makes all lengths too long, unnoticed.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The scene in meters, z up, ground z = 0, with the evidence for each camera. With anchors on
        a map, it is in the map's frame; with longitudes and latitudes, it has a georeference.
        `anchors` of the result compares each anchor with the people and the other anchors; one that
        contradicts them is not used. A camera that cannot be trusted has `scene.rig.registered`
        False and NaN parameters. If clock offsets were found,
        `catfree.calibration.remove_offsets(detections, result.frame_offset)` returns boxes that fit
        the rig.

    Raises:
        CalibrationError: if fewer than two cameras can be registered or they disagree, if only
            unregistered cameras see the map, or if consistent anchors imply an impossible height of
            the people.
        InvalidInputError: if shapes do not match, two cameras have the same boxes, many boxes of a
            camera are outside its image, a picture has more than 1,000 boxes or an instant more
            than 5,000, or an anchor's camera does not exist, or its pixel is outside the image or
            above the horizon.
        ForkedProcessError: in a process forked after JAX was used.
    """
    require_own_process()
    require_instance(detections, Detections, "detections")
    maximum_offset = as_count(maximum_offset, "maximum_offset", least=0)
    if not isinstance(settings, Settings):
        rules = CalibrationSettings() if settings is None else settings
        require_instance(rules, CalibrationSettings, "settings")
        settings = Settings(calibration=rules)
    detections = detections[is_confident(detections, settings.confidence)]
    if anchors:  # report mistakes before the long computation
        resolve_anchors(anchors, camera_sizes(detections, image_size), camera_names)
    registered = register(
        detections,
        image_size,
        settings.calibration,
        camera_names=camera_names,
        progress=progress,
    )
    calibration = refine_registered(
        registered,
        detections,
        settings,
        camera_names=camera_names,
        maximum_offset=maximum_offset,
        progress=progress,
    )
    return anchored(calibration, anchors, settings.calibration, camera_names=camera_names)


def refine_registered(
    registered: Calibration,
    detections: Detections,
    settings: Settings,
    *,
    camera_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    progress: Progress | None = None,
) -> Calibration:
    """Refine a registered rig with the evidence method, the second half of `calibrate`.

    Args:
        registered: the result of `register`.
        detections: the boxes passed to `register`.
        settings: settings of the evidence method and of the calibration.
        camera_names: as `calibrate`.
        maximum_offset: as `calibrate`.
        progress: as `calibrate`.

    Returns:
        The result of `calibrate`.

    Raises:
        CalibrationError: as `calibrate`.
    """
    rules, best = settings.calibration, registered
    if rules.evidence_rounds > 0:
        loop = EvidenceLoop(detections, settings, as_progress(progress), camera_names)
        best = loop.settle(registered)
        if maximum_offset > 0:
            best = loop.with_late_cameras(best, maximum_offset)
        best = loop.synchronized(best)
        best = confirm(best, loop.boxes(best), rules)
    return without_vague_cameras(best, rules, camera_names)
