"""The stages of a run after detection, each loaded from the cache if it finished before."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int

from catfree._run._cache import StageCache, cached
from catfree._run._input_checks import calibrating_score, tiny_boxes
from catfree._run._stitch import stitch_tracks
from catfree._run.detection._camera_detectors import CameraDetectors
from catfree._run.detection._second_look import expected_people, look_again
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.adapters.protocols import (
    Detector,
    Embedder,
    FittedToCamera,
    GuidedDetector,
    Reconstructor,
)
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.calibration import Calibration, refine
from catfree.calibration._calibrate import refine_registered
from catfree.calibration.people import Anchor, anchored, register, resolve_anchors
from catfree.calibration.reconstructions._scene_from_videos import scene_from_videos
from catfree.errors import CalibrationError, InsufficientDataError, InvalidInputError
from catfree.methods._localize import localize
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress
from catfree.types._detections import is_confident


def calibrate_cameras(
    videos: SynchronizedVideos | CameraBoxes,
    detector: Detector | FittedToCamera | None,
    detections: Detections,
    settings: Settings,
    *,
    maximum_offset: int = 0,
    anchors: Sequence[Anchor] = (),
    cache: StageCache | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate cameras and ground from confident boxes: second stage without a known scene.

    Args:
        videos: the footage or boxes; only their image sizes, camera names and missing pictures are
            used.
        detector: the source of the boxes, or None; its `box_slack`, if any, replaces the default.
        detections: boxes of all cameras; those with a score below
            `settings.calibration_confidence`, and those at instants that some cameras missed, are
            ignored.
        settings: settings of the run; only `calibration`, `evidence` and the confidences are used.
        maximum_offset: largest clock offset of a single camera to search, in frames.
        anchors: as `calibrate`.
        cache: holds a finished calibration without anchors, or its first half.
        progress: called as `progress(stage, done, total)`.

    Raises:
        CalibrationError: if no rig can be found from the people.
    """
    rules, usual = settings.calibration, CalibrationSettings.box_slack
    if rules.box_slack == usual:
        rules = dataclasses.replace(rules, box_slack=getattr(detector, "box_slack", usual))
    # Other settings have no effect here, so changing them does not invalidate the cache.
    settings = Settings(
        confidence=calibrating_score(settings),
        calibration_confidence=settings.calibration_confidence,
        evidence=settings.evidence,
        calibration=rules,
    )
    size, names = videos.image_size, videos.camera_names
    if size is None:
        raise InvalidInputError(
            "Finding the cameras from boxes needs the image sizes: pass image_size, or a scene."
        )
    incomplete = np.unique(videos.silent[:, 0])
    detections = detections[~np.isin(detections.frame, incomplete)]
    detections = detections[is_confident(detections, settings.confidence)]
    resolve_anchors(anchors, size, names)
    options = {"camera_names": names, "progress": progress}

    def begin() -> Calibration:
        return register(detections, size, rules, **options)

    def compute() -> Calibration:
        # Registration and refinement take equally long, so a killed run repeats only one of them.
        registered = remembered("registration", begin, 0)
        return refine_registered(
            registered, detections, settings, maximum_offset=maximum_offset, **options
        )

    def remembered(stage: str, step: Callable[[], Calibration], maximum: int) -> Calibration:
        return cached(
            cache,
            stage,
            Calibration,
            step,
            detections=detections,
            camera_names=names,
            settings=settings,
            image_size=size.tolist(),
            maximum_offset=maximum,
        )

    try:
        found = remembered("calibration", compute, maximum_offset)
        return anchored(found, anchors, rules, camera_names=names)
    except CalibrationError as error:
        message = str(error)
        for tiny in tiny_boxes(detections, rules):
            message = f"{tiny} The calibration error was: {error}"
        if len(incomplete):
            message += f" {len(incomplete)} instants that some camera does not show were left out."
        raise CalibrationError(message) from error


def reconstruct(
    videos: SynchronizedVideos,
    reconstructor: Reconstructor,
    detections: Detections,
    *,
    cache: StageCache | None,
    progress: Progress | None,
) -> Scene:
    """Aggregate several instants into one static rig: second stage with a reconstructor."""
    return cached(
        cache,
        "scene",
        Scene,
        lambda: scene_from_videos(videos, reconstructor, detections, progress),
        videos=videos,
        reconstructor=reconstructor,
        detections=detections,
    )


def refine_cameras(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    *,
    cache: StageCache | None,
    progress: Progress | None,
) -> tuple[Scene, tuple[str, ...]]:
    """Adjust cameras to the people: second stage with inaccurate cameras.

    Returns:
        The refined scene, or the given one with a sentence that says why.
    """
    try:
        refined = cached(
            cache,
            "refinement",
            Scene,
            lambda: refine(detections, scene, settings, progress=progress).scene,
            detections=detections,
            scene=scene,
            settings=settings,
        )
    except InsufficientDataError as error:
        return scene, (f"The cameras were not adjusted to the people. {error}",)
    return refined, ()


def detect_again(
    videos: SynchronizedVideos,
    cameras: CameraDetectors,
    embedder: Embedder | None,
    detections: Detections,
    scene: Scene,
    settings: Settings,
) -> Detections:
    """Detect again where the tracks of the first pass predict people: third stage.

    Args:
        videos: the footage.
        cameras: the detectors of the first pass; their cache holds a finished second pass.
        embedder: as `run`.
        detections: boxes of the first pass.
        scene: cameras and ground.
        settings: settings of the localization.

    Returns:
        The result of `look_again`, or the unchanged detections if the detector takes no hints or
        the paper's method is used.
    """
    if settings.method == "paper" or not isinstance(cameras.detector, FittedToCamera):
        return detections
    # Positions too uncertain to report are still useful as hints.
    settings = everywhere(settings)

    def look() -> Detections:
        if not all(isinstance(one, GuidedDetector) for one in cameras.fitted):
            return detections
        first = localize_people(
            detections, scene, settings, videos.silent, progress=cameras.progress
        )
        expected = expected_people(first, detections, scene)
        return look_again(videos, cameras, embedder, expected, detections)

    return cached(
        cameras.cache,
        "second-look",
        Detections,
        look,
        videos=videos,
        detector=cameras.detector,
        embedder=embedder,
        detections=detections,
        scene=scene,
        settings=settings,
    )


def everywhere(settings: Settings) -> Settings:
    """Return the settings changed to also report people outside the working area."""
    unrestricted = dataclasses.replace(settings.evidence, working_area=False)
    return dataclasses.replace(settings, evidence=unrestricted)


def localize_people(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    silent: Int[np.ndarray, "k 2"] | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    cache: StageCache | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Track people on the ground and join track fragments by appearance: last stage.

    Args:
        detections: boxes of all cameras.
        scene: cameras and ground.
        settings: settings of the localization.
        silent: frame and camera of missing pictures, as for `localize`.
        camera_names: names for warnings.
        cache: holds a finished localization.
        progress: called as `progress(stage, done, total)`.
    """

    def track() -> Localization:
        localization = localize(
            detections, scene, settings, progress, silent=silent, camera_names=camera_names
        )
        if settings.method == "paper":
            return localization
        return stitch_tracks(localization, detections)

    return cached(
        cache,
        "localization",
        Localization,
        track,
        detections=detections,
        scene=scene,
        settings=settings,
        silent=None if silent is None else silent.tolist(),
        camera_names=camera_names,
    )
