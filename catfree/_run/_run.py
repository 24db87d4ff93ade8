"""`run`: RGB video in, tracks on the ground out; every stage resumes from its cache."""

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from catfree._run._cache import StageCache
from catfree._run._stages import (
    calibrate_cameras,
    detect,
    detect_again,
    localize_people,
    reconstruct,
)
from catfree.adapters.background._background_detector import BackgroundDetector
from catfree.adapters.embedders._color_embedder import ColorEmbedder
from catfree.adapters.protocols import Detector, Embedder, FittedToCamera, Reconstructor
from catfree.adapters.video._detect_videos import fit_to_cameras
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.calibration import Calibration
from catfree.errors import InvalidInputError
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._progress import Progress
from catfree.types._validation import require_instance

Videos = SynchronizedVideos | Sequence[str | os.PathLike[str]]


@dataclass(frozen=True)
class RunOutcome:
    """What a run found, stage by stage.

    Attributes:
        localization: tracks, candidates, thresholds and reliability.
        detections: everybody whom the cameras saw.
        scene: cameras and ground.
        calibration: how the scene was found from people, or None where it came from elsewhere.
        camera_names: (C,) names of the cameras, after their files.
        frames: (T,) the frames that were looked at.
    """

    localization: Localization
    detections: Detections
    scene: Scene
    calibration: Calibration | None
    camera_names: tuple[str, ...]
    frames: np.ndarray


def run(
    videos: Videos,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    reconstructor: Reconstructor | None = None,
    scene: Scene | None = None,
    settings: Settings | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Track people on the ground from the videos of several static cameras.

        tracks = cf.run(["north.mp4", "east.mp4", "south.mp4"]).tracks

    Args:
        videos: one video file or image folder a camera, or `SynchronizedVideos` where clocks,
            frame rates or the part to use must be said.
        detector: finds people in a picture; None for `BackgroundDetector`, which needs no weights.
        embedder: describes what people look like; None for `ColorEmbedder` with a
            `BackgroundDetector`, and for no appearance with other detectors.
        reconstructor: finds the cameras from the pictures of one instant.
        scene: known cameras and ground. Without scene and reconstructor both are found from the
            people who walk through the pictures (`calibrate`), in metres.
        settings: of calibration and localization, `Settings()` if None. The calibration takes the
            detector's `box_slack`, if it states one, unless the settings say another than usual,
            and boxes of a score of at least `calibration_confidence`.
        cache_dir: folder in which finished stages are kept. A run that was killed goes on from
            there with an identical result; other videos, weights, settings or code never reuse it.
        progress: called as `progress(stage, done, total)`.

    Returns:
        What `localize` gives for the scene. With the default method, and a detector that learns
        each camera's background, after a second look at the pictures where the tracks of the first
        say that people should stand; and with the pieces of one person's track joined by their
        looks (`catfree._run._stitch`).

    Raises:
        InvalidInputError: if a video does not exist or the scene has other cameras.
        FileFormatError: naming camera and frame, if a picture cannot be decoded.
        InsufficientDataError: if there is too little footage.
        CalibrationError: if no rig can be found from the people.
        WriteError: if the cache cannot be written.
    """
    return run_stages(
        videos,
        detector,
        embedder,
        reconstructor,
        scene,
        settings,
        cache_dir=cache_dir,
        progress=progress,
    ).localization


def run_stages(
    videos: Videos,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    reconstructor: Reconstructor | None = None,
    scene: Scene | None = None,
    settings: Settings | None = None,
    *,
    cache_dir: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> RunOutcome:
    """`run` with the results of all stages.

    Args:
        videos: as `run`.
        detector: as `run`.
        embedder: as `run`.
        reconstructor: as `run`.
        scene: as `run`.
        settings: as `run`.
        cache_dir: as `run`.
        progress: as `run`.

    Returns:
        Detections, scene, calibration and localization.

    Raises:
        CatFreeError: as `run`.
    """
    settings = Settings() if settings is None else settings
    require_instance(settings, Settings, "settings")
    if scene is not None:
        require_instance(scene, Scene, "scene")
    stages = {"detector": detector, "embedder": embedder, "reconstructor": reconstructor}
    for name, stage in stages.items():
        if not (stage is None or callable(stage) or hasattr(stage, "fit")):
            raise InvalidInputError(
                f"{name} must be an object that can be called, such as those of catfree.adapters, "
                f"got {stage!r}."
            )
    if scene is not None and reconstructor is not None:
        raise InvalidInputError("Pass a scene or a reconstructor, not both.")
    if not isinstance(videos, SynchronizedVideos):
        if isinstance(videos, str | os.PathLike) or not videos:
            raise InvalidInputError(
                f"videos must list one video file or image folder a camera, got {videos!r}."
            )
        videos = SynchronizedVideos(videos)
    if scene is not None:
        _require_same_cameras(scene, videos)
    detector = BackgroundDetector() if detector is None else detector
    if embedder is None and isinstance(detector, BackgroundDetector):
        embedder = ColorEmbedder()
    cache = None if cache_dir is None else StageCache(cache_dir)

    fitted = None
    if cache is None and isinstance(detector, FittedToCamera):
        fitted = fit_to_cameras(videos, detector, progress)
    detections = detect(videos, detector, embedder, fitted=fitted, cache=cache, progress=progress)
    calibration = None
    if reconstructor is not None:
        scene = reconstruct(videos, reconstructor, detections, cache=cache, progress=progress)
    elif scene is None:
        calibration = calibrate_cameras(
            videos, detector, detections, settings, cache=cache, progress=progress
        )
        scene = calibration.scene
    if settings.method != "paper" and isinstance(detector, FittedToCamera):
        detections = detect_again(
            videos,
            detector,
            embedder,
            detections,
            scene,
            settings,
            fitted=fitted,
            cache=cache,
            progress=progress,
        )
    localization = localize_people(detections, scene, settings, cache=cache, progress=progress)
    return RunOutcome(
        localization, detections, scene, calibration, tuple(videos.camera_names), videos.frames
    )


def _require_same_cameras(scene: Scene, videos: SynchronizedVideos) -> None:
    rig = scene.rig
    if rig.camera_count != videos.camera_count:
        raise InvalidInputError(
            f"The scene has {rig.camera_count} cameras, but there are {videos.camera_count} "
            "videos. Pass one video a camera, in the order of the rig."
        )
    other = (rig.image_size != videos.image_size).any(axis=1)
    if other.any():
        at = int(np.argmax(other))
        raise InvalidInputError(
            f"Camera {at} of the scene has pictures of {' x '.join(map(str, rig.image_size[at]))} "
            f"px, but its video {videos.camera_names[at]!r} has "
            f"{' x '.join(map(str, videos.image_size[at]))} px."
        )
