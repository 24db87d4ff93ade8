"""Assembly of frames from several cameras, in order of arrival, into instants."""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from catfree.errors import InvalidInputError
from catfree.types import Detections
from catfree.types._detections import concatenate_common
from catfree.types._validation import (
    as_count,
    as_duration,
    as_number,
    as_positive,
    require_instance,
)

LEAP = 10.0  # seconds, or intervals if these are longer
MOST_DROPPED = 1000  # left-out frames that are remembered


class DroppedFrame(NamedTuple):
    """A frame that was left out of all instants.

    Attributes:
        camera: index of the camera.
        time: of the frame in seconds.
        reason: "late" if its instant had already been returned, "replaced" if the camera delivered
            a newer frame of the same instant, "early" if no other camera was as far ahead.
    """

    camera: int
    time: float
    reason: Literal["late", "replaced", "early"]


class _Frame(NamedTuple):
    """A frame delivered by a camera."""

    camera: int
    time: float
    detections: Detections


@dataclass(frozen=True)
class Instant:
    """The frames of all cameras at one moment.

    Attributes:
        number: number of the instant, counting instants without any frame.
        time: mean time of the frames in seconds.
        detections: (N,) boxes of all cameras; their `frame` is the number of the instant.
        cameras: cameras that delivered a frame, in ascending order. A camera that is missing here
            has no picture, which is not the same as seeing nobody.
        dropped: frames left out since the previous instant was returned.
    """

    number: int
    time: float
    detections: Detections
    cameras: tuple[int, ...]
    dropped: tuple[DroppedFrame, ...] = ()


@dataclass
class InstantAssembler:
    """Assemble frames that arrive one by one into instants, using only the frames' times.

    An instant is complete when all cameras have delivered. An incomplete instant is returned as
    soon as a newer one begins or, with a `timeout`, as soon as a newer one is complete or a frame
    arrives that is newer by more than the timeout. Instants are returned in order, each once.

    Frames belong to the same instant if they are less than half a frame interval from its expected
    time, which follows the times of the returned instants. Camera clocks may jitter by less than
    that. If a camera delivers at a higher rate, the newest frame of an instant counts. A frame that
    is more than ten seconds (or intervals, or the timeout) ahead of all others waits until a frame
    of another camera is as far ahead, so that a single wrong time does not end all other instants.

    Attributes:
        camera_count: number of cameras of the rig.
        frame_rate: instants per second.
        timeout: seconds, by the frames' times, for which an instant waits for missing cameras after
            a newer one began.
    """

    camera_count: int
    frame_rate: float | int
    timeout: float | int = 0.0
    _open: dict[int, dict[int, _Frame]] = field(default_factory=dict, repr=False)
    _held: _Frame | None = field(default=None, repr=False)
    _closed: int | None = field(default=None, repr=False)
    _origin: tuple[int, float] | None = field(default=None, repr=False)
    _newest: float = field(default=-np.inf, repr=False)
    _dropped: deque[DroppedFrame] = field(
        default_factory=lambda: deque(maxlen=MOST_DROPPED), repr=False
    )

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: if there are no cameras, the rate is not positive, or the timeout is
                negative or not finite.
        """
        self.camera_count = as_count(self.camera_count, "camera_count", least=1)
        self.frame_rate = as_positive(self.frame_rate, "frame_rate")
        self.timeout = as_duration(self.timeout, "timeout")

    def add(
        self, camera: int | np.integer, time: float | int, detections: Detections
    ) -> tuple[Instant, ...]:
        """Add a frame of one camera and return the instants that it finishes.

        Args:
            camera: index of the camera.
            time: capture time in seconds; all cameras count from the same moment.
            detections: (N,) its boxes, none if it shows nobody; their `frame` and `camera` are
                replaced.

        Raises:
            InvalidInputError: if the camera does not exist, or the time is not finite.
        """
        require_instance(detections, Detections, "detections")
        camera = as_count(camera, "camera")
        if not 0 <= camera < self.camera_count:
            raise InvalidInputError(
                f"There is no camera {camera}; the assembler has cameras 0 to "
                f"{self.camera_count - 1}."
            )
        frame = _Frame(
            camera, as_number(time, f"The time of a frame of camera {camera}"), detections
        )
        self._drop_wrong_start(frame.time)
        if not self._leaps(frame.time):
            self._drop_held()
            self._place(frame)
        elif self._held is None or self._held.camera == camera:
            self._drop_held()
            self._held = frame
        else:  # two cameras agree that time has advanced
            held, self._held = self._held, None
            for one in sorted([held, frame], key=lambda one: one.time):
                self._place(one)
        return self._finished()

    def finish(self) -> tuple[Instant, ...]:
        """Return the instants still waiting for cameras at the end of a stream."""
        self._drop_held()
        instants = []
        while self._open:
            instants.append(self._close(min(self._open)))
        return tuple(instants)

    def take_dropped(self) -> tuple[DroppedFrame, ...]:
        """Return the left-out frames that no instant has named yet, and forget them.

        The next instant would name them; call this if the stream may end, or a clock may be set
        back, before then.
        """
        dropped = tuple(self._dropped)
        self._dropped.clear()
        return dropped

    @property
    def _far(self) -> float:
        """Seconds ahead of all other frames at which a single camera is not believed."""
        return max(self.timeout, LEAP * max(1.0, 1 / self.frame_rate))

    def _leaps(self, time: float) -> bool:
        """Return whether a time is too far ahead of all frames to believe a single camera."""
        several = self.camera_count > 1 and np.isfinite(self._newest)
        return bool(several and time - self._newest > self._far)

    def _drop_wrong_start(self, time: float) -> None:
        """Drop the first camera's frames if they are too far ahead of the next frame."""
        waiting = sorted(frame for frames in self._open.values() for frame in frames.values())
        alone = len({frame.camera for frame in waiting}) == 1
        if self._closed is None and alone and self._newest - time > self._far:
            self._dropped += [DroppedFrame(one.camera, one.time, "early") for one in waiting]
            self._open, self._origin, self._newest = {}, None, -np.inf

    def _drop_held(self) -> None:
        """Drop the frame that was ahead of all others and that no other camera confirmed."""
        if self._held is not None:
            self._dropped.append(DroppedFrame(self._held.camera, self._held.time, "early"))
            self._held = None

    def _place(self, frame: _Frame) -> None:
        """Put a frame into its instant if that is still open."""
        if self._origin is None:
            self._origin = 0, frame.time
        number, start = self._origin
        number += int(np.floor((frame.time - start) * self.frame_rate + 0.5))
        self._newest = max(self._newest, frame.time)
        if self._closed is not None and number <= self._closed:
            self._dropped.append(DroppedFrame(frame.camera, frame.time, "late"))
            return
        frames = self._open.setdefault(number, {})
        earlier = frames.setdefault(frame.camera, frame)
        if earlier is not frame:
            older, newer = sorted([earlier, frame], key=lambda one: one.time)
            self._dropped.append(DroppedFrame(frame.camera, older.time, "replaced"))
            frames[frame.camera] = newer

    def _finished(self) -> tuple[Instant, ...]:
        """Close instants that are over, and everything older."""
        instants = []
        while any(map(self._is_over, self._open)):
            instants.append(self._close(min(self._open)))
        return tuple(instants)

    def _is_over(self, number: int) -> bool:
        """Return whether an open instant is complete or no longer waits for cameras."""
        frames = self._open[number]
        if len(frames) == self.camera_count:
            return True
        if self.timeout == 0:
            return number < max(self._open)
        return self._newest - max(frame.time for frame in frames.values()) > self.timeout

    def _close(self, number: int) -> Instant:
        """Close an open instant, and re-place the frames of the others, which follow its time."""
        frames = sorted(self._open.pop(number).values())
        time = float(np.mean([frame.time for frame in frames]))
        self._closed, self._origin = number, (number, time)
        waiting = [frame for later in self._open.values() for frame in later.values()]
        self._open = {}
        for frame in waiting:
            self._place(frame)
        boxes = [
            replace(
                detections,
                frame=np.full(len(detections), number),
                camera=np.full(len(detections), camera),
                clock=None,
            )
            for camera, _, detections in frames
        ]
        cameras = tuple(frame.camera for frame in frames)
        return Instant(number, time, concatenate_common(boxes), cameras, self.take_dropped())
