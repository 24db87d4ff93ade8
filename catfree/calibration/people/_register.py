"""Register a metric camera rig and its ground plane from person boxes alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.adjustment._people_bundle import BundleResult
from catfree.calibration.people.anchors._anchors import AnchorCheck
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, X, scene_of, usual_focal
from catfree.calibration.people.cameras._rig_deviation import crowd_deviation, scale_deviation
from catfree.calibration.people.matching._workspace import Workspace, prepare
from catfree.calibration.people.search._growth import AdjustedRig
from catfree.calibration.people.search._register_cameras import register_cameras
from catfree.errors import CalibrationError, InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.settings import CalibrationSettings
from catfree.types import Detections, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._validation import (
    as_integer,
    require_boxes_in_images,
    require_different_cameras,
    require_few_people,
    require_names,
    shown_camera,
)

FEWEST_FOR_LENSES = 3  # cameras; two never share confident people


@dataclass(frozen=True)
class Calibration:
    """A rig from people, its uncertainty, and the evidence for each camera.

    Attributes:
        scene: metric scene, z up, ground z = 0; cameras that cannot be trusted are not registered
            and hold NaN.
        association_rate: (C,) matched fraction of the people that both a camera and the rest of the
            rig should see; NaN for unregistered cameras, as in the following fields.
        log_likelihood_ratio: (C,) natural-log evidence of each camera against the map of the
            others, minus the highest evidence of its boxes at shifted times.
        camera_covariance: (C, 7, C, 7) of log focal length, tilt, roll, heading and center, with
            the heading and ground position of the camera with most boxes fixed. It covers random
            box noise, errors that the boxes of one person share, the foot offset, focal lengths
            that differ, and lens distortion where it was estimated; `scale_sd` covers the scale. 0
            for unregistered cameras, NaN for newly placed ones.
        distortion_sd: (C,) standard deviation of the radial distortion k1 in
            `scene.rig.distortion`; 0 where none was estimated because it did not pay off.
        shared_focal: whether one focal length is used for all cameras.
        scale_sd: relative standard deviation of every length, from the uncertain height of the
            people, the slack of the boxes, the foot offset, and box noise.
        crowd_height: mean height of the people in meters. Without anchors, the scale rests on this
            assumption: if the people are children, all lengths are too long.
        crowd_height_sd: its standard deviation, including the slack of the boxes.
        foot_offset: meters by which the bottom of a box is closer to the camera than the body axis.
        residual: median absolute residual in standard deviations of the box edges.
        camera_residual: (C,) the same per camera, NaN for cameras without boxes. A camera with a
            clearly higher residual than the others is misplaced.
        sightings: (C,) number of boxes per camera in the last adjustment.
        frame_offset: (C,) frames by which each camera's frame numbers are too high, found in the
            refined rig.
        anchors: each quantity stated by anchors, and the height of the people, compared with all
            other evidence; empty without anchors.
    """

    scene: Scene
    association_rate: Float[np.ndarray, " cam"]
    log_likelihood_ratio: Float[np.ndarray, " cam"]
    camera_covariance: Float[np.ndarray, "cam 7 cam 7"]
    distortion_sd: Float[np.ndarray, " cam"]
    shared_focal: bool
    scale_sd: float
    crowd_height: float
    crowd_height_sd: float
    foot_offset: float
    residual: float
    camera_residual: Float[np.ndarray, " cam"]
    sightings: Int[np.ndarray, " cam"]
    frame_offset: Int[np.ndarray, " cam"]
    anchors: tuple[AnchorCheck, ...] = ()

    @property
    def focal_sd(self) -> Float[np.ndarray, " cam"]:
        """(C,) standard deviation of the focal length in pixels."""
        cameras = np.arange(len(self.camera_covariance))
        variance = self.camera_covariance[cameras, LOG_FOCAL, cameras, LOG_FOCAL]
        return np.asarray(self.scene.rig.K)[:, 0, 0] * np.sqrt(variance)

    @property
    def center_covariance(self) -> Float[np.ndarray, "cam 3 3"]:
        """(C, 3, 3) covariance of the camera centers in square meters."""
        cameras = np.arange(len(self.camera_covariance))
        covariance = self.camera_covariance[cameras, X:, cameras, X:]
        return np.where(self.scene.rig.registered[:, None, None], covariance, np.nan)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences about unused anchors, and about an unused height of the people."""
        return tuple(check.sentence for check in self.anchors if not check.used)


def register(
    detections: Detections,
    image_size: ArrayInput,
    settings: CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Register cameras over a metric ground from boxes alone: the first half of `calibrate`.

    The known range of people's heights yields each camera's tilt, roll, height and a metric map of
    the ground. People seen by two cameras at the same time join their maps. Cameras are added as
    long as their evidence exceeds that of the same boxes at shifted times.

    Args:
        detections: (N,) boxes of synchronized static cameras; scores and appearance are not used.
        image_size: (2,) width and height in pixels for all cameras, or (C, 2).
        settings: constants; the same for all data.
        camera_names: names for error messages.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The rig, the ground z = 0, and the evidence for each camera.

    Raises:
        InvalidInputError: as `calibrate`, or if sizes or names do not match the detections.
        CalibrationError: if fewer than two cameras can be trusted.
    """
    settings = CalibrationSettings() if settings is None else settings
    require_few_people(detections.frame, detections.camera, camera_names)
    require_different_cameras(detections.frame, detections.camera, detections.box, camera_names)
    size = camera_sizes(detections, image_size)
    require_boxes_in_images(detections.camera, detections.box, size, camera_names)
    require_names(camera_names, len(size))
    report = as_progress(progress)
    work, registered = _register_bent(detections, size, settings, camera_names, report)
    return describe_registration(work, registered, camera_names)


def _register_bent(
    detections: Detections,
    size: Int[np.ndarray, "cam 2"],
    settings: CalibrationSettings,
    camera_names: Sequence[str] | None,
    report: Progress,
) -> tuple[Workspace, AdjustedRig]:
    """Register cameras with ideal lenses or, if fewer than three are found, with distorted ones.

    Three cameras share people to adjust their lenses to, and then find the others. Distorted lenses
    must place more cameras, with more evidence in total.

    Raises:
        CalibrationError: if no two cameras share people, whatever the lenses.
    """
    best: tuple[Workspace, AdjustedRig] | None = None
    refusals: list[CalibrationError] = []
    for k1 in (0.0, *settings.bent_lenses):
        lenses = RadialLenses(usual_focal(size, settings), np.full(len(size), k1))
        work = prepare(detections, size, settings, camera_names, lenses)
        try:
            registered = register_cameras(work, report)
        except CalibrationError as error:
            refusals.append(error)
            continue
        if best is None or all(np.greater(registered.quality, best[1].quality)):
            best = work, registered
        if best[1].quality[0] >= min(FEWEST_FOR_LENSES, work.useful.sum()):
            break
    if best is None:
        raise refusals[0]
    return best


def camera_sizes(detections: Detections, image_size: ArrayInput) -> Int[np.ndarray, "cam 2"]:
    """Expand image sizes to (C, 2), one per camera, and check them."""
    size = as_integer(image_size, "image_size")
    count = int(detections.camera.max(initial=-1)) + 1
    if size.shape == (2,):
        size = np.tile(size, (count, 1))
    if size.ndim != 2 or size.shape[1:] != (2,):
        raise InvalidInputError(
            f"image_size must be (width, height) or one row per camera, got shape {size.shape}."
        )
    if len(size) < count:
        raise InvalidInputError(
            f"image_size has {len(size)} rows, but the detections refer to camera {count - 1}."
        )
    if (size <= 0).any():
        raise InvalidInputError("image_size must be a positive number of pixels.")
    return size


def describe_registration(
    work: Workspace, registered: AdjustedRig, camera_names: Sequence[str] | None
) -> Calibration:
    """Describe a registered rig as a scene with its evidence.

    Args:
        work: the sequence.
        registered: its cameras.
        camera_names: for error messages.

    Raises:
        CalibrationError: if fewer than two cameras can be trusted.
    """
    state, bundle, verdicts = registered.state, registered.bundle, registered.verdicts
    trusted = sum(verdict.accepted for verdict in verdicts.values())
    if trusted < 2:
        reasons = "; ".join(
            f"{shown_camera(c, camera_names)}: "
            f"{' and '.join(v.shortcomings) or 'enough, but no other trusted camera'}"
            for c, v in verdicts.items()
        )
        raise CalibrationError(
            f"Only {trusted} cameras can be trusted and 2 are needed "
            f"({reasons or 'no matches'}); check synchronization and overlap, or record longer."
        )
    # A camera that cannot be trusted is kept only in a rig of two (`judge_cameras`).
    association, evidence = np.full((2, work.grid.camera_count), np.nan)
    for camera, verdict in verdicts.items():
        association[camera], evidence[camera] = verdict.association, verdict.margin
    # The boxes were undistorted for another focal length.
    k1 = work.lenses.of_focal(np.exp(state.parameters[:, LOG_FOCAL])).k1
    # Nobody is tracked yet: everybody may be seen at all instants.
    covariance = bundle.camera_covariance(repeats=float(work.grid.frame_count))
    return Calibration(
        scene=scene_of(state.parameters, work.grid.size, k1),
        association_rate=association,
        log_likelihood_ratio=evidence,
        camera_covariance=covariance,
        distortion_sd=np.where(state.placed, bundle.k1_sd, np.nan),
        shared_focal=False,
        foot_offset=work.settings.foot_offset,
        frame_offset=np.zeros(work.grid.camera_count, np.int64),
        **told_by(bundle, covariance, work.grid.frame_count, work.settings),
    )


def told_by(
    bundle: BundleResult,
    covariance: Float[np.ndarray, "cam 7 cam 7"],
    instants: int,
    settings: CalibrationSettings,
) -> dict[str, Any]:
    """Fields of a `Calibration` known from any adjustment; NaN for cameras without boxes.

    Args:
        bundle: the adjustment.
        covariance: (C, 7, C, 7) of its cameras.
        instants: number of frames with its people.
        settings: constants.
    """
    known = np.isfinite(bundle.parameters[:, LOG_FOCAL])
    crowd_sd = crowd_deviation(len(bundle.people) / instants, settings)
    scale_sd = scale_deviation(bundle.parameters, covariance, known)
    return {
        "scale_sd": np.hypot(scale_sd, crowd_sd / settings.person_height).item(),
        "crowd_height": settings.person_height,
        "crowd_height_sd": crowd_sd,
        "residual": bundle.residual,
        "camera_residual": bundle.camera_residual,
        "sightings": bundle.sightings,
    }
