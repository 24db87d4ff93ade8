"""Running a detector and an embedder on every picture of synchronized videos, streaming."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from threading import Lock

import numpy as np
from jaxtyping import Float

from catfree.adapters.protocols import (
    BatchDetector,
    Detector,
    Embedder,
    FittedToCamera,
    FrameDetections,
    Image,
    ankles_confirmed,
)
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import (
    Describer,
    ask_for_people,
    join_descriptions,
    require_part,
    require_people,
)
from catfree.errors import InsufficientDataError, InvalidInputError, quoted
from catfree.types import Detections
from catfree.types._annotations import Progress, as_progress
from catfree.types._processes import processor_count
from catfree.types._validation import require_instance

# The people in a picture, and their embeddings if there is an embedder.
Seen = tuple[FrameDetections, Float[np.ndarray, "_ _"] | None]


def detect_videos(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    embedder: Embedder | None = None,
    progress: Progress | None = None,
) -> Detections:
    """Detect the people in all pictures of all cameras.

    A detector that must see a camera's footage first (`FittedToCamera`) is fitted to each camera,
    which decodes the videos once more. Only two instants and the detections are kept in memory.
    Missing pictures (`videos.silent`) are skipped: pass them on to `localize`.

    Args:
        videos: the cameras' pictures, instant by instant.
        detector: finds people in one picture.
        embedder: describes people's appearance, or None for no embeddings.
        progress: called as progress(stage, done, total) after each instant; stages are "fit" and
            "detect".

    Returns:
        One row per detected person, sorted by frame and camera, on the videos' clock; keypoints and
        confirmed ankles if the detector estimates poses.

    Raises:
        InvalidInputError: if detector or embedder cannot be called, or naming camera and frame of
            the first picture for which they return an invalid result.
        FileFormatError: if a picture cannot be decoded and `videos` was made with
            `on_error="raise"`.
        InsufficientDataError: if the footage is too short to fit the detector, or no instant can be
            decoded.
    """
    require_instance(videos, SynchronizedVideos, "videos")
    require_part(detector, "detector")
    if embedder is not None:
        require_part(embedder, "embedder")
    report = as_progress(progress)
    detectors = fit_to_cameras(videos, detector, report)
    describe = None if embedder is None else Describer(embedder)

    def instants() -> Iterator[tuple[int, dict[int, Seen]]]:
        for done, (frame, pictures) in enumerate(videos.pictures_from(), start=1):
            people = detect_instant(pictures, detectors, frame)
            yield frame, describe_instant(pictures, people, describe, frame)
            report("detect", done, videos.frame_count)

    return collect_detections(instants(), videos)


def fit_to_cameras(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    progress: Progress,
    *,
    known: Mapping[int, Detector] | None = None,
    learned: Callable[[int, Detector], None] | None = None,
) -> list[Detector]:
    """Return each camera's detector, fitted to its footage if necessary, else shared by all.

    Cameras are fitted in threads, several at a time. If a camera lacks so many pictures that too
    few remain for the fit, its detector finds nobody.

    Args:
        videos: the cameras' pictures.
        detector: as in `detect_videos`.
        progress: called as progress("fit", done, total) after each picture of each camera.
        known: detectors of cameras that were fitted before.
        learned: called with camera and detector when a camera has been fitted, from its thread.

    Raises:
        InsufficientDataError: naming the camera whose footage is too short.
    """
    if not isinstance(detector, FittedToCamera):
        return [detector] * videos.camera_count
    before = {} if known is None else known
    total = sum(one.pictures for at, one in enumerate(videos.footage) if at not in before)
    numbers, lock = count(1), Lock()

    def report() -> None:
        with lock:
            progress("fit", next(numbers), total)

    def fit(camera: int) -> Detector:
        if camera in before:
            return before[camera]
        fitted = fit_to_camera(videos, detector, camera, report)
        if learned is not None:
            learned(camera, fitted)
        return fitted

    with ThreadPoolExecutor(min(videos.camera_count, processor_count())) as pool:
        return list(pool.map(fit, range(videos.camera_count)))


def fit_to_camera(
    videos: SynchronizedVideos,
    detector: FittedToCamera,
    camera: int,
    report: Callable[[], None],
) -> Detector:
    """Return the detector of one camera; it finds nobody if the camera lacks too many pictures.

    Args:
        videos: the cameras' pictures.
        detector: the detector to fit.
        camera: its index.
        report: called after each picture.

    Raises:
        InsufficientDataError: naming the camera, if its footage is too short.
    """

    def pictures() -> Iterator[Image]:
        for image in videos.pictures_of(camera):
            yield image
            report()

    try:
        fitted = detector.fit(pictures())
    except (InsufficientDataError, InvalidInputError) as error:
        lacks_pictures = videos.footage[camera].pictures < videos.frame_count
        if isinstance(error, InsufficientDataError) and lacks_pictures:
            return Blind()
        name = f"Camera {camera} ({quoted(videos.camera_names[camera])})"
        raise type(error)(f"{name}: {error}") from error
    if not callable(fitted):
        raise InvalidInputError(
            f"{type(detector).__name__}.fit returned {type(fitted).__name__} for camera {camera} "
            f"({quoted(videos.camera_names[camera])}); it must return a detector."
        )
    return fitted


class Blind:
    """The detector of a camera with too few pictures: it finds nobody."""

    fingerprint = "blind"

    def __call__(self, image: Image) -> FrameDetections:
        """Return no people."""
        return FrameDetections(np.zeros((0, 4)), np.zeros(0))

    def look_again(self, image: Image, places: Float[np.ndarray, "n 3"]) -> FrameDetections:
        """Return no people, wherever they are expected."""
        return self(image)


def detect_instant(
    pictures: Mapping[int, Image],
    detectors: Mapping[int, Detector] | Sequence[Detector],
    frame: int,
) -> dict[int, FrameDetections]:
    """Detect the people in each camera's picture of one instant, all at once if one detector can.

    Args:
        pictures: by camera; those that exist.
        detectors: by camera.
        frame: the frame of the instant, for messages.

    Returns:
        The people by camera.

    Raises:
        InvalidInputError: naming camera and frame, if a detector returns anything but
            `FrameDetections`.
    """
    shared = next((detectors[camera] for camera in pictures), None)
    if isinstance(shared, BatchDetector) and all(detectors[c] is shared for c in pictures):
        answers = shared.detect_batch(list(pictures.values()))
        if not isinstance(answers, list | tuple) or len(answers) != len(pictures):
            raise InvalidInputError(
                f"{type(shared).__name__}.detect_batch, called for {len(pictures)} pictures of "
                f"frame {frame}, must return {len(pictures)} FrameDetections in a list."
            )
        return {
            camera: require_people(people, shared, camera, frame)
            for camera, people in zip(pictures, answers, strict=True)
        }
    return {
        camera: ask_for_people(detectors[camera], picture, camera, frame)
        for camera, picture in pictures.items()
    }


def describe_instant(
    pictures: Mapping[int, Image],
    people: Mapping[int, FrameDetections],
    describe: Describer | None,
    frame: int,
) -> dict[int, Seen]:
    """Add the embeddings of the people in each camera's picture of one instant.

    Args:
        pictures: by camera.
        people: the people in the picture of each camera.
        describe: computes the embeddings, or None.
        frame: the frame of the instant, for messages.

    Raises:
        InvalidInputError: as `Describer`.
    """
    return {
        camera: (found, describe and describe(pictures[camera], found.box, camera, frame))
        for camera, found in people.items()
    }


def collect_detections(
    instants: Iterable[tuple[int, dict[int, Seen]]], videos: SynchronizedVideos
) -> Detections:
    """Join the people in all pictures; keypoints and embeddings only if every picture has them.

    Args:
        instants: frame, and the people seen in each existing picture by camera.
        videos: the footage, for its clock.

    Raises:
        InsufficientDataError: if there are no instants, because none could be decoded.
    """
    rows = [
        (frame, camera, *seen)
        for frame, by_camera in instants
        for camera, seen in by_camera.items()
    ]
    if not rows:
        raise InsufficientDataError(f"No instant could be decoded: {videos.interruption}")
    frame, camera, people, embedding = zip(*rows, strict=True)
    count = [len(one) for one in people]
    vectors = [one for one in embedding if one is not None]
    poses = [one.keypoints for one in people if one.keypoints is not None]
    keypoints = np.concatenate(poses) if len(poses) == len(people) else None
    return Detections(
        np.repeat(frame, count),
        np.repeat(camera, count),
        # Whatever the precision of a detector's network, people are localized in double precision.
        np.concatenate([one.box for one in people]).astype(np.float64),
        score=np.concatenate([one.score for one in people]),
        ankles_confirmed=None if keypoints is None else ankles_confirmed(keypoints),
        embedding=join_descriptions(vectors) if len(vectors) == len(people) else None,
        keypoints=keypoints,
        clock=videos.clock,
    )
