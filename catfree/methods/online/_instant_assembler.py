"""Gather the frames of several cameras, in the order of their arrival, to instants."""

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
MOST_DROPPED = 1000  # frames that were left out and are remembered


class DroppedFrame(NamedTuple):
    """A frame that is part of no instant.

    Attributes:
        camera: index of the camera.
        time: of the frame in seconds.
        reason: "late" if its instant was already handed out, "replaced" if the camera delivered a
            newer frame of the same instant, "early" if no other camera was so far ahead.
    """

    camera: int
    time: float
    reason: Literal["late", "replaced", "early"]


class _Frame(NamedTuple):
    """What a camera delivered."""

    camera: int
    time: float
    detections: Detections


@dataclass(frozen=True)
class Instant:
    """What the cameras saw at one moment.

    Attributes:
        number: of the instant: instants without any frame are counted, too.
        time: mean time of the frames in seconds.
        detections: (N,) boxes of all cameras, their `frame` the number of the instant.
        cameras: cameras that delivered a frame, in ascending order. One that is missing here said
            nothing, which is not the same as having seen nobody.
        dropped: frames that were left out since the previous instant was handed out.
    """

    number: int
    time: float
    detections: Detections
    cameras: tuple[int, ...]
    dropped: tuple[DroppedFrame, ...] = ()


@dataclass
class InstantAssembler:
    """Gather frames that arrive one by one to instants, without a clock of its own.

    An instant is complete when all cameras delivered. Otherwise it is handed out as soon as a newer
    instant begins or, with a `timeout`, as soon as a newer instant is complete or a frame arrives
    that is newer by more than the timeout. Instants are handed out in order, each once.

    Frames belong to the same instant if they are less than half a frame interval from its expected
    time, which follows the times of the instants handed out. Clocks of cameras may jitter by less
    than that, and a camera may deliver at a higher rate: the newest frame of an instant counts. A
    frame that is more than ten seconds (or intervals, or the timeout) ahead of all others waits
    until a frame of another camera is as far ahead: a single wrong time does not end all other
    instants.

    Attributes:
        camera_count: number of cameras of the rig.
        frame_rate: instants per second.
        timeout: seconds, by the times of the frames, for which an instant waits for missing cameras
            although a newer one began.
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
            InvalidInputError: if there is no camera, the rate is not positive, or the timeout is
                negative or not finite.
        """
        self.camera_count = as_count(self.camera_count, "camera_count", least=1)
        self.frame_rate = as_positive(self.frame_rate, "frame_rate")
        self.timeout = as_duration(self.timeout, "timeout")

    def add(
        self, camera: int | np.integer, time: float | int, detections: Detections
    ) -> tuple[Instant, ...]:
        """Take a frame of one camera and return the instants that are finished by it.

        Args:
            camera: index of the camera.
            time: when the frame was taken, in seconds; all cameras count from the same moment.
            detections: (N,) its boxes, none if it shows nobody; `frame` and `camera` are replaced.

        Raises:
            InvalidInputError: if there is no such camera, or the time is not finite.
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
        else:  # two cameras agree that time went on
            held, self._held = self._held, None
            for one in sorted([held, frame], key=lambda one: one.time):
                self._place(one)
        return self._finished()

    def finish(self) -> tuple[Instant, ...]:
        """Return the instants that still wait for cameras, at the end of a stream."""
        self._drop_held()
        instants = []
        while self._open:
            instants.append(self._close(min(self._open)))
        return tuple(instants)

    def take_dropped(self) -> tuple[DroppedFrame, ...]:
        """Return the frames that were left out and that no instant has named yet, and forget them.

        The next instant names them; ask here if a stream may end, or a clock be set back, before
        there is one.
        """
        dropped = tuple(self._dropped)
        self._dropped.clear()
        return dropped

    @property
    def _far(self) -> float:
        """Seconds ahead of all other frames that are not believed of one camera."""
        return max(self.timeout, LEAP * max(1.0, 1 / self.frame_rate))

    def _leaps(self, time: float) -> bool:
        """Return whether a time is too far ahead of all frames for one camera to be believed."""
        several = self.camera_count > 1 and np.isfinite(self._newest)
        return bool(several and time - self._newest > self._far)

    def _drop_wrong_start(self, time: float) -> None:
        """Leave out what the first camera delivered if it is too far ahead of the next frame."""
        waiting = sorted(frame for frames in self._open.values() for frame in frames.values())
        alone = len({frame.camera for frame in waiting}) == 1
        if self._closed is None and alone and self._newest - time > self._far:
            self._dropped += [DroppedFrame(one.camera, one.time, "early") for one in waiting]
            self._open, self._origin, self._newest = {}, None, -np.inf

    def _drop_held(self) -> None:
        """Leave out the frame that was ahead of all others, which no other camera confirmed."""
        if self._held is not None:
            self._dropped.append(DroppedFrame(self._held.camera, self._held.time, "early"))
            self._held = None

    def _place(self, frame: _Frame) -> None:
        """Put a frame into its instant, if that is still open."""
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
        """Close what is over, and everything older."""
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
        """Hand out an open instant. The others follow its time, so their frames are placed anew."""
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
