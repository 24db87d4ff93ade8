"""`calibrate`: a metric rig from boxes alone, registration first, then evidence and adjustment."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from catfree.errors import InsufficientDataError
from catfree.rig.pedestrians import (
    Calibration,
    calibrate as register,
    confirm,
    places_for,
    reconsider,
    refine_with_correspondences,
    remove_offsets,
    without_camera,
)
from catfree.rig.strain import most_strained
from catfree.rig.sure_people import sure_people
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
    method groups the boxes, and its surest groups refine the rig. A camera that fits far worse than
    the others is taken out and tried in every place that its boxes allow. Against the refined rig
    every camera's place is searched once more, and each must stand up to its evidence again.

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
    if rules.evidence_rounds == 0:
        return best
    synchronized = remove_offsets(detections, best.frame_offset)
    report = progress or (lambda stage, done, total: None)
    best = _relieved(_refined(best, synchronized, settings, report), synchronized, settings, report)
    for _ in range(len(best.scene.rig.registered)):
        again = reconsider(best, synchronized, rules)
        if again is None:
            break
        grown = again.scene.rig.registered.sum() > best.scene.rig.registered.sum()
        best = _refined(again, synchronized, settings, report)
        best = _relieved(best, synchronized, settings, report)
        if not grown:
            break
    return confirm(best, synchronized, rules)


def _refined(
    calibration: Calibration,
    detections: Detections,
    settings: Settings,
    report: Callable[[str, int, int], None],
) -> Calibration:
    """The rig after as many turns of the loop as there is evidence for."""
    rounds = settings.calibration.evidence_rounds
    for done in range(rounds):
        report("refinement", done, rounds)
        refined = _refine_once(calibration, detections, settings)
        if refined is None:
            break
        calibration = refined
    report("refinement", rounds, rounds)
    return calibration


def _relieved(
    calibration: Calibration,
    detections: Detections,
    settings: Settings,
    report: Callable[[str, int, int], None],
) -> Calibration:
    """The rig with every strained camera where it fits, if there is such a place.

    A camera beside its place matches the crowd well enough to stay there, and bends the others
    towards it: only without it they show where it belongs.
    """
    rules = settings.calibration
    tried: set[int] = set()
    while (camera := most_strained(calibration.camera_residual, tried)) is not None:
        tried.add(camera)
        rest = without_camera(calibration, camera, rules)
        rest = _refined(rest, detections, settings, report)
        for place in places_for(rest, detections, camera, rules):
            found = _refined(place, detections, settings, report)
            fits = np.isfinite(found.camera_residual[camera])
            if fits and found.residual < calibration.residual:
                calibration = found
    return calibration


def _refine_once(
    calibration: Calibration, detections: Detections, settings: Settings
) -> Calibration | None:
    """One turn of the loop; None where the evidence is too thin to refine with."""
    try:
        people = sure_people(detections, calibration.scene, settings.evidence)
        return refine_with_correspondences(
            calibration,
            detections,
            people.member,
            settings.calibration,
            box_sd=people.box_sd,
        )
    except InsufficientDataError:
        return None
