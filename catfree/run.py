"""`run`: RGB video in, tracks on the ground out; every stage resumes from its cache."""

import dataclasses
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from catfree.adapters.background import BackgroundDetector
from catfree.adapters.color import ColorEmbedder
from catfree.adapters.detect import detect_videos
from catfree.adapters.fingerprint import hash_parameters
from catfree.adapters.protocols import Detector, Embedder, FittedToCamera, Reconstructor
from catfree.adapters.video import SynchronizedVideos
from catfree.cache import StageCache, code_hash, content_hash
from catfree.cached_detection import detect_with_cache, fingerprint_of
from catfree.errors import InvalidInputError
from catfree.pipeline import localize
from catfree.rig.pedestrians import Calibration, CalibrationSettings, calibrate
from catfree.settings import Settings
from catfree.trajectories.stitch import stitch_tracks
from catfree.types import Detections, Localization, Scene
from catfree.types.validation import require_instance

Progress = Callable[[str, int, int], None]
Videos = SynchronizedVideos | Sequence[str | os.PathLike[str]]
T = TypeVar("T")

# A rig needs boxes whose edges are right more than it needs everybody: half-hidden people and
# doubtful splits of groups score lower than this.
CALIBRATION_CONFIDENCE = 0.55


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
        settings: of the localization, `Settings()` if None.
        cache_dir: folder in which finished stages are kept. A run that was killed goes on from
            there with an identical result; other videos, weights, settings or code never reuse it.
        progress: called as `progress(stage, done, total)`.

    Returns:
        What `localize` gives for the scene.

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
    calibration_settings: CalibrationSettings | None = None,
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
        calibration_settings: of the calibration from people, its defaults if None.
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
        videos = SynchronizedVideos(videos)
    if scene is not None:
        _require_same_cameras(scene, videos)
    detector = BackgroundDetector() if detector is None else detector
    if embedder is None and isinstance(detector, BackgroundDetector):
        embedder = ColorEmbedder()
    cache = None if cache_dir is None else StageCache(cache_dir)

    detections = detect(videos, detector, embedder, cache=cache, progress=progress)
    calibration = None
    if reconstructor is not None:
        scene = reconstruct(videos, reconstructor, detections, cache=cache, progress=progress)
    elif scene is None:
        calibration = calibrate_cameras(
            videos, detections, calibration_settings, cache=cache, progress=progress
        )
        scene = calibration.scene
    known, chosen = scene, settings
    localization = _cached(
        cache,
        "localization",
        Localization,
        lambda: _localize(detections, known, chosen, progress),
        (content_hash(detections), content_hash(scene)),
        settings,
    )
    return RunOutcome(
        localization, detections, scene, calibration, tuple(videos.camera_names), videos.frames
    )


def detect(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    embedder: Embedder | None = None,
    *,
    cache: StageCache | None = None,
    progress: Progress | None = None,
) -> Detections:
    """The first stage: everybody whom the cameras saw; see `detect_videos`."""
    if cache is None:
        return detect_videos(videos, detector, embedder, progress)
    return detect_with_cache(videos, detector, embedder, cache, progress)


def calibrate_cameras(
    videos: SynchronizedVideos,
    detections: Detections,
    settings: CalibrationSettings | None = None,
    *,
    cache: StageCache | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """The second stage without a known scene: cameras and ground from confident boxes of people.

    Args:
        videos: whose picture sizes and names count.
        detections: everybody whom the cameras saw.
        settings: of the calibration, its defaults if None.
        cache: where a finished calibration is.
        progress: called as `progress(stage, done, total)`.

    Raises:
        CalibrationError: if no rig can be found from the people.
    """
    settings = settings or CalibrationSettings()
    if detections.score is not None:
        detections = detections[detections.score >= CALIBRATION_CONFIDENCE]
    return _cached(
        cache,
        "calibration",
        Calibration,
        lambda: calibrate(
            detections,
            videos.image_size,
            settings,
            camera_names=videos.camera_names,
            progress=progress,
        ),
        (content_hash(detections), *videos.camera_names),
        settings,
        image_size=videos.image_size.tolist(),
    )


def reconstruct(
    videos: SynchronizedVideos,
    reconstructor: Reconstructor,
    detections: Detections,
    *,
    cache: StageCache | None = None,
    progress: Progress | None = None,
) -> Scene:
    """The second stage with a reconstructor: some instants, aggregated to one static rig."""
    from catfree.rig.aggregate import scene_from_videos

    keys = ()
    if cache is not None:
        weights = fingerprint_of(reconstructor, "reconstructor")
        keys = (videos.fingerprint, weights, content_hash(detections))
    return _cached(
        cache,
        "scene",
        Scene,
        lambda: scene_from_videos(videos, reconstructor, detections, progress),
        keys,
    )


def _localize(
    detections: Detections, scene: Scene, settings: Settings, progress: Progress | None
) -> Localization:
    localization = localize(detections, scene, settings, progress)
    if settings.method == "paper":
        return localization
    return stitch_tracks(localization, detections, scene)


def _cached(
    cache: StageCache | None,
    stage: str,
    kind: type[T],
    compute: Callable[[], T],
    follows_from: tuple[str, ...],
    settings: object = None,
    **parameters: object,
) -> T:
    """The result of a stage, from the cache if it is there."""
    if cache is None:
        return compute()
    asked = dataclasses.asdict(settings) if dataclasses.is_dataclass(settings) else settings  # type: ignore[arg-type]
    key = hash_parameters(stage, code_hash(), *follows_from, settings=asked, **parameters)
    return cache.result(stage, key, kind, compute)


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
