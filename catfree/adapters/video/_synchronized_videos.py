"""Synchronized reading of all cameras' pictures from files of any kind and frame rate."""

import contextlib
import copy
import functools
import hashlib
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int

from catfree.adapters.files._camera_names import names_of_files
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import Image
from catfree.adapters.video._common_clock import (
    REACH,
    Times,
    common_rate,
    common_start,
    nearest_frame,
)
from catfree.adapters.video._video_sources import CaptureReader, ImageFolder, VideoFile, open_source
from catfree.errors import (
    CatFreeError,
    FileFormatError,
    InsufficientDataError,
    InvalidInputError,
    quoted,
)
from catfree.types import Clock
from catfree.types._processes import processor_count
from catfree.types._validation import as_count, as_integer, as_path


@dataclass(frozen=True)
class CameraFootage:
    """The footage of one camera, on the common clock.

    Attributes:
        name: name of the camera.
        path: video file or image folder.
        frame_count: frames that it claims to hold.
        fps: frames per second, or None if unknown.
        seconds: from the first frame to the end of the last, or None if unknown.
        image_size: width and height in pixels.
        available: the ticks that this camera alone would deliver if it had dropped none.
        dropped: instants between its first and last frame without a frame nearby.
        pictures: delivered instants of which it has a picture.
        timeless: whether the times of its frames are assumed, because they are not recorded.
    """

    name: str
    path: Path
    frame_count: int
    fps: float | None
    seconds: float | None
    image_size: tuple[int, int]
    available: range
    dropped: int
    pictures: int
    timeless: bool


class SynchronizedVideos:
    """Videos of static cameras as a sequence of instants; only two instants are in memory.

    A common clock ticks at `frame_rate`, by default the lowest rate among the cameras. Iteration
    delivers the ticks at which every camera has a frame (or at least `fewest_cameras` of them),
    from `start` to before `end`, every `stride`-th. At a tick, each camera shows its frame nearest
    in time:

    - The times of frames come from a table: `NAME.timestamps.csv` beside a video `NAME.mp4`, or
      `timestamps.csv` in an image folder, with the columns `frame_id,timestamp_s` and one line per
      frame from 0 on. Tick 0 is at the earliest of all times, so files may start at different
      times. Times beyond 1e9 are seconds since 1970 in UTC; then every camera needs such a table.
    - Otherwise they are the timestamps in the video file, counted from its first frame. Where
      these are even, within a quarter of a frame, tick k shows frame
      `offsets[c] + round(k * fps_c / frame_rate)`.
    - Images without a table have no times: there is one image per tick.

    A camera has no frame at a tick farther than 0.6 ticks from all its frames: it dropped one
    (`footage` counts them), its frame rate varies, or its footage ended.

    Iterate as often as needed; each iteration decodes again, one instant ahead in a thread:

        for frame, images in SynchronizedVideos(["a.mp4", "b.mp4"], stride=5):
            ...  # images[c] is (H, W, 3) uint8 RGB of camera c
    """

    def __init__(
        self,
        paths: Sequence[str | os.PathLike[str]],
        *,
        stride: int = 1,
        start: int | None = None,
        end: int | None = None,
        offsets: Sequence[int] | None = None,
        frame_rate: float | int | None = None,
        on_error: Literal["raise", "keep"] = "raise",
        fewest_cameras: int | None = None,
    ) -> None:
        """Open every source once to learn its size, rate and length.

        Args:
            paths: one video file or image folder per camera.
            stride: deliver every `stride`-th tick.
            start: first tick; None for the first that enough cameras have.
            end: tick to stop before; None for after the last that enough cameras have.
            offsets: (C,) the frame of each camera, in its own frames, that shows tick 0; negative
                for a camera that was started later. None for the files' own times, or all 0.
            frame_rate: ticks per second; None for the lowest rate among the cameras.
            on_error: at a frame that cannot be decoded, "raise" an error or "keep" the instants
                before it and stop there (`interruption` then holds the error, `whole` their
                number). Formats without time stamps (AVI) may lose damaged frames before decoding
                stops, so frames after the damage come too early; "raise" refuses such a file.
            fewest_cameras: deliver the ticks at which at least this many cameras have a frame; None
                for all cameras. A missing picture is black, and `silent` lists it.

        Raises:
            InvalidInputError: if a path does not exist or is given twice, a parameter is invalid,
                or only some cameras have absolute times.
            FileFormatError: if a file cannot be decoded at all, or a table of times is malformed
                (naming its line).
            InsufficientDataError: if no tick has enough cameras.
        """
        if isinstance(paths, str | os.PathLike) or not isinstance(paths, Sequence | None):
            raise InvalidInputError(f"paths must list one video per camera, got only {paths!s}.")
        if not paths:
            raise InvalidInputError("paths must name at least one video or image folder.")
        stride = as_count(stride, "stride", least=1)
        start = None if start is None else as_count(start, "start")
        end = None if end is None else as_count(end, "end")
        count = len(paths)
        fewest = as_count(count if fewest_cameras is None else fewest_cameras, "fewest_cameras")
        if not 1 <= fewest <= count:
            raise InvalidInputError(
                f"fewest_cameras must be between 1 and the number of videos ({count}), got "
                f"{fewest_cameras}."
            )
        if on_error not in ("raise", "keep"):
            raise InvalidInputError(f"on_error must be 'raise' or 'keep', got {quoted(on_error)}.")
        listed = np.zeros(len(paths)) if offsets is None else offsets
        shifts = as_integer(listed, "offsets").tolist()
        if np.shape(shifts) != (len(paths),):
            raise InvalidInputError(
                f"offsets must give one number per camera ({len(paths)}), got {offsets}."
            )
        # Reading the times of all frames is a pass over each file.
        with ThreadPoolExecutor(min(len(paths), processor_count())) as pool:
            self._sources = list(pool.map(_open_camera, range(len(paths)), paths))
        self._offsets, self._keep, self._fewest = shifts, on_error == "keep", fewest
        self.camera_names: list[str] = names_of_files([s.path for s in self._sources])
        named = zip(self.camera_names, self._sources, strict=True)
        rates = {name: source.fps for name, source in named if source.fps is not None}
        self._rate = common_rate(rates, frame_rate)
        timed = [source.times for source in self._sources]
        starts = [np.zeros(1) if times is None else times for times in timed]
        self._start, self._utc = common_start(starts, self.camera_names)
        if any(times is None for times in timed):
            self._start = 0.0  # frames without times of their own count from the first one
        self._origins = self._origins_of_ticks(offsets is not None)
        for camera, (offset, source) in enumerate(zip(shifts, self._sources, strict=True)):
            if offset >= source.frame_count and self._span(camera)[1] < 0:
                raise InvalidInputError(
                    f"The offset of camera {quoted(self.camera_names[camera])} is {offset}, but it "
                    f"has only {source.frame_count} frames, so it shows no instant. Correct "
                    "offsets."
                )
        self._limits, self._stride = (start, end), stride
        self._take(self._shared_ticks(start, end, stride))
        self.interruption: CatFreeError | None = None
        self.whole = len(self._ticks)

    @property
    def fewest_cameras(self) -> int:
        """Number of cameras that must have a frame at an instant."""
        return self._fewest

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return len(self._sources)

    def require_cameras(self, count: int) -> None:
        """Require one video per camera of a scene.

        Raises:
            InvalidInputError: if there are more or fewer videos.
        """
        if self.camera_count != count:
            raise InvalidInputError(
                f"There are {self.camera_count} videos for {count} cameras. Give one per camera, "
                "in the order of the scene."
            )

    @property
    def frame_count(self) -> int:
        """Number of instants that an iteration delivers if every frame can be decoded."""
        return len(self._ticks)

    def __len__(self) -> int:
        return self.frame_count

    @property
    def frames(self) -> Int[np.ndarray, " t"]:
        """(T,) frame index (tick) of each instant."""
        return self._ticks.copy()

    @property
    def fps(self) -> float | None:
        """Instants per second, or None for image folders without a `frame_rate`."""
        return None if self._rate is None else self._rate / self._stride

    @property
    def clock(self) -> Clock | None:
        """The time of each tick, or None for image folders without times or a `frame_rate`."""
        return None if self._rate is None else Clock(self._rate, self._start, self._utc)

    @property
    def offsets(self) -> tuple[int, ...]:
        """(C,) the frame of each camera, in its own frames, that shows tick 0."""
        return tuple(
            offset if source.times is None else self._frame_at_origin(camera, source.times)
            for camera, (source, offset) in enumerate(
                zip(self._sources, self._offsets, strict=True)
            )
        )

    @property
    def silent(self) -> Int[np.ndarray, "k 2"]:
        """(K, 2) frame and camera of each missing picture, as `localize` takes them."""
        return self._silent

    @property
    def image_size(self) -> Int[np.ndarray, "cam 2"]:
        """(C, 2) width and height of each camera's pictures in pixels."""
        return np.array([source.image_size for source in self._sources], np.int64)

    @property
    def fingerprint(self) -> str:
        """Content hash of all files and of the parameters of their delivery."""
        return hash_parameters(
            "SynchronizedVideos",
            *self.content_hashes,
            ticks=[int(self._ticks[0]), int(self._ticks[-1]), len(self._ticks), self._stride],
            offsets=self._offsets,
            rate=self._rate,
            keep=self._keep,
            fewest=self._fewest,
            clock=[self._start, self._utc, self._origins],
            times=[_hash_of(source.times) for source in self._sources],
        )

    @functools.cached_property
    def content_hashes(self) -> tuple[str, ...]:
        """(C,) SHA-256 of each camera's file or images."""
        return tuple(source.content_hash() for source in self._sources)

    @property
    def footage(self) -> tuple[CameraFootage, ...]:
        """(C,) footage of each camera, whether it is used or not."""
        start, end = self._limits
        lacking = np.bincount(self._silent[:, 1], minlength=self.camera_count).tolist()
        footage = []
        for camera, source in enumerate(self._sources):
            first, last = self._span(camera)
            begin = first if start is None else max(first, start)
            stop = last + 1 if end is None else min(last + 1, end)
            footage.append(
                CameraFootage(
                    self.camera_names[camera],
                    source.path,
                    source.frame_count,
                    source.fps,
                    _length(source),
                    source.image_size,
                    range(begin, max(begin, stop), self._stride),
                    self._dropped[camera],
                    self.frame_count - lacking[camera],
                    source.timeless,
                )
            )
        return tuple(footage)

    def without_offsets(self, frame_offset: Sequence[int]) -> "SynchronizedVideos":
        """Return the same footage on corrected clocks, with the instants that remain.

        `catfree.calibration.remove_offsets` does the same to detections.

        Args:
            frame_offset: (C,) ticks by which each camera's ticks are too high.

        Raises:
            InsufficientDataError: if no instant remains that enough cameras show.
        """
        shifts = [
            round(ticks * self._frames_per_tick(camera))
            for camera, ticks in enumerate(frame_offset)
        ]
        corrected = copy.copy(self)
        corrected._offsets = [o + shift for o, shift in zip(self._offsets, shifts, strict=True)]
        if self._rate is not None:
            late = [ticks / self._rate for ticks in frame_offset]
            corrected._origins = [o + s for o, s in zip(self._origins, late, strict=True)]
        first, last = corrected._range_of_enough()
        if not corrected._keep_ticks(first, last + 1):
            raise InsufficientDataError(
                f"With the clocks corrected by {', '.join(map(str, frame_offset))} frames, no "
                f"instant is in {self._enough} videos. Record longer."
            )
        return corrected

    def between(self, start: int, end: int) -> "SynchronizedVideos":
        """Return the instants from tick `start` to before tick `end`, without opening files again.

        Raises:
            InsufficientDataError: if there are none.
        """
        excerpt = copy.copy(self)
        excerpt._limits = (start, end)
        if not excerpt._keep_ticks(start, end):
            raise InsufficientDataError(
                f"No instant from tick {start} to {end} is in {self._enough} videos."
            )
        return excerpt

    def before_interruption(self) -> "SynchronizedVideos":
        """Return the instants before the last iteration's interruption."""
        return self.between(int(self._ticks[0]), int(self._ticks[self.whole - 1]) + 1)

    def __iter__(self) -> Iterator[tuple[int, list[Image]]]:
        """Yield (frame index, one picture per camera) of each instant in order.

        Raises:
            FileFormatError: naming camera and frame, if a frame cannot be decoded or its size
                changes, unless `on_error` is "keep".
        """
        yield from self.instants_from(0)

    def instants_from(self, first: int) -> Iterator[tuple[int, list[Image]]]:
        """Iterate over the instants from position `first` on.

        Args:
            first: position among the instants, 0-based; `frames[first]` is the first delivered.

        Raises:
            InvalidInputError: if the position is negative.
            FileFormatError: as iterating over all instants does.
        """
        black = [np.zeros((height, width, 3), np.uint8) for width, height in self.image_size]
        for tick, pictures in self.pictures_from(first):
            yield tick, [pictures.get(camera, black[camera]) for camera in range(len(black))]

    def pictures_from(
        self, first: int = 0, cameras: Sequence[int] | None = None
    ) -> Iterator[tuple[int, dict[int, Image]]]:
        """Iterate over the existing pictures, by camera, of the instants from a position on.

        Args:
            first: as `instants_from`.
            cameras: whose pictures to decode; None for all.

        Raises:
            InvalidInputError: if the position is negative, or there is no such camera.
            FileFormatError: as iterating over all instants does.
        """
        if first < 0:
            raise InvalidInputError(f"first is {first}; positions among the instants start at 0.")
        chosen = range(self.camera_count) if cameras is None else cameras
        for camera in chosen:
            if not 0 <= camera < self.camera_count:
                raise InvalidInputError(
                    f"There is no camera {camera}; the videos belong to cameras 0 to "
                    f"{self.camera_count - 1}."
                )
        count = len(self._ticks)
        self.interruption, self.whole = None, count
        if first >= count:
            return
        with contextlib.ExitStack() as stack:
            readers = {
                camera: stack.enter_context(contextlib.closing(self._sources[camera].open()))
                for camera in chosen
            }

            def read(done: int) -> dict[int, Image]:
                tick = int(self._ticks[done])
                begin, stop = np.searchsorted(self._silent[:, 0], [tick, tick + 1])
                return {
                    camera: self._read(camera, reader, tick, done)
                    for camera, reader in readers.items()
                    if camera not in self._silent[begin:stop, 1]
                }

            # The next instant is decoded while this one is processed.
            pool = stack.enter_context(ThreadPoolExecutor(1))
            ahead = pool.submit(read, first)
            for done in range(first, count):
                try:
                    pictures = ahead.result()
                except FileFormatError as error:
                    if not self._keep:
                        raise
                    self.interruption, self.whole = error, done
                    return
                if done + 1 < count:
                    ahead = pool.submit(read, done + 1)
                yield int(self._ticks[done]), pictures

    def pictures_of(self, camera: int) -> Iterator[Image]:
        """Iterate over one camera's pictures of the instants, without decoding the others.

        Args:
            camera: its index, 0-based.

        Raises:
            InvalidInputError: if there is no such camera.
            FileFormatError: as iterating over the instants does.
        """
        for _, pictures in self.pictures_from(0, [camera]):
            yield from pictures.values()

    def _read(
        self, camera: int, reader: CaptureReader | ImageFolder, tick: int, done: int
    ) -> Image:
        source = self._sources[camera]
        frame = self._source_frame(camera, tick)
        image = reader.read(frame)
        name = f"Camera {camera} ({quoted(self.camera_names[camera])})"
        advice = "Repair the file."
        if not self._keep:
            advice = f"Repair it, or pass on_error='keep' to use the {done} instants before it."
        if image is None:
            raise FileFormatError(
                f"{name}: {source.describe(frame)} cannot be decoded; the file is truncated or "
                f"corrupt. {advice}"
            )
        size = (image.shape[1], image.shape[0])
        if size != source.image_size:
            raise FileFormatError(
                f"{name}: {source.describe(frame)} is {size[0]} x {size[1]} px, but the camera "
                f"started with {source.image_size[0]} x {source.image_size[1]} px. {advice}"
            )
        return image

    def _origins_of_ticks(self, given: bool) -> list[float]:
        """Return the time of tick 0 on each camera's own clock; `given` offsets take precedence."""
        if not given:
            return [self._start] * self.camera_count
        origins = [
            0.0 if source.times is None else _extrapolated(source.times, offset, source.fps)
            for source, offset in zip(self._sources, self._offsets, strict=True)
        ]
        self._start = origins[0] if self._utc else 0.0
        return origins

    def _frame_at_origin(self, camera: int, times: Times) -> int:
        """Return the number of the frame nearest to tick 0, which may lie outside the footage."""
        origin, fps = self._origins[camera], self._sources[camera].fps or 1.0
        if times[0] <= origin <= times[-1]:
            return int(nearest_frame(times, np.array([origin]))[0])
        end = 0 if origin < times[0] else len(times) - 1
        return end + math.floor((origin - float(times[end])) * fps + 0.5)

    def _place(self, camera: int, time: float) -> float:
        """Convert a camera's time to ticks, in fractions."""
        return (time - self._origins[camera]) * (self._rate or 1.0)

    def _keep_ticks(self, start: int, end: int) -> bool:
        """Leave out ticks before `start` or from `end` on; return whether any is left."""
        ticks = self._ticks[(self._ticks >= start) & (self._ticks < end)]
        if not len(ticks):
            return False
        self._take(range(int(ticks[0]), int(ticks[-1]) + 1, self._stride))
        return True

    def _take(self, span: range) -> None:
        """Take the ticks that enough cameras have, and count those that each camera dropped."""
        tick, columns = np.array(span, np.int64), []
        self._dropped: list[int] = []
        for camera, source in enumerate(self._sources):
            first, last = self._span(camera)
            inside = has = (tick >= first) & (tick <= last)
            if source.times is not None:
                seconds = self._origins[camera] + tick / (self._rate or 1.0)
                away = source.times[nearest_frame(source.times, seconds)] - seconds
                has = inside & (np.abs(away) * (self._rate or 1.0) <= REACH)
            columns.append(has)
            self._dropped.append(int((inside & ~has).sum()))
        has_frame = np.stack(columns, axis=-1)
        enough = has_frame.sum(1) >= self._fewest
        if not enough.any():
            camera = int(np.argmax(self._dropped))
            raise InsufficientDataError(
                f"No instant is in {self._enough} videos: camera "
                f"{quoted(self.camera_names[camera])} has no frame near {self._dropped[camera]} of "
                f"the {len(span)} ticks. Check the times of its frames."
            )
        self._ticks = tick[enough]
        at, camera = np.nonzero(~has_frame[enough])
        self._silent = np.column_stack([self._ticks[at], camera])

    @property
    def _enough(self) -> str:
        """Number of cameras that an instant needs, in words for messages."""
        everyone = self._fewest == self.camera_count
        return f"all {self.camera_count}" if everyone else f"at least {self._fewest}"

    def _frames_per_tick(self, camera: int) -> float:
        fps = self._sources[camera].fps
        if fps is None or self._rate is None:
            return 1.0
        return fps / self._rate

    def _source_frame(self, camera: int, tick: int) -> int:
        times = self._sources[camera].times
        if times is not None:
            seconds = self._origins[camera] + tick / (self._rate or 1.0)
            return int(nearest_frame(times, np.array([seconds]))[0])
        # Half-way cases round up, so that the spacing stays even.
        return self._offsets[camera] + math.floor(tick * self._frames_per_tick(camera) + 0.5)

    def _span(self, camera: int) -> tuple[int, int]:
        """First and last tick for which a camera has a frame."""
        times = self._sources[camera].times
        if times is not None:
            first = math.ceil(self._place(camera, float(times[0])) - REACH)
            return max(first, 0), math.floor(self._place(camera, float(times[-1])) + REACH)
        step, offset = self._frames_per_tick(camera), self._offsets[camera]
        first = math.ceil((-offset - 0.5) / step - 1e-9)
        count = self._sources[camera].frame_count
        return max(first, 0), math.ceil((count - offset - 0.5) / step - 1e-9) - 1

    def _range_of_enough(self) -> tuple[int, int]:
        """First and last tick that lie within the footage of enough cameras."""
        firsts, lasts = zip(*map(self._span, range(self.camera_count)), strict=True)
        return sorted(firsts)[self._fewest - 1], sorted(lasts)[-self._fewest]

    def _shared_ticks(self, start: int | None, end: int | None, stride: int) -> range:
        first, last = self._range_of_enough()
        begin = first if start is None else start
        if end is not None and end <= begin:
            raise InvalidInputError(
                f"end is {end}, but the first instant to use is {begin}. Give a larger end."
            )
        stop = last + 1 if end is None else min(end, last + 1)
        spans = [self._span(camera) for camera in range(self.camera_count)]
        if begin < first:
            camera = [span[0] for span in spans].index(first)
            raise InvalidInputError(
                f"start is {begin}, but camera {quoted(self.camera_names[camera])} has its first "
                f"picture at tick {first}."
            )
        if begin >= stop:
            camera = [span[1] for span in spans].index(last)
            raise InsufficientDataError(
                f"No instant is in {self._enough} videos from tick {begin} to before "
                f"{'the end' if end is None else end}: camera {quoted(self.camera_names[camera])} "
                f"ends after tick {last}. Check start, end and offsets."
            )
        return range(begin, stop, stride)


def _extrapolated(times: Times, frame: int, fps: float | None) -> float:
    """Return the time of a frame, which may be before the first or after the last."""
    inside = min(max(frame, 0), len(times) - 1)
    return float(times[inside]) + (frame - inside) / (fps or 1.0)


def _length(source: VideoFile | ImageFolder) -> float | None:
    """Return the seconds from the first frame to the end of the last."""
    if source.fps is None:
        return None
    if source.times is None:
        return source.frame_count / source.fps
    return float(source.times[-1] - source.times[0]) + 1 / source.fps


def _hash_of(times: Times | None) -> str | None:
    return None if times is None else hashlib.sha256(times.tobytes()).hexdigest()


def _open_camera(camera: int, path: str | os.PathLike[str]) -> VideoFile | ImageFolder:
    place = as_path(path, f"Camera {camera}")
    try:
        return open_source(place)
    except CatFreeError as error:
        raise type(error)(f"Camera {camera}: {error}") from error
