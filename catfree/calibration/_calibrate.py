"""`calibrate`: a metric rig from boxes alone, registration first, then evidence and adjustment."""

from collections.abc import Sequence

from catfree.calibration._evidence_loop import EvidenceLoop
from catfree.calibration.people import (
    Calibration,
    confirm,
    register,
    remove_offsets,
    without_vague_cameras,
)
from catfree.geometry._arrays import ArrayInput
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections
from catfree.types._forks import require_own_process
from catfree.types._progress import Progress, no_progress
from catfree.types._validation import require_instance


def calibrate(
    detections: Detections,
    image_size: ArrayInput,
    settings: Settings | CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    progress: Progress | None = None,
) -> Calibration:
    """Find cameras and ground in metres from nothing but boxes of walking people.

    People are as tall as people are: that gives every camera its tilt, roll, height and a metric
    map of the ground; people seen by two cameras at the same time join the maps. Then the evidence
    method groups the boxes, and its surest groups refine the rig. A camera that fits far worse than
    the others is taken out and tried in every place that its boxes allow. Against the refined rig
    every camera's place is searched once more, and each must stand up to its evidence again.

    Args:
        detections: (N,) boxes of synchronized static cameras; those of a score below
            `settings.confidence` do not take part.
        image_size: (2,) width and height in pixels for all cameras, or (C, 2).
        settings: settings of a run or of the calibration alone; the defaults if None.
        camera_names: names for messages.
        maximum_offset: search clock offsets of single cameras up to so many frames, and correct
            them; 0 trusts the frame numbers.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The scene in metres, z up, ground z = 0, with the evidence for each camera. A camera that
        cannot be trusted has `scene.rig.registered` False and NaN parameters. With clock offsets,
        `catfree.calibration.remove_offsets(detections, result.frame_offset)` is what fits the rig.

    Raises:
        CalibrationError: if fewer than two cameras can be registered, or those that can disagree.
        InvalidInputError: if shapes do not fit.
        ForkedProcessError: in a process forked after JAX was used.
    """
    begun = begin_calibration(
        detections,
        image_size,
        settings,
        camera_names=camera_names,
        maximum_offset=maximum_offset,
        progress=progress,
    )
    return finish_calibration(
        begun, detections, settings, camera_names=camera_names, progress=progress
    )


def begin_calibration(
    detections: Detections,
    image_size: ArrayInput,
    settings: Settings | CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    progress: Progress | None = None,
) -> Calibration:
    """Place as many cameras as the boxes support: the first half of `calibrate`.

    Args:
        detections: as `calibrate`.
        image_size: as `calibrate`.
        settings: as `calibrate`.
        camera_names: as `calibrate`.
        maximum_offset: as `calibrate`.
        progress: as `calibrate`.

    Returns:
        The rig as it was registered, for `finish_calibration`.

    Raises:
        CalibrationError: as `calibrate`.
        InvalidInputError: as `calibrate`.
    """
    detections, settings = _confident(detections, settings)
    return register(
        detections,
        image_size,
        settings.calibration,
        camera_names=camera_names,
        maximum_offset=maximum_offset,
        progress=progress,
    )


def finish_calibration(
    begun: Calibration,
    detections: Detections,
    settings: Settings | CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Refine a registered rig by the evidence of its people: the second half of `calibrate`.

    Args:
        begun: what `begin_calibration` returned.
        detections: the boxes that it came from.
        settings: as `calibrate`.
        camera_names: as `calibrate`.
        progress: as `calibrate`.

    Returns:
        What `calibrate` returns.

    Raises:
        CalibrationError: as `calibrate`.
    """
    detections, settings = _confident(detections, settings)
    rules = settings.calibration
    if rules.evidence_rounds == 0:
        return without_vague_cameras(begun, rules, camera_names)
    synchronized = remove_offsets(detections, begun.frame_offset)
    report = progress or no_progress
    best = EvidenceLoop(synchronized, settings, report, camera_names).settle(begun)
    best = confirm(best, synchronized, rules)
    return without_vague_cameras(best, rules, camera_names)


def _confident(
    detections: Detections, settings: Settings | CalibrationSettings | None
) -> tuple[Detections, Settings]:
    """The boxes that take part, and the settings of a whole run."""
    require_own_process()
    require_instance(detections, Detections, "detections")
    if not isinstance(settings, Settings):
        rules = CalibrationSettings() if settings is None else settings
        require_instance(rules, CalibrationSettings, "settings")
        settings = Settings(calibration=rules)
    if detections.score is not None:
        detections = detections[detections.score >= settings.confidence]
    return detections, settings
