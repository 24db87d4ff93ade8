"""`run`: from RGB videos to tracks on the ground, with cached stages."""

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Int

from catfree._run._cache import StageCache
from catfree._run._input_checks import (
    Recording,
    before_damage,
    calibration_warnings,
    clock_warnings,
    footage_warnings,
    match_cameras,
    open_recording,
    require_distinct_videos,
    scene_of,
    tiny_boxes,
    without_offsets,
)
from catfree._run._stages import (
    calibrate_cameras,
    detect_again,
    localize_people,
    reconstruct,
    refine_cameras,
)
from catfree._run.detection._cached_detection import detect_with_cache
from catfree._run.detection._camera_detectors import CameraDetectors
from catfree.adapters.background._background_detector import BackgroundDetector
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.adapters.embedders._color_embedder import ColorEmbedder
from catfree.adapters.protocols import (
    Detector,
    Embedder,
    FittedToCamera,
    Reconstructor,
    SceneSource,
)
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import require_part
from catfree.calibration import Calibration
from catfree.calibration.people import Anchor, resolve_anchors
from catfree.errors import InvalidInputError, quoted
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress
from catfree.types._processes import require_own_process
from catfree.types._rig import require_pinholes
from catfree.types._validation import as_count, require_instance, require_no_boxes

_ONLY_FROM_PEOPLE = (
    "Anchors and a largest offset apply to cameras found from people; leave them out, or leave out "
    "scene and reconstructor."
)

Videos = SynchronizedVideos | Sequence[str | os.PathLike[str]]


@dataclass(frozen=True)
class RunOutcome:
    """Results of all stages of a run.

    Attributes:
        localization: tracks, candidates, thresholds and reliability.
        detections: boxes of all cameras, after the second look if there was one;
            `localization.identity` and the tracks' `support` index them.
        scene: cameras and ground.
        calibration: the calibration from people, or None if the scene has another source.
        camera_names: (C,) names of the cameras, from their file names; from the scene for boxes
            that only number cameras.
        frames: (T,) the processed frames.
        videos: the footage before any damage, on corrected clocks if offsets were searched; None if
            the outcome does not come from videos.
        silent: (K, 2) frame and camera of missing pictures.
        offsets: (C,) the frame of each camera's video that shows frame 0; () if all are 0.
    """

    localization: Localization
    detections: Detections
    scene: Scene
    calibration: Calibration | None
    camera_names: tuple[str, ...]
    frames: np.ndarray
    videos: SynchronizedVideos | None = None
    silent: Int[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    offsets: tuple[int, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about problems with the input."""
        return self.localization.warnings


@dataclass
class Unfinished:
    """Partial results of a run, filled as it proceeds and available after an error.

    Attributes:
        recording: the footage, once it is open, or boxes.
        detections: boxes of all cameras, once detection has finished.
        warnings: sentences about the input.
    """

    recording: Recording | None = None
    detections: Detections | None = None
    warnings: tuple[str, ...] = ()


def run(
    videos: Videos,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    reconstructor: Reconstructor | None = None,
    scene: Scene | SceneSource | str | os.PathLike[str] | None = None,
    settings: Settings | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    *,
    scene_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    anchors: Sequence[Anchor] = (),
    refine: bool = False,
    workers: int = 1,
) -> Localization:
    """Track people on the ground from the videos of several static cameras.

        tracks = cf.run(["north.mp4", "east.mp4", "south.mp4"]).tracks

    Args:
        videos: one video file or image folder per camera, or `SynchronizedVideos` to specify
            clocks, frame rates or the part to use. With files, instants shown by at least two
            cameras are used; missing pictures are not evidence.
        detector: finds people in an image; None for `BackgroundDetector`, which needs no weights.
        embedder: computes appearance embeddings; None for `ColorEmbedder` with a
            `BackgroundDetector`, and for no appearance with other detectors.
        reconstructor: finds the cameras from the images of one instant; they are then adjusted to
            the people, as `refine` does.
        scene: known cameras and ground: a `Scene`, an object with an attribute `scene` (the result
            of `calibrate`, `refine`, an earlier run or a reader of calibration files), or a file
            or folder that `read_scene` reads. Without scene and reconstructor, both are found from
            the people in the videos (`calibrate`), in meters.
        settings: settings of calibration and localization; None for `Settings()`. The calibration
            uses the detector's `box_slack`, if it has one and the settings keep the default, and
            boxes with a score of at least `calibration_confidence`.
        cache_dir: folder for finished stages. A killed run resumes from them with an identical
            result; other videos, weights, settings or code never reuse them.
        progress: called as `progress(stage, done, total)`.
        scene_names: (C,) names of the scene's cameras, to match videos in another order by name;
            None takes those of the scene's file, data set or run.
        maximum_offset: largest clock offset, in frames, at which to search for cameras that fit
            poorly or nowhere, if the cameras are found from people; lags of a few frames are always
            corrected.
        anchors: independent measurements of the site, if the cameras are found from people; see
            `calibrate`.
        refine: adjust the cameras of `scene` to the people (`cf.refine`), for cameras from a
            reconstruction, or that moved slightly since their calibration. Cameras that the run
            finds are always adjusted.
        workers: spawned processes that detect people, at most one per camera, for detectors that
            learn each camera's background. In a script, more than one needs
            `if __name__ == "__main__":`.

    Returns:
        The result of `localize` for the scene, with `warnings` about the input. The default method
        also joins fragments of one person's track by appearance and, with a detector that learns
        each camera's background, detects a second time where the first tracks predict people.
        `identity` and the tracks' `support` index the detections of the last pass, which
        `run_stages` also returns.

    Raises:
        InvalidInputError: if a video does not exist, two videos are equal byte for byte, or the
            cameras of the scene do not match the videos.
        FileFormatError: naming camera and frame, if an image cannot be decoded.
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
        scene_names=scene_names,
        maximum_offset=maximum_offset,
        anchors=anchors,
        refine=refine,
        workers=workers,
    ).localization


def run_stages(
    videos: Videos | CameraBoxes,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    reconstructor: Reconstructor | None = None,
    scene: Scene | SceneSource | str | os.PathLike[str] | None = None,
    settings: Settings | None = None,
    *,
    cache_dir: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    scene_names: Sequence[str] | None = None,
    maximum_offset: int = 0,
    anchors: Sequence[Anchor] = (),
    refine: bool = False,
    workers: int = 1,
    unfinished: Unfinished | None = None,
) -> RunOutcome:
    """Run as `run` does, but return the results of all stages.

    Args:
        videos: as `run`, or the boxes of all cameras, with the image sizes if there is no scene;
            then nothing is detected, and embedder and reconstructor are refused.
        detector: as `run`.
        embedder: as `run`.
        reconstructor: as `run`.
        scene: as `run`.
        settings: as `run`.
        cache_dir: as `run`.
        progress: as `run`.
        scene_names: as `run`.
        maximum_offset: as `run`.
        anchors: as `run`.
        refine: as `run`.
        workers: as `run`.
        unfinished: receives partial results as soon as they are available.

    Returns:
        Detections, scene, calibration and localization.

    Raises:
        CatFreeError: as `run`.
    """
    require_own_process()
    settings = Settings() if settings is None else settings
    require_instance(settings, Settings, "settings")
    workers = as_count(workers, "workers", least=1)
    maximum_offset = as_count(maximum_offset, "maximum_offset", least=0)
    scene, scene_names = scene_of(scene, scene_names)
    stages = {"detector": detector, "embedder": embedder, "reconstructor": reconstructor}
    for name, stage in stages.items():
        if stage is not None:
            require_part(stage, name)
    if scene is not None and reconstructor is not None:
        raise InvalidInputError("Pass a scene or a reconstructor, not both.")
    if (anchors or maximum_offset) and (scene is not None or reconstructor is not None):
        raise InvalidInputError(_ONLY_FROM_PEOPLE)
    recording = videos if isinstance(videos, CameraBoxes) else _opened(videos)
    so_far = Unfinished() if unfinished is None else unfinished
    so_far.recording = recording
    # Report mistakes before the long computation.
    if isinstance(recording, CameraBoxes):
        for name in ("embedder", "reconstructor"):
            if stages[name] is not None:
                raise InvalidInputError(
                    f"The {name} needs images, and boxes have none. Leave it out, or pass videos."
                )
        boxes = recording.detections
        require_no_boxes(recording.silent, boxes.frame, boxes.camera, recording.camera_names)
    else:
        so_far.warnings = footage_warnings(recording)
        require_distinct_videos(recording)
        resolve_anchors(anchors, recording.image_size, recording.camera_names)
    if scene is not None:
        scene, recording, matched = match_cameras(scene, scene_names, recording)
        so_far.warnings += matched
        if refine:
            require_pinholes(scene.rig)
    cache = None if cache_dir is None else StageCache(cache_dir)
    calibration, is_known = None, scene is not None
    with contextlib.ExitStack() as stack:
        cameras = None
        if isinstance(recording, CameraBoxes):
            detections = recording.detections
        else:
            detector = BackgroundDetector() if detector is None else detector
            if embedder is None and isinstance(detector, BackgroundDetector):
                embedder = ColorEmbedder()
            cameras = CameraDetectors(recording, detector, cache, progress, workers=workers)
            stack.enter_context(cameras)
            so_far.detections = detections = detect_with_cache(cameras, embedder)
            recording, damage = before_damage(recording)
            so_far.recording, so_far.warnings = recording, so_far.warnings + damage
            if reconstructor is not None:
                scene = reconstruct(
                    recording, reconstructor, detections, cache=cache, progress=progress
                )
        if scene is None:
            calibration = calibrate_cameras(
                recording,
                detector,
                detections,
                settings,
                maximum_offset=maximum_offset,
                anchors=anchors,
                cache=cache,
                progress=progress,
            )
            scene, offset = calibration.scene, calibration.frame_offset
            so_far.warnings += calibration_warnings(calibration, detections, recording, settings)
            if offset.any():
                recording, detections = without_offsets(recording, detections, offset)
                so_far.recording, so_far.detections = recording, detections
        elif refine or reconstructor is not None:
            scene, shortcoming = refine_cameras(
                detections, scene, settings, cache=cache, progress=progress
            )
            so_far.warnings += shortcoming
        if cameras is not None and isinstance(recording, SynchronizedVideos):
            detections = detect_again(recording, cameras, embedder, detections, scene, settings)
    so_far.warnings += tiny_boxes(detections, settings.calibration)
    names = tuple(recording.camera_names)
    localization = localize_people(
        detections, scene, settings, recording.silent,
        camera_names=names, cache=cache, progress=progress,
    )  # fmt: skip
    if is_known:
        so_far.warnings += clock_warnings(localization, detections, scene, recording, settings)
    localization = replace(localization, warnings=(*so_far.warnings, *localization.warnings))
    if isinstance(recording, SynchronizedVideos):
        frames, footage = recording.frames, recording
    else:
        frames, footage = np.union1d(detections.frame, localization.tracks.frame), None
    return RunOutcome(
        localization, detections, scene, calibration, names, frames, footage, recording.silent,
        recording.offsets,
    )  # fmt: skip


def _opened(videos: Videos) -> SynchronizedVideos:
    if isinstance(videos, SynchronizedVideos):
        return videos
    if isinstance(videos, str) or not isinstance(videos, Sequence) or not videos:
        raise InvalidInputError(
            f"videos must list one video file or image folder per camera, got {quoted(videos)}."
        )
    return open_recording(videos)
