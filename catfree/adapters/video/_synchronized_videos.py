"""The pictures of all cameras, instant by instant, whatever their files and frame rates."""

import contextlib
import copy
import functools
import math
import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int

from catfree.adapters.files._camera_names import names_of_files
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import Image
from catfree.adapters.video._video_sources import FrameReader, VideoSource, open_source
from catfree.errors import CatFreeError, FileFormatError, InsufficientDataError, InvalidInputError
from catfree.types._validation import as_count, as_integer

# Nominal rates such as 30 and 29.97 name the same clock.
_RATE_TOLERANCE = 0.01


@dataclass(frozen=True)
class CameraFootage:
    """What one camera brings to the common clock.

    Attributes:
        name: of the camera.
        path: video file or image folder.
        frame_count: frames that it claims to hold.
        fps: frames per second, or None where nothing says so.
        image_size: width and height in pixels.
        available: the delivered ticks, had this camera alone been given.
    """

    name: str
    path: Path
    frame_count: int
    fps: float | None
    image_size: tuple[int, int]
    available: range


class SynchronizedVideos:
    """Videos of static cameras as a sequence of instants; only two instants are in memory.

    A common clock ticks at `frame_rate`, by default the lowest rate among the cameras. Tick k shows
    camera c's frame `offsets[c] + round(k * fps_c / frame_rate)`. Delivered are the ticks at which
    every camera has a frame, from `start` to before `end`, every `stride`-th. Image folders have
    no clock of their own: they have one image a tick.

    Iterate as often as needed; each iteration decodes anew, one instant ahead in a thread:

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
    ) -> None:
        """Open every source once to learn its size, rate and length.

        Args:
            paths: one video file or image folder a camera.
            stride: deliver every so-many-th tick.
            start: first tick; None for the first that every camera has.
            end: tick to stop before; None for after the last that every camera has.
            offsets: (C,) the frame of each camera, in its own frames, that shows tick 0; negative
                for a camera that was started later. None for all 0.
            frame_rate: ticks a second; None for the lowest rate among the cameras.
            on_error: at a frame that cannot be decoded, "raise" an error or "keep" what came before
                it and stop there (`interruption` then holds the error). Formats without time
                stamps (AVI) may lose damaged frames before decoding stops, so that frames after the
                damage come too early; "raise" refuses such a file.

        Raises:
            InvalidInputError: if a path does not exist or is given twice, or a parameter is
                impossible.
            FileFormatError: if a file cannot be decoded at all.
            InsufficientDataError: if the cameras share no tick.
        """
        if isinstance(paths, str | os.PathLike) or not isinstance(paths, Sequence | None):
            raise InvalidInputError(f"paths must list one video a camera, got only {paths!s}.")
        if not paths:
            raise InvalidInputError("paths must name at least one video or image folder.")
        stride = as_count(stride, "stride")
        start = None if start is None else as_count(start, "start")
        end = None if end is None else as_count(end, "end")
        if stride < 1:
            raise InvalidInputError(f"stride must be at least 1, got {stride}.")
        if on_error not in ("raise", "keep"):
            raise InvalidInputError(f"on_error must be 'raise' or 'keep', got {on_error!r}.")
        listed = np.zeros(len(paths)) if offsets is None else offsets
        shifts = as_integer(listed, "offsets").tolist()
        if np.shape(shifts) != (len(paths),):
            raise InvalidInputError(
                f"offsets must give one number a camera ({len(paths)}), got {offsets}."
            )
        self._sources = [_open_camera(camera, path) for camera, path in enumerate(paths)]
        self._offsets, self._keep = shifts, on_error == "keep"
        self.camera_names: list[str] = names_of_files([s.path for s in self._sources])
        self._rate = self._common_rate(frame_rate)
        self._asked, self._stride = (start, end), stride
        self._ticks = self._shared_ticks(start, end, stride)
        self.interruption: CatFreeError | None = None

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return len(self._sources)

    @property
    def frame_count(self) -> int:
        """Number of instants that an iteration delivers if every frame can be decoded."""
        return len(self._ticks)

    def __len__(self) -> int:
        return self.frame_count

    @property
    def frames(self) -> Int[np.ndarray, " t"]:
        """(T,) frame index (tick) of each instant."""
        return np.array(self._ticks, np.int64)

    @property
    def fps(self) -> float | None:
        """Instants a second, or None for image folders without a `frame_rate`."""
        return None if self._rate is None else self._rate / self._stride

    @property
    def tick_rate(self) -> float | None:
        """Ticks (frame indices) a second, or None for image folders without a `frame_rate`."""
        return self._rate

    @property
    def offsets(self) -> tuple[int, ...]:
        """(C,) the frame of each camera, in its own frames, that shows tick 0."""
        return tuple(self._offsets)

    @property
    def image_size(self) -> Int[np.ndarray, "cam 2"]:
        """(C, 2) width and height of each camera's pictures in pixels."""
        return np.array([source.image_size for source in self._sources], np.int64)

    @property
    def fingerprint(self) -> str:
        """Content hash of all files and of what is delivered from them."""
        return hash_parameters(
            "SynchronizedVideos",
            *self.content_hashes,
            ticks=[self._ticks.start, self._ticks.stop, self._ticks.step],
            offsets=self._offsets,
            rate=self._rate,
            keep=self._keep,
        )

    @functools.cached_property
    def content_hashes(self) -> tuple[str, ...]:
        """(C,) SHA-256 of each camera's file or images."""
        return tuple(source.content_hash() for source in self._sources)

    @property
    def footage(self) -> tuple[CameraFootage, ...]:
        """(C,) what each camera brings, whether it is used or not."""
        start, end = self._asked
        brought = []
        for camera, source in enumerate(self._sources):
            first, last = self._span(camera)
            begin = first if start is None else max(first, start)
            stop = last + 1 if end is None else min(last + 1, end)
            brought.append(
                CameraFootage(
                    self.camera_names[camera],
                    source.path,
                    source.frame_count,
                    source.fps,
                    source.image_size,
                    range(begin, max(begin, stop), self._stride),
                )
            )
        return tuple(brought)

    def without_offsets(self, frame_offset: Sequence[int]) -> "SynchronizedVideos":
        """The same footage on corrected clocks, with those instants that are still complete.

        `catfree.calibration.remove_offsets` does the same to detections.

        Args:
            frame_offset: (C,) ticks by which each camera's ticks are too high.

        Raises:
            InsufficientDataError: if no instant is left that all cameras show.
        """
        later = [
            round(ticks * self._frames_a_tick(camera)) for camera, ticks in enumerate(frame_offset)
        ]
        corrected = copy.copy(self)
        corrected._offsets = [o + more for o, more in zip(self._offsets, later, strict=True)]
        shared = [corrected._span(camera) for camera in range(self.camera_count)]
        first, last = max(first for first, _ in shared), min(last for _, last in shared)
        kept = [tick for tick in self._ticks if first <= tick <= last]
        if not kept:
            raise InsufficientDataError(
                f"With the clocks corrected by {', '.join(map(str, frame_offset))} frames no "
                "instant lies in all videos. Record longer."
            )
        corrected._ticks = range(kept[0], kept[-1] + 1, self._stride)
        return corrected

    def __iter__(self) -> Iterator[tuple[int, list[Image]]]:
        """(frame index, one picture a camera) of each instant in order.

        Raises:
            FileFormatError: naming camera and frame, where a frame cannot be decoded or changes
                its size, unless `on_error` is "keep".
        """
        yield from self._instants(range(self.camera_count))

    def instants_from(self, first: int) -> Iterator[tuple[int, list[Image]]]:
        """Iterate over the instants without the `first` ones, which are not decoded to pictures.

        Args:
            first: position among the instants, 0-based; `frames[first]` is the first delivered.

        Raises:
            InvalidInputError: if the position is negative.
            FileFormatError: as iterating over all instants does.
        """
        if first < 0:
            raise InvalidInputError(f"first is {first}; positions among the instants start at 0.")
        yield from self._instants(range(self.camera_count), first)

    def pictures_of(self, camera: int) -> Iterator[Image]:
        """One camera's picture of each instant, without decoding the others.

        Args:
            camera: its index, 0-based.

        Raises:
            InvalidInputError: if there is no such camera.
            FileFormatError: as iterating over the instants does.
        """
        if not 0 <= camera < self.camera_count:
            raise InvalidInputError(
                f"There is no camera {camera}; the videos are of cameras 0 to "
                f"{self.camera_count - 1}."
            )
        for _, images in self._instants([camera]):
            yield images[0]

    def _instants(
        self, cameras: Sequence[int], first: int = 0
    ) -> Iterator[tuple[int, list[Image]]]:
        self.interruption = None
        with contextlib.ExitStack() as stack:
            readers: dict[int, FrameReader] = {}
            for camera in cameras:
                readers[camera] = self._sources[camera].open()
                stack.callback(readers[camera].close)

            def read(done: int) -> list[Image]:
                tick = self._ticks[done]
                return [self._read(c, reader, tick, done) for c, reader in readers.items()]

            # The next instant is decoded while this one is looked at.
            pool = stack.enter_context(ThreadPoolExecutor(1))
            count = len(self._ticks)
            ahead = deque(pool.submit(read, done) for done in range(first, min(first + 1, count)))
            for done in range(first, count):
                try:
                    images = ahead.popleft().result()
                except FileFormatError as error:
                    if not self._keep:
                        raise
                    self.interruption = error
                    return
                if done + 1 < count:
                    ahead.append(pool.submit(read, done + 1))
                yield self._ticks[done], images

    def _read(self, camera: int, reader: FrameReader, tick: int, done: int) -> Image:
        source = self._sources[camera]
        frame = self._source_frame(camera, tick)
        image = reader.read(frame)
        name = f"Camera {camera} ({self.camera_names[camera]!r})"
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

    def _common_rate(self, asked: float | int | None) -> float | None:
        known = {
            name: source.fps
            for name, source in zip(self.camera_names, self._sources, strict=True)
            if source.fps is not None
        }
        if asked is None:
            return min(known.values(), default=None)
        if not isinstance(asked, Real) or not (math.isfinite(asked) and asked > 0):
            raise InvalidInputError(f"frame_rate must be a positive number, got {asked!r}.")
        for name, rate in known.items():
            if asked > rate * (1 + _RATE_TOLERANCE):
                raise InvalidInputError(
                    f"frame_rate is {asked:g}, but camera {name!r} has only {rate:g} frames a "
                    "second. Ask for at most the lowest rate."
                )
        return float(asked)

    def _frames_a_tick(self, camera: int) -> float:
        own = self._sources[camera].fps
        if own is None or self._rate is None:
            return 1.0
        ratio = own / self._rate
        return 1.0 if abs(ratio - 1) < _RATE_TOLERANCE else ratio

    def _source_frame(self, camera: int, tick: int) -> int:
        # Half-way cases go up, so that the spacing stays even.
        return self._offsets[camera] + math.floor(tick * self._frames_a_tick(camera) + 0.5)

    def _span(self, camera: int) -> tuple[int, int]:
        """First and last tick of which a camera has a frame."""
        step, offset = self._frames_a_tick(camera), self._offsets[camera]
        first = math.ceil((-offset - 0.5) / step - 1e-9)
        count = self._sources[camera].frame_count
        return max(first, 0), math.ceil((count - offset - 0.5) / step - 1e-9) - 1

    def _shared_ticks(self, start: int | None, end: int | None, stride: int) -> range:
        firsts, lasts = zip(*map(self._span, range(self.camera_count)), strict=True)
        begin = max(firsts) if start is None else start
        stop = min(lasts) + 1 if end is None else min(end, min(lasts) + 1)
        if begin < max(firsts):
            camera = firsts.index(max(firsts))
            raise InvalidInputError(
                f"start is {begin}, but camera {self.camera_names[camera]!r} has its first picture "
                f"at tick {firsts[camera]}."
            )
        if begin >= stop:
            camera = lasts.index(min(lasts))
            raise InsufficientDataError(
                f"No instant lies in all {len(lasts)} videos from tick {begin} to before "
                f"{'the end' if end is None else end}: camera {self.camera_names[camera]!r} ends "
                f"after tick {lasts[camera]}. Check start, end and offsets."
            )
        return range(begin, stop, stride)


def _open_camera(camera: int, path: str | os.PathLike[str]) -> VideoSource:
    if not isinstance(path, str | os.PathLike):
        raise InvalidInputError(f"Camera {camera} must be a path, got a {type(path).__name__}.")
    try:
        return open_source(path)
    except CatFreeError as error:
        raise type(error)(f"Camera {camera}: {error}") from error
