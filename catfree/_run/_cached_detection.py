"""Detection in cached pieces, so that a killed run resumes where it stopped."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree._run._cache import StageCache, code_hash
from catfree.adapters.background._background_detector import (
    BackgroundDetector,
    FittedBackgroundDetector,
)
from catfree.adapters.background._foreground_memory import ForegroundMemory
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import (
    BatchDetector,
    Detector,
    Embedder,
    FittedToCamera,
    FrameDetections,
    Image,
)
from catfree.adapters.video._detect_videos import collect_detections, detect_instant, fit_to_cameras
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import Describer, join_descriptions
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.types import Detections
from catfree.types._annotations import Progress

# Instants per piece. A network on a CPU needs about a minute for six cameras: the most that a kill
# loses.
PIECE = 20


@dataclass(frozen=True)
class Appearance:
    """Embeddings (n, D) of a piece, in the order of its boxes."""

    embedding: Float[np.ndarray, "n d"]


@dataclass
class _Piece:
    """Consecutive instants and their cached results."""

    first: int
    count: int
    box_key: str
    look_key: str | None
    boxes: Detections | None
    looks: Appearance | None

    @property
    def complete(self) -> bool:
        return self.boxes is not None and (self.look_key is None or self.looks is not None)


def detect_with_cache(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    embedder: Embedder | None,
    cache: StageCache,
    progress: Progress | None = None,
) -> Detections:
    """Run `detect_videos` in pieces of a few instants that later runs reuse.

    Boxes and embeddings are cached separately: another embedder does not repeat the detection.

    Args:
        videos: the cameras' images, instant by instant.
        detector: finds people in one image.
        embedder: computes their embeddings, or None.
        cache: holds finished pieces.
        progress: called as progress(stage, done, total) after each instant.

    Returns:
        One row per box, sorted by frame and camera.

    Raises:
        InvalidInputError: if detector or embedder have no fingerprint.
        InsufficientDataError: as `detect_videos`.
        FileFormatError: as `detect_videos`.
        WriteError: if a finished piece cannot be stored.
    """
    pieces = _pieces(videos, detector, embedder, cache)
    missing = [at for at, piece in enumerate(pieces) if not piece.complete]
    if missing:
        span = pieces[missing[0] : missing[-1] + 1]
        detectors: list[Detector] = []
        if any(piece.boxes is None for piece in span):
            detectors = fit_with_cache(videos, detector, cache, progress)
        shared = detector if isinstance(detector, BatchDetector) else None
        describe = None if embedder is None else Describer(embedder)
        stream = videos.pictures_from(span[0].first)
        for piece in span:
            instants = islice(stream, piece.count)
            if piece.complete:
                deque(instants, maxlen=0)  # decode and discard
            else:
                counted = _counted(instants, piece.first, videos.frame_count, progress)
                _complete(piece, counted, detectors, shared, describe, cache)
            if videos.interruption is not None:
                break
    elif progress is not None:
        progress("detect", videos.frame_count, videos.frame_count)
    return _join([piece for piece in pieces if piece.complete], videos)


def fit_with_cache(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    cache: StageCache,
    progress: Progress | None = None,
) -> list[Detector]:
    """Run `fit_to_cameras`, caching each background as soon as it is learned.

    Args:
        videos: as `fit_to_cameras`.
        detector: as `fit_to_cameras`.
        cache: holds backgrounds that an earlier run learned.
        progress: as `fit_to_cameras`.

    Raises:
        WriteError: if a background cannot be stored.
    """
    if not isinstance(detector, BackgroundDetector):
        return fit_to_cameras(videos, detector, progress)
    stage, common = "background", (code_hash("adapters", "types"), videos.fingerprint)

    def key(camera: int) -> str:
        return hash_parameters(stage, *common, detector.fingerprint, camera=camera)

    def keep(camera: int, fitted: Detector) -> None:
        if isinstance(fitted, FittedBackgroundDetector):
            cache.store(stage, key(camera), replace(fitted, memory=None))

    known: dict[int, Detector] = {}
    for camera in range(videos.camera_count):
        stored = cache.load(stage, key(camera), FittedBackgroundDetector)
        if stored is not None:
            memory = ForegroundMemory(stored.background.compare)
            known[camera] = replace(stored, memory=memory)
    return fit_to_cameras(videos, detector, progress, known=known, learnt=keep)


def fingerprint_of(part: Any, role: str) -> str:
    """Return the content hash of a detector, embedder or reconstructor.

    Args:
        part: the detector, embedder or reconstructor.
        role: what the part is, for the message.

    Raises:
        InvalidInputError: if it has none, so that results of different parts cannot be told apart.
    """
    fingerprint = getattr(part, "fingerprint", None)
    if not isinstance(fingerprint, str) or not fingerprint:
        raise InvalidInputError(
            f"The {role} {type(part).__name__} has no fingerprint, so its results cannot be "
            "cached. Give it a property `fingerprint` that identifies weights and parameters, or "
            "run without cache_dir."
        )
    return fingerprint


def _pieces(
    videos: SynchronizedVideos,
    detector: Detector | FittedToCamera,
    embedder: Embedder | None,
    cache: StageCache,
) -> list[_Piece]:
    common = (code_hash("adapters", "types"), videos.fingerprint)
    finder = fingerprint_of(detector, "detector")
    pieces = []
    for first in range(0, videos.frame_count, PIECE):
        count = min(PIECE, videos.frame_count - first)
        box_key = hash_parameters("boxes", *common, finder, first=first, count=count)
        look_key = None
        if embedder is not None:
            look_key = hash_parameters("looks", box_key, fingerprint_of(embedder, "embedder"))
        boxes = cache.load("boxes", box_key, Detections)
        looks = None if look_key is None else cache.load("looks", look_key, Appearance)
        if boxes is not None and looks is not None and len(looks.embedding) != len(boxes):
            looks = None
        pieces.append(_Piece(first, count, box_key, look_key, boxes, looks))
    return pieces


def _counted(
    instants: Iterator[tuple[int, dict[int, Image]]],
    first: int,
    total: int,
    progress: Progress | None,
) -> Iterator[tuple[int, dict[int, Image]]]:
    for done, instant in enumerate(instants, start=first + 1):
        yield instant
        if progress is not None:
            progress("detect", done, total)


def _complete(
    piece: _Piece,
    instants: Iterator[tuple[int, dict[int, Image]]],
    detectors: Sequence[Detector],
    shared: BatchDetector | None,
    describe: Describer | None,
    cache: StageCache,
) -> None:
    """Compute what the piece lacks; store it unless the videos ended inside the piece."""
    cached_boxes = piece.boxes
    found, embedding = [], []
    instant_count = 0
    for tick, pictures in instants:
        instant_count += 1
        if cached_boxes is None:
            instant = detect_instant(pictures, detectors, shared, tick)
        else:
            instant = {index: _stored(cached_boxes, tick, index) for index in pictures}
        for index, people in instant.items():
            found.append((tick, index, people))
            if describe is not None:
                embedding.append(describe(pictures[index], people.box, index, tick))
    if not found:
        return
    is_whole = instant_count == piece.count
    if cached_boxes is None:
        piece.boxes = collect_detections(found, None)
        if is_whole:
            cache.store("boxes", piece.box_key, piece.boxes)
    if piece.look_key is not None:
        piece.looks = Appearance(join_descriptions(embedding))
        if is_whole:
            cache.store("looks", piece.look_key, piece.looks)


def _stored(boxes: Detections, tick: int, camera: int) -> FrameDetections:
    rows = (boxes.frame == tick) & (boxes.camera == camera)
    score = np.ones(len(boxes)) if boxes.score is None else boxes.score
    return FrameDetections(boxes.box[rows], score[rows])


def _join(pieces: Sequence[_Piece], videos: SynchronizedVideos) -> Detections:
    if not pieces:
        raise InsufficientDataError(f"No instant could be decoded: {videos.interruption}")
    # Empty pieces do not tell whether there are poses, or how long embeddings are.
    peopled = [piece for piece in pieces if piece.boxes is not None and len(piece.boxes)]
    peopled = peopled or list(pieces[:1])
    columns: dict[str, Any] = {}
    for name in ("frame", "camera", "box", "score", "ankles_confirmed", "keypoints"):
        values = [getattr(piece.boxes, name) for piece in peopled]
        complete = all(value is not None for value in values)
        columns[name] = np.concatenate(values) if complete else None
    looks = [piece.looks.embedding for piece in peopled if piece.looks is not None]
    columns["embedding"] = np.concatenate(looks) if len(looks) == len(peopled) else None
    return Detections(**columns, clock=videos.clock)
