"""MOTChallenge text: boxes of one camera, and ground tracks in a form that TrackEval scores."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.files._text_rows import naming_line, read_rows
from catfree.errors import InvalidInputError
from catfree.types import Detections, Tracks
from catfree.types._validation import (
    as_integer,
    as_path,
    as_positive,
    as_rows,
    require_finite,
    require_instance,
)

# TrackEval matches two boxes at an overlap of 0.5. Squares of side s that are shifted along one
# axis by d overlap by (s - d) / (s + d), which is 0.5 at d = s / 3.
_SIDES_PER_THRESHOLD = 3.0
_ROWS = "MOTChallenge rows: frame, id, left, top, width, height, ..."


@dataclasses.dataclass(frozen=True, eq=False)
class MotTable:
    """The rows of a MOTChallenge file, in the file's order.

    Attributes:
        source: the file.
        frame: (N,) int64 frame numbers, counted from 1 as in the file unless mapped.
        identity: (N,) int64 identity as in the file, -1 for plain detections.
        box: (N, 4) x1, y1, x2, y2 in the file's pixels.
        confidence: (N,) the seventh column (a flag in ground-truth files), or None.
        world: (N, 3) x, y, z where the file gives world positions (ten columns, not -1), or None.
        lines: (N,) line number of each row.
    """

    source: Path
    frame: Int[np.ndarray, " n"]
    identity: Int[np.ndarray, " n"]
    box: Float[np.ndarray, "n 4"]
    confidence: Float[np.ndarray, " n"] | None
    world: Float[np.ndarray, "n 3"] | None
    lines: list[int]

    def detections(self, camera: int = 0) -> Detections:
        """Return the boxes as detections of one camera, scored unless every confidence is -1.

        Raises:
            InvalidInputError: naming the line, if a box has no area or a confidence is outside
                [0, 1].
        """
        scored = self.confidence is not None and bool((self.confidence != -1).any())
        score, cameras = self.confidence if scored else None, np.full(len(self.frame), camera)
        with naming_line(self.source, self.lines):
            return Detections(self.frame, cameras, self.box, score=score)

    def to_rows(self) -> Float[np.ndarray, "n 4"]:
        """Return (N, 4) rows [frame, id, x, y] of world positions for `catfree.evaluation`.

        Raises:
            InvalidInputError: if the file has no world positions.
        """
        if self.world is None:
            raise InvalidInputError(f"{self.source} has no world positions (columns 8 to 10).")
        return np.column_stack([self.frame, self.identity, self.world[:, :2]])


def read_mot(path: StrPath, *, frames: ArrayLike | None = None) -> MotTable:
    """Read `frame, id, left, top, width, height[, confidence[, ...]]`, one row per line.

    Args:
        path: a `det.txt`, `gt.txt` or tracker output; commas or spaces separate the columns.
        frames: (F,) frame numbers of the sequence; file frame 1 becomes the first of them. None
            keeps the file's numbers, which count from 1.

    Returns:
        The table. Boxes keep the file's pixel coordinates.

    Raises:
        InvalidInputError: if there is no such file or a number is not finite.
        FileFormatError: naming the first malformed line.
    """
    source = as_path(path, "path")
    table, lines = read_rows(source, _ROWS, (6,), more=True, whole=2)
    with np.errstate(over="ignore"):
        box = np.concatenate([table[:, 2:4], table[:, 2:4] + table[:, 4:6]], axis=-1)
    with naming_line(source, lines):
        require_finite(box, "box")
    frame = table[:, 0].astype(np.int64)
    if frames is not None:
        frame_list = _ascending(frames)
        outside = (frame < 1) | (frame > len(frame_list))
        if outside.any():
            at = int(np.argmax(outside))
            raise InvalidInputError(
                f"{source}: frame in line {lines[at]} is {frame[at]}, but the sequence has frames "
                f"1 to {len(frame_list)}."
            )
        frame = frame_list[frame - 1]
    has_world = table.shape[1] >= 10 and bool((table[:, 7:9] != -1).any())
    return MotTable(
        source=source,
        frame=frame,
        identity=table[:, 1].astype(np.int64),
        box=box,
        confidence=table[:, 6] if table.shape[1] >= 7 else None,
        world=table[:, 7:10] if has_world else None,
        lines=lines,
    )


def write_mot_boxes(
    path: StrPath,
    detections: Detections,
    frames: ArrayLike,
    identity: ArrayLike | None = None,
) -> Path:
    """Write the boxes of one camera as `frame, id, left, top, width, height, confidence, -1 x 3`.

    Args:
        path: the file.
        detections: boxes of one camera.
        frames: (F,) all frame numbers of the sequence, also as a `range`; the first becomes 1, the
            next 2, ...
        identity: (N,) identities counted from 0, written counted from 1; None or a negative one
            writes -1.

    Returns:
        The path.

    Raises:
        InvalidInputError: if boxes belong to several cameras, a frame is not among `frames`, or the
            folder does not exist.
    """
    require_instance(detections, Detections, "detections")
    if len(np.unique(detections.camera)) > 1:
        raise InvalidInputError(
            f"Cannot write {path}: the boxes belong to {len(np.unique(detections.camera))} "
            "cameras; write one file per camera."
        )
    count = len(detections)
    person = np.full(count, -1) if identity is None else as_integer(identity, "identity")
    if person.shape != (count,):
        raise InvalidInputError(f"identity must have shape ({count},), got {person.shape}.")
    score = np.ones(count) if detections.score is None else detections.score
    corner, size = detections.box[:, :2], detections.box[:, 2:] - detections.box[:, :2]
    return _write(path, detections.frame, frames, person, corner, size, score, "-1,-1,-1")


def write_mot_ground(
    path: StrPath, tracks: Tracks | ArrayLike, frames: ArrayLike, *, threshold: float = 1.0
) -> Path:
    """Write tracks or true positions as squares that TrackEval can score.

    TrackEval compares boxes in images. Two squares of side `3 threshold` around a true and a
    tracked position overlap by half when the positions are `threshold` apart along an axis. Columns
    are `frame, id, left, top, side, side, confidence, class, visibility`, lengths in scene units,
    so the same file serves as ground truth and as tracker output (MOT16 form).

    Args:
        path: the file.
        tracks: tracks to write, or (N, 4) rows [frame, id, x, y] such as the ground truth of
            a sequence; frames and identities are written counted from 1, unknown ones as -1.
        frames: (F,) all frame numbers of the sequence, also as a `range`; the first becomes 1, the
            next 2, ...
        threshold: matching distance in scene units.

    Returns:
        The path.

    Raises:
        InvalidInputError: if a frame is not among `frames`, a position is not finite, the threshold
            is not positive, rows have another shape, or the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    return write_squares(path, tracks, frames, threshold, "tracks")


def write_squares(
    path: StrPath, tracks: Tracks | ArrayLike, frames: ArrayLike, threshold: float, name: str
) -> Path:
    """Do what `write_mot_ground` does; errors call `tracks` by another name."""
    threshold = as_positive(threshold, "threshold")
    score = None
    if isinstance(tracks, Tracks):
        frame, identity, score = tracks.frame, tracks.track_id, tracks.existence
        xy = np.asarray(tracks.ground_xy, np.float64)
    else:
        rows = as_rows(tracks, 4, f"{name} [frame, id, x, y]").astype(np.float64)
        frame, identity = as_integer(rows[:, 0], "frame"), as_integer(rows[:, 1], "id")
        xy = rows[:, 2:]
    side = np.full((len(xy), 2), _SIDES_PER_THRESHOLD * threshold)
    score = np.ones(len(xy)) if score is None else score
    return _write(path, frame, frames, identity, xy - side / 2, side, score, "1,1")


def _ascending(frames: ArrayLike) -> np.ndarray:
    return np.unique(as_integer(frames, "frames"))


def _write(
    path: StrPath,
    frame: np.ndarray,
    frames: ArrayLike,
    identity: np.ndarray,
    corner: np.ndarray,
    size: np.ndarray,
    score: np.ndarray,
    last_columns: str,
) -> Path:
    for name, values in (("position", corner), ("size", size), ("score", score)):
        bad = ~np.isfinite(values)
        bad = bad.any(axis=tuple(range(1, bad.ndim)))
        if bad.any():
            at = int(np.argmax(bad))
            raise InvalidInputError(
                f"Cannot write {path}: the {name} in row {at} (frame {frame[at]}) is not finite. "
                "Leave that row out."
            )
    if isinstance(frames, range) and frames.step > 0:  # not listed: it may be long
        frame_list, position = frames, (frame - frames.start) // frames.step
        unknown = (position < 0) | (position >= len(frames))
        unknown |= frames.start + position * frames.step != frame
    else:
        frame_list = _ascending(frames)
        position, unknown = np.searchsorted(frame_list, frame), ~np.isin(frame, frame_list)
    if unknown.any():
        raise InvalidInputError(
            f"Cannot write {path}: frame {frame[unknown][0]} is not among the {len(frame_list)} "
            "frames of the sequence."
        )
    identity = np.where(identity < 0, -1, identity + 1)
    lines = []
    for row in np.lexsort((identity, position)):
        values = [*corner[row], *size[row], score[row]]
        numeric = ",".join(repr(float(value)) for value in values)
        lines.append(f"{position[row] + 1},{identity[row]},{numeric},{last_columns}\n")
    return write_text_atomically(path, "".join(lines))
