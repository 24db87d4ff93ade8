"""Detection in cached pieces, so that a killed run resumes where it stopped."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, islice

import numpy as np
from jaxtyping import Float

from catfree._run._cache import content_key
from catfree._run.detection._camera_detectors import DETECTION_CODE, CameraDetectors, Instant
from catfree.adapters.protocols import Detector, Embedder, FrameDetections, Image
from catfree.adapters.video._detect_videos import (
    Seen,
    collect_detections,
    describe_instant,
    detect_instant,
)
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import Describer, join_descriptions
from catfree.errors import InsufficientDataError
from catfree.types import Detections
from catfree.types._detections import concatenate_common
from catfree.types._sampling import rows_of_picture

# Instants per piece, the most that a killed run loses: with six cameras, a network on a CPU needs
# about a minute for a piece.
PIECE = 20


@dataclass(frozen=True)
class PieceEmbeddings:
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
    looks: PieceEmbeddings | None

    @property
    def complete(self) -> bool:
        return self.boxes is not None and (self.look_key is None or self.looks is not None)


def _look(
    describe: Describer | None,
    known: Mapping[int, Detections],
    detectors: Mapping[int, Detector],
    frame: int,
    pictures: Mapping[int, Image],
) -> dict[int, Seen]:
    """Detect people, unless their boxes are known by frame, and describe them, at one instant."""
    if frame in known:
        people = {camera: _stored(known[frame], frame, camera) for camera in pictures}
    else:
        people = detect_instant(pictures, detectors, frame)
    return describe_instant(pictures, people, describe, frame)


def _stored(boxes: Detections, frame: int, camera: int) -> FrameDetections:
    rows = rows_of_picture(boxes.frame, boxes.camera, frame, camera)
    score = np.ones(len(boxes)) if boxes.score is None else boxes.score
    return FrameDetections(boxes.box[rows], score[rows])


def detect_with_cache(cameras: CameraDetectors, embedder: Embedder | None) -> Detections:
    """Detect as `detect_videos` does, in pieces of a few instants that later runs reuse.

    Boxes and embeddings are cached separately: a change of the embedder does not repeat detection.

    Args:
        cameras: the detectors of the cameras, with their footage and the cache, if any.
        embedder: computes the embeddings, or None.

    Returns:
        One row per box, sorted by frame and camera.

    Raises:
        InvalidInputError: if the detector or embedder has no fingerprint.
        InsufficientDataError: as `detect_videos`.
        FileFormatError: as `detect_videos`.
        WriteError: if a finished piece cannot be stored.
    """
    videos, pieces = cameras.videos, _pieces(cameras, embedder)
    describe = None if embedder is None else Describer(embedder)
    if all(piece.complete for piece in pieces):
        cameras.progress("detect", videos.frame_count, videos.frame_count)
    for is_complete, some in groupby(pieces, lambda piece: piece.complete):
        if is_complete:
            continue
        stretch = list(some)
        known = {
            int(frame): piece.boxes
            for piece in stretch
            for frame in videos.frames[piece.first : piece.first + piece.count]
            if piece.boxes is not None
        }
        look = partial(_look, describe, known)
        unknown = any(piece.boxes is None for piece in stretch)
        instants = cameras.instants(videos, look, stretch[0].first, stage="detect", detect=unknown)
        for piece in stretch:
            _complete(piece, list(islice(instants, piece.count)), cameras)
        if videos.interruption is not None:
            break
    return _join([piece for piece in pieces if piece.complete], videos)


def _pieces(cameras: CameraDetectors, embedder: Embedder | None) -> list[_Piece]:
    videos, detector, cache = cameras.videos, cameras.detector, cameras.cache
    if cache is None:
        return [_Piece(0, videos.frame_count, "", None, None, None)]
    footage = videos.fingerprint
    pieces = []
    for first in range(0, videos.frame_count, PIECE):
        count = min(PIECE, videos.frame_count - first)
        box_key = content_key(
            "boxes", *DETECTION_CODE, videos=footage, detector=detector, first=first, count=count
        )
        look_key = None
        if embedder is not None:
            look_key = content_key("looks", *DETECTION_CODE, boxes=box_key, embedder=embedder)
        boxes = cache.load("boxes", box_key, Detections)
        looks = None if look_key is None else cache.load("looks", look_key, PieceEmbeddings)
        if boxes is not None and looks is not None and len(looks.embedding) != len(boxes):
            looks = None
        pieces.append(_Piece(first, count, box_key, look_key, boxes, looks))
    return pieces


def _complete(piece: _Piece, instants: list[Instant[Seen]], cameras: CameraDetectors) -> None:
    """Compute missing results of a piece; store them unless the videos ended inside the piece."""
    if not instants:
        return
    seen = collect_detections(instants, cameras.videos)
    keep = cameras.cache if len(instants) == piece.count else None
    if piece.boxes is None:
        piece.boxes = replace(seen, embedding=None, clock=None)
        if keep is not None:
            keep.store("boxes", piece.box_key, piece.boxes)
    if seen.embedding is not None:
        piece.looks = PieceEmbeddings(seen.embedding)
        if keep is not None and piece.look_key is not None:
            keep.store("looks", piece.look_key, piece.looks)


def _join(pieces: Sequence[_Piece], videos: SynchronizedVideos) -> Detections:
    if not pieces:
        raise InsufficientDataError(f"No instant could be decoded: {videos.interruption}")
    boxes = concatenate_common([piece.boxes for piece in pieces if piece.boxes is not None])
    looks = [piece.looks.embedding for piece in pieces if piece.looks is not None]
    embedding = join_descriptions(looks) if looks else None
    return replace(boxes, embedding=embedding, clock=videos.clock)
