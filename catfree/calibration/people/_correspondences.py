"""Refine a rig with people matched across cameras by other means.

A method that weighs appearance, time and visibility groups boxes better than geometry alone. Its
most certain groups make the rig more accurate; then the method can be run again.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import edges_from_center
from catfree.calibration.people._radial_lens import RadialLenses, radial_distortion
from catfree.calibration.people._register import Calibration
from catfree.calibration.people.adjustment._focal_spread import learn_focal_spread
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    BundleResult,
    KnownCameras,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, X, of_rig, scene_of
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS, map_ground
from catfree.calibration.people.cameras._rig_deviation import (
    crowd_deviation,
    scale_deviation,
    shape_deviation,
)
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.geometry._person import edge_deviation
from catfree.settings import CalibrationSettings
from catfree.types import Detections
from catfree.types._validation import as_float, as_integer, require_shape

FEWEST_PEOPLE = 20


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
            with fewer than two registered cameras are omitted. Use only certain groups: wrong
            groups hold the rig in place.
        settings: constants.
        box_sd: (N, 3) standard deviations in pixels of horizontal center, top and bottom; if
            None, those of the settings. NaN or infinity marks an edge without information.
        repeats: mean number of groups that show the same person, times that at one place.
        iterations: maximum number of steps.

    Returns:
        The refined rig with new focal and center uncertainties, and with or without lens
        distortion and with shared or separate focal lengths, whichever these people support; the
        evidence is that of the given rig.

    Raises:
        InvalidInputError: if anchors were fitted to the rig, if shapes do not match, or if members
            are not whole numbers.
        InsufficientDataError: if too few people are seen by two registered cameras.
    """
    settings = CalibrationSettings() if settings is None else settings
    if calibration.anchors:
        raise InvalidInputError(
            "The calibration was fitted to anchors, which people alone would undo. Refine it "
            "first, and fit it to the anchors afterwards."
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
    k1 = np.where(registered, radial_distortion(rig), 0.0)
    start = np.nan_to_num(parameters)
    middle = np.log(np.median(settings.focal_shares) * rig.image_size.max(1))
    boxes = BoxMeasurements(person, camera, box, sd)
    prior = weak_prior(camera, start, middle, settings)

    def solved(*, spread: float, bent: bool) -> BundleResult:
        return adjust_groups(
            boxes,
            start,
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
    errors = separate.camera_covariance(repeats)[:, LOG_FOCAL, :, LOG_FOCAL]
    spread = learn_focal_spread(
        separate.parameters[known, LOG_FOCAL], errors[np.ix_(known, known)], settings
    )
    result = (
        (bent if is_bent else ideal) if spread == alike else solved(spread=spread, bent=is_bent)
    )
    adjusted, own = np.isfinite(result.parameters[:, LOG_FOCAL]), result.own_covariance
    parameters = np.where(adjusted[:, None], result.parameters, parameters)
    scene = scene_of(parameters, rig.image_size, np.where(adjusted, result.k1, k1))
    instants = len(np.unique(np.asarray(detections.frame)[row]))
    crowd_sd = crowd_deviation(len(members) / instants, settings)
    rig_sd = shape_deviation(result.parameters, result.camera_covariance(repeats), adjusted)
    scale_sd = scale_deviation(result.parameters, result.camera_covariance(), adjusted)
    return replace(
        calibration,
        scene=replace(scene, rig_sd=rig_sd),
        shared_focal=spread == alike,
        distortion_sd=np.where(adjusted, repeats**0.25 * result.k1_sd, calibration.distortion_sd),
        focal_sd=np.where(
            adjusted,
            np.exp(parameters[:, LOG_FOCAL]) * np.sqrt(own[:, LOG_FOCAL, LOG_FOCAL]),
            calibration.focal_sd,
        ),
        center_covariance=np.where(
            adjusted[:, None, None], own[:, X:, X:], calibration.center_covariance
        ),
        camera_covariance=np.where(
            np.logical_and.outer(adjusted, adjusted)[:, None, :, None],
            # A common focal length is an assumption that anchors may not confirm.
            separate.camera_covariance(repeats),
            calibration.camera_covariance,
        ),
        scale_sd=np.hypot(scale_sd, crowd_sd / settings.person_height).item(),
        crowd_height=settings.person_height,
        crowd_height_sd=crowd_sd,
        residual=result.residual,
        camera_residual=result.camera_residual,
        sightings=result.sightings,
    )


def adjust_groups(
    measurements: BoxMeasurements,
    parameters: Float[np.ndarray, "cam 7"],
    known: KnownCameras,
    settings: CalibrationSettings,
    *,
    focal_spread: float,
    iterations: int,
    k1: Float[np.ndarray, " cam"] | None = None,
) -> BundleResult:
    """Adjust cameras to given groups of boxes; people are initialized from single views.

    Args:
        measurements: the boxes of each group; an edge with deviation NaN or infinity is ignored.
        parameters: (C, 7) initial cameras, in meters over the ground z = 0.
        known: prior on the cameras.
        settings: constants.
        focal_spread: see `adjust_people_bundle`.
        iterations: maximum number of steps.
        k1: (C,) initial radial distortion of each camera, adjusted too; ideal lenses if None.
    """
    sd = np.nan_to_num(measurements.sd, nan=np.inf, posinf=np.inf)
    measurements = straight = replace(measurements, sd=sd)
    if k1 is not None:
        lenses = RadialLenses(np.exp(parameters[:, LOG_FOCAL]), k1)
        box = lenses.straightened(measurements.camera, measurements.box)
        straight = replace(measurements, box=box)
    return adjust_people_bundle(
        measurements,
        parameters,
        _start(straight, parameters, settings),
        known,
        settings,
        focal_spread=focal_spread,
        iterations=iterations,
        k1=k1,
    )


def _start(
    measurements: BoxMeasurements,
    parameters: Float[np.ndarray, "cam 7"],
    settings: CalibrationSettings,
) -> Float[np.ndarray, "person 3"]:
    """(P, 3) initial ground position, averaged over single views, and height of each person."""
    count = int(measurements.person.max()) + 1
    total, weights = np.zeros((count, 2)), np.full(count, 1e-9)
    for camera in np.unique(measurements.camera):
        mine = measurements.camera == camera
        person, box, sd = measurements.person[mine], measurements.box[mine], measurements.sd[mine]
        ground_map = map_ground(
            parameters[camera],
            box[None],
            np.minimum(sd.mean(1), 0.2 * (box[:, 2] - box[:, 1]))[None],
            np.ones((1, len(box)), bool),
            settings,
            range_tolerance=RANGE_ERRORS[-1],
        )
        weight = ground_map.valid[0] / ground_map.covariance[0].trace(axis1=1, axis2=2)
        np.add.at(total, person, weight[:, None] * ground_map.xy[0])
        np.add.at(weights, person, weight)
    return np.column_stack([total / weights[:, None], np.full(count, settings.apparent_height)])
