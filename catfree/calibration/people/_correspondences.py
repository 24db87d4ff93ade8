"""Refinement of a rig with people matched across cameras by other means.

A method that weighs appearance, time and visibility groups boxes better than geometry alone. Its
most certain groups make the rig more accurate, and then the method can be run again.
"""

from dataclasses import replace

import numpy as np

from catfree.calibration.people._box_grid import edges_from_center
from catfree.calibration.people._radial_lens import radial_distortion
from catfree.calibration.people._register import Calibration, told_by
from catfree.calibration.people.adjustment._focal_spread import learn_focal_spread
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    BundleResult,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    of_rig,
    scene_of,
    usual_focal,
)
from catfree.calibration.people.cameras._rig_deviation import shape_deviation
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.geometry._person import edge_deviation
from catfree.settings import CalibrationSettings
from catfree.types import Detections
from catfree.types._validation import as_float, as_integer, require_shape

FEWEST_PEOPLE = 20  # least number to refine a rig


def refine_with_correspondences(
    calibration: Calibration,
    detections: Detections,
    members: ArrayInput,
    settings: CalibrationSettings | None = None,
    *,
    box_sd: ArrayInput | None = None,
    repeats: float = 1.0,
    iterations: int = 20,
) -> Calibration:
    """Adjust a pedestrian rig to given groups of boxes.

    Args:
        calibration: the rig, without anchors; unregistered cameras stay unregistered.
        detections: (N,) boxes.
        members: (H, C) row of the detections in each camera for each person and frame, or -1; rows
            with fewer than two registered cameras are ignored. Use only certain groups, because
            wrong groups hold the rig in place.
        settings: constants.
        box_sd: (N, 3) standard deviations in pixels of horizontal center, top and bottom; if
            None, those of the settings. NaN or infinity marks an edge without information.
        repeats: mean number of groups per person, times the mean number per person at one place.
        iterations: maximum number of steps.

    Returns:
        The refined rig with new focal and center uncertainties, with or without lens distortion,
        and with shared or separate focal lengths, whichever these people support. The evidence is
        that of the given rig.

    Raises:
        InvalidInputError: if anchors were fitted to the rig, if shapes do not match, or if members
            are not whole numbers.
        InsufficientDataError: if too few people are seen by two registered cameras.
    """
    settings = CalibrationSettings() if settings is None else settings
    if calibration.anchors:
        raise InvalidInputError(
            "The calibration was fitted to anchors, which a refinement to people alone would undo. "
            "Refine it first, and fit it to the anchors afterward."
        )
    rig = calibration.scene.rig
    registered = rig.registered
    members = as_integer(members, "members")
    require_shape(members, (None, len(registered)), "members")
    members = np.where(registered, members, -1)
    members = members[(members >= 0).sum(1) >= 2]
    if len(members) < FEWEST_PEOPLE:
        raise InsufficientDataError(
            f"Refinement needs {FEWEST_PEOPLE} people seen by two registered cameras, got "
            f"{len(members)}."
        )
    person, camera = np.nonzero(members >= 0)
    row = members[person, camera]
    box = edges_from_center(np.asarray(detections.box, np.float64)[row], rig.image_size[camera])
    if box_sd is None:
        sd = edge_deviation(box[:, 2] - box[:, 1], settings.relative_sd, settings.pixel_sd)
        sd = np.repeat(sd[:, None], 3, axis=1)
    else:
        sd = np.asarray(as_float(box_sd), np.float64)
        require_shape(sd, (len(detections), 3), "box_sd")
        sd = sd[row]
    parameters = of_rig(rig)
    k1 = radial_distortion(rig)
    start = np.nan_to_num(parameters)
    middle = np.log(usual_focal(rig.image_size, settings))
    boxes = BoxMeasurements(person, camera, box, sd)
    prior = weak_prior(camera, start, middle, settings)

    def solved(*, spread: float, bent: bool) -> BundleResult:
        return adjust_people_bundle(
            boxes,
            start,
            None,
            prior,
            settings,
            focal_spread=spread,
            iterations=iterations,
            k1=k1 if bent else None,
        )

    alike = settings.shared_focal_sd
    ideal, bent = (solved(spread=alike, bent=free) for free in (False, True))
    is_bent = bent.cost <= (1 - settings.free_lens_gain) * ideal.cost
    separate = solved(spread=np.inf, bent=is_bent)
    known = np.flatnonzero(np.isfinite(separate.parameters[:, LOG_FOCAL]))
    covariance = separate.camera_covariance(repeats)
    spread, among = learn_focal_spread(
        separate.parameters[known, LOG_FOCAL], covariance[known][:, :, known], settings
    )
    covariance[known[:, None], :, known] = among.transpose(0, 2, 1, 3)
    solutions = {alike: bent if is_bent else ideal, np.inf: separate}
    result = solutions.get(spread) or solved(spread=spread, bent=is_bent)
    adjusted = np.isfinite(result.parameters[:, LOG_FOCAL])
    parameters = np.where(adjusted[:, None], result.parameters, parameters)
    scene = scene_of(parameters, rig.image_size, np.where(adjusted, result.k1, k1))
    instants = len(np.unique(np.asarray(detections.frame)[row]))
    rig_sd = shape_deviation(result.parameters, covariance, adjusted)
    return replace(
        calibration,
        **told_by(result, covariance, instants, settings),
        scene=replace(scene, rig_sd=rig_sd),
        shared_focal=spread == alike,
        distortion_sd=np.where(adjusted, repeats**0.25 * result.k1_sd, calibration.distortion_sd),
        camera_covariance=np.where(
            np.logical_and.outer(adjusted, adjusted)[:, None, :, None],
            covariance,
            calibration.camera_covariance,
        ),
    )
