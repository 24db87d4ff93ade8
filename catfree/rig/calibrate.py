"""`calibrate`: a metric rig from boxes alone, registration first, then evidence and adjustment."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from catfree import evidence
from catfree.errors import InsufficientDataError
from catfree.rig.pedestrians import (
    Calibration,
    calibrate as register,
    refine_with_correspondences,
    remove_offsets,
)
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections
from catfree.types.validation import require_instance


def calibrate(
    detections: Detections,
    image_size: Any,
    settings: Settings | CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibration:
    """Find cameras and ground in metres from nothing but boxes of walking people.

    People are as tall as people are: that gives every camera its tilt, roll, height and a metric
    map of the ground; people seen by two cameras at the same time join the maps. Then the evidence
    method groups the boxes, and its surest groups refine the rig, as long as the residual falls.

    Args:
        detections: (N,) boxes of synchronized static cameras.
        image_size: (2,) width and height in pixels for all cameras, or (C, 2).
        settings: settings of a run or of the calibration alone; the defaults if None.
        camera_names: names for messages.
        maximum_offset: search clock offsets of single cameras up to so many frames, and correct
            them; 0 trusts the frame numbers.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The scene in metres, z up, ground z = 0, with the evidence for each camera. A camera that
        cannot be trusted has `scene.rig.registered` False and NaN parameters.

    Raises:
        CalibrationError: if fewer than two cameras can be registered.
        InvalidInputError: if shapes do not fit.
    """
    require_instance(detections, Detections, "detections")
    if not isinstance(settings, Settings):
        rules = CalibrationSettings() if settings is None else settings
        require_instance(rules, CalibrationSettings, "settings")
        settings = Settings(calibration=rules)
    rules = settings.calibration
    if detections.score is not None:
        detections = detections[detections.score >= settings.confidence]
    best = register(
        detections,
        image_size,
        rules,
        camera_names=camera_names,
        maximum_offset=maximum_offset,
        progress=progress,
    )
    synchronized = remove_offsets(detections, best.frame_offset)
    for _ in range(rules.evidence_rounds):
        refined = _refine_once(best, synchronized, settings)
        if refined is None:
            break
        best = refined
    return best


def _refine_once(
    calibration: Calibration, detections: Detections, settings: Settings
) -> Calibration | None:
    """One turn of the loop; None where the evidence is too thin to refine with."""
    try:
        solution = evidence.solve(detections, calibration.scene, settings.evidence)
        clusters = evidence.clusters_of(solution)
        strict = clusters.strict()
        member, sigma = clusters.member[strict], clusters.sigma[strict]
        deviation = np.full((len(detections), 3), np.nan)
        present = member >= 0
        deviation[member[present]] = sigma[present]
        return refine_with_correspondences(
            calibration, detections, member, settings.calibration, box_sd=deviation
        )
    except InsufficientDataError:
        return None
