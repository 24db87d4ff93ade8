"""`shards`: cut a recording into overlapping stretches of time."""

import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree._run._cache import content_hash
from catfree._run._input_checks import open_recording, require_distinct_videos
from catfree.adapters.files._documents import StrPath
from catfree.adapters.files._fingerprint import hash_parameters, hash_samples
from catfree.adapters.tables._detections_table import (
    clock_of,
    frame_range,
    open_detections_table,
    read_detections_parquet,
)
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import InvalidInputError, quoted
from catfree.types import Clock, Detections
from catfree.types._validation import as_duration, as_path, as_pictures, as_positive

MOST_SHARDS = 1_000_000


def recording_name(site: str, date: str) -> str:
    """Describe site and date of a recording, if any, for messages."""
    return f"{site} {date}".strip()


@dataclass(frozen=True, eq=False)
class Shard:
    """A stretch of a recording: small, picklable, and independent of all others.

    Attributes:
        index: position among the shards of its recording, from 0.
        count: number of shards of the recording.
        first: first frame whose positions the shard reports.
        stop: frame after the last one.
        first_seen: first frame that the shard uses, earlier than `first` by half the overlap.
        stop_seen: frame after the last used one.
        clock: time of the frames.
        source: fingerprint of the recording.
        videos: one video file or image folder per camera; empty if the shard comes from boxes.
        offsets: (C,) as for `SynchronizedVideos`, or None.
        detections: the boxes of the used frames, or the path of a saved file or Parquet table; None
            if the shard comes from videos.
        site: name of the site, empty if there is only one.
        date: of the recording, empty if there is only one.
        silent: camera, first frame and frame after the last one of each stretch of missing
            pictures.
        camera_names: names of the cameras of boxes for warnings, empty if unknown; cameras of
            videos are named by their files.
    """

    index: int
    count: int
    first: int
    stop: int
    first_seen: int
    stop_seen: int
    clock: Clock
    source: str
    videos: tuple[str, ...] = ()
    offsets: tuple[int, ...] | None = None
    detections: Detections | str | None = None
    site: str = ""
    date: str = ""
    silent: tuple[tuple[int, int, int], ...] = ()
    camera_names: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name for messages: `shard 17 of 144`, with site and date if there are any."""
        where = recording_name(self.site, self.date)
        return f"shard {self.index} of {self.count}" + (f" ({where})" if where else "")

    @property
    def fingerprint(self) -> str:
        """Hash of the input and the reported frames of the shard."""
        return hash_parameters(
            "Shard",
            self.source,
            index=[self.index, self.count],
            frames=[self.first, self.stop, self.first_seen, self.stop_seen],
            clock=[self.clock.frame_rate, self.clock.start, self.clock.utc],
            offsets=self.offsets,
            silent=self.silent,
        )


def shards(
    recording: Sequence[StrPath] | Detections | StrPath,
    every: float | int = 600.0,
    overlap: float | int = 20.0,
    frame_rate: float | int | None = None,
    *,
    offsets: Sequence[int] | None = None,
    silent: Any = None,
    site: str = "",
    date: str = "",
    camera_names: Sequence[str] | None = None,
) -> tuple[Shard, ...]:
    """Cut a recording into shards that any number of processes or machines can localize.

        plan = cf.shards("boxes.parquet", every=600, overlap=20, frame_rate=5)
        with ProcessPoolExecutor(mp_context=get_context("spawn")) as executor:
            list(executor.map(partial(cf.run_shard, scene=scene, out="day"), plan))
        tracks = cf.join("day")

    Args:
        recording: one video file or image folder per camera; or the boxes of all cameras, as
            `Detections`, the path of a file that `Detections.save` wrote, or the path of a Parquet
            table (a file, or a folder of files). Use Parquet for long recordings: each shard then
            reads only its own rows.
        every: seconds per shard.
        overlap: seconds that two neighboring shards share, half of it on each side of the cut;
            identities are matched there.
        frame_rate: frames per second; None for the rate of the videos or of the detections' clock.
        offsets: as `SynchronizedVideos`, for videos.
        silent: (K, 2) frame and camera of missing pictures, as for `localize`, for boxes only.
        site: name of the site if the plan holds shards of several.
        date: of the recording if the plan holds shards of several.
        camera_names: (C,) names of the scene's cameras for warnings about boxes; without them,
            warnings give numbers. Cameras of videos are named by their files.

    Returns:
        The shards in order of time. The last one is up to one and a half times as long as the
        others, so that none is too short to learn from.

    Raises:
        InvalidInputError: if a file does not exist, two videos are equal byte for byte, there are
            no frames, no frame rate is known, or the overlap is not shorter than the shards.
    """
    every, overlap = as_positive(every, "every"), as_duration(overlap, "overlap")
    if overlap >= every:
        raise InvalidInputError(
            f"overlap is {overlap:g} s, but shards are {every:g} s long. Make the shards longer "
            "than their overlap."
        )
    for name, value in (("site", site), ("date", date)):
        require_folder_name(value, name)
    whole = _whole(recording, frame_rate, offsets)
    missing = _missing_pictures(silent, whole)
    rate = whole.clock.frame_rate
    length = max(1, round(every * rate))
    margin = math.ceil(overlap * rate / 2)
    frames = whole.stop - whole.first
    count = max(1, int(frames / length + 0.5))
    if count > MOST_SHARDS:
        raise InvalidInputError(
            f"{frames} frames make {count} shards of {every:g} s. Check the frame numbers, or pass "
            "a larger every."
        )
    cuts = [whole.first + index * length for index in range(count)] + [whole.stop]
    plan = []
    for index, (first, stop) in enumerate(itertools.pairwise(cuts)):
        # The ends of the recording have nothing beyond them to overlap with.
        span = (max(first - margin, whole.first), min(stop + margin, whole.stop))
        rows = missing[(missing[:, 0] >= span[0]) & (missing[:, 0] < span[1])]
        boxes = whole.detections
        if isinstance(boxes, Detections):
            boxes = boxes[(boxes.frame >= span[0]) & (boxes.frame < span[1])]
        plan.append(
            replace(
                whole, index=index, count=count, first=first, stop=stop, first_seen=span[0],
                stop_seen=span[1], detections=boxes, site=site, date=date, silent=_stretches(rows),
                camera_names=tuple(camera_names or ()),
            )
        )  # fmt: skip
    return tuple(plan)


def _whole(
    recording: Sequence[StrPath] | Detections | StrPath,
    frame_rate: float | int | None,
    offsets: Sequence[int] | None,
) -> Shard:
    """Return the recording as a single shard."""
    if isinstance(recording, Detections | str | os.PathLike):
        if offsets is not None:
            raise InvalidInputError(
                "offsets apply only to videos; correct boxes with cf.calibration.remove_offsets."
            )
        return _boxes_as_one(recording, frame_rate)
    require_recording(recording, "recording")
    videos = open_recording(recording, frame_rate, offsets)
    require_distinct_videos(videos)
    clock = videos.clock
    if clock is None:
        raise InvalidInputError(
            "The frame rate of these images is unknown, so seconds are undefined. Pass frame_rate."
        )
    frames = videos.frames
    first, stop = int(frames[0]), int(frames[-1]) + 1
    paths = tuple(os.path.abspath(one.path) for one in videos.footage)
    source = _hash_of_recording(paths)
    given = None if offsets is None else videos.offsets
    return Shard(0, 1, first, stop, first, stop, clock, source, videos=paths, offsets=given)


def require_recording(recording: Any, name: str) -> None:
    """Raise if a recording is neither videos nor boxes."""
    if not isinstance(recording, Detections | os.PathLike | Sequence):
        raise InvalidInputError(
            f"{name} must be a list of videos, Detections or a path, got "
            f"{type(recording).__name__}."
        )


def _boxes_as_one(boxes: Detections | StrPath, frame_rate: float | int | None) -> Shard:
    if isinstance(boxes, Detections):
        detections, source = boxes, content_hash(boxes)
        name, clock = "The detections", boxes.clock
    else:
        path = as_path(boxes, "recording")
        name, detections = str(path), None
        if path.suffix.lower() == ".npz":
            detections = Detections.load(path)
            clock = detections.clock
        else:
            clock = clock_of(open_detections_table(path), path)
        source = _hash_of_recording(path)
    if detections is None:
        first, stop = frame_range(name)
    elif len(detections):
        first, stop = int(detections.frame.min()), int(detections.frame.max()) + 1
    else:
        hold = "hold" if isinstance(boxes, Detections) else "holds"
        raise InvalidInputError(f"{name} {hold} no boxes, so there is nothing to cut into shards.")
    if frame_rate is not None:
        rate = as_positive(frame_rate, "frame_rate")
        clock = Clock(rate) if clock is None else replace(clock, frame_rate=rate)
    if clock is None:
        raise InvalidInputError(
            f"{name} {'have' if isinstance(boxes, Detections) else 'has'} no clock, so seconds are "
            "undefined. Pass frame_rate."
        )
    kept = boxes if isinstance(boxes, Detections) else os.path.abspath(name)
    return Shard(0, 1, first, stop, first, stop, clock, source, detections=kept)


def boxes_of_shard(shard: Shard) -> Detections:
    """Read the boxes that a shard uses, on its clock.

    Raises:
        InvalidInputError: if the file does not exist or has changed since the plan was made.
        FileFormatError: if the file holds something else.
    """
    boxes = shard.detections
    assert boxes is not None
    if isinstance(boxes, str):
        require_unchanged(shard)
        if Path(boxes).suffix.lower() == ".npz":
            boxes = Detections.load(boxes)
            is_seen = (boxes.frame >= shard.first_seen) & (boxes.frame < shard.stop_seen)
            boxes = boxes[is_seen]
        else:
            boxes = read_detections_parquet(boxes, shard.first_seen, shard.stop_seen)
    return replace(boxes, clock=shard.clock)


def silent_pictures(shard: Shard) -> Int[np.ndarray, "k 2"]:
    """Return (K, 2) frame and camera of the missing pictures of a shard of boxes."""
    rows = [
        np.column_stack([np.arange(first, stop), np.full(stop - first, camera)])
        for camera, first, stop in shard.silent
    ]
    return np.concatenate([np.zeros((0, 2), np.int64), *rows])


def _missing_pictures(silent: Any, whole: Shard) -> Int[np.ndarray, "k 2"]:
    """Return (K, 2) frame and camera, without duplicates.

    Raises:
        InvalidInputError: if the rows are not pairs of integers, or the recording consists of
            videos.
    """
    if silent is not None and whole.videos:
        raise InvalidInputError(
            "silent applies only to boxes; the missing pictures of videos are known from their "
            "frames."
        )
    return np.unique(as_pictures(silent), axis=0)


def _stretches(rows: Int[np.ndarray, "k 2"]) -> tuple[tuple[int, int, int], ...]:
    """Return camera, first frame and frame after the last of each run of consecutive frames."""
    stretches = []
    for camera in np.unique(rows[:, 1]).tolist():
        frames = np.sort(rows[rows[:, 1] == camera, 0])
        runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
        stretches += [(camera, int(run[0]), int(run[-1]) + 1) for run in runs]
    return tuple(stretches)


def open_shard_videos(shard: Shard) -> SynchronizedVideos:
    """Open the instants of a shard's videos that it uses.

    Raises:
        InvalidInputError: if a file does not exist or has changed since the plan was made.
        FileFormatError: if a file cannot be decoded.
        InsufficientDataError: if no two videos share an instant.
    """
    require_unchanged(shard)
    whole = _open(shard.videos, shard.offsets, shard.clock.frame_rate, shard.source)
    return whole.between(shard.first_seen, shard.stop_seen)


@lru_cache(maxsize=1)
def _open(
    paths: tuple[str, ...], offsets: tuple[int, ...] | None, frame_rate: float, source: str
) -> SynchronizedVideos:
    """Open the videos of a recording once per process, as this reads the times of all frames."""
    return open_recording(paths, frame_rate, offsets)


def require_unchanged(shard: Shard) -> None:
    """Raise if the files of a shard have changed since it was planned.

    Raises:
        InvalidInputError: naming the recording.
    """
    boxes = shard.detections
    recording = boxes if isinstance(boxes, str) else shard.videos
    if _hash_of_recording(recording) != shard.source:
        name = recording if isinstance(recording, str) else ", ".join(recording)
        raise InvalidInputError(
            f"{name} changed after {shard.name} was planned. Make the plan again with cf.shards."
        )


def _hash_of_recording(recording: StrPath | tuple[str, ...]) -> str:
    """Hash the parts of a file of boxes, or of each video, that reveal a change."""
    if isinstance(recording, tuple):
        return hash_parameters("videos", *map(hash_samples, recording))
    return hash_samples(recording)


def require_folder_name(value: str, name: str) -> None:
    """Raise unless a text can be part of a folder name.

    Raises:
        InvalidInputError: naming the argument.
    """
    bad = not isinstance(value, str) or value in (".", "..") or set(value) & set('/\\\0=:*?"<>|')
    if bad or len(value) > 100:
        raise InvalidInputError(
            f"{name} is {quoted(value)}, but it names a folder: use letters, digits, '-' and '_'."
        )
