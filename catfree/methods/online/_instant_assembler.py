"""Gather the frames of several cameras, in the order of their arrival, to instants."""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from catfree.errors import InvalidInputError
from catfree.types import Detections
from catfree.types._validation import (
    as_count,
    as_duration,
    as_number,
    as_positive,
    require_instance,
)


class DroppedFrame(NamedTuple):
    """A frame that is part of no instant.

    Attributes:
        camera: index of the camera.
        time: of the frame in seconds.
        reason: "late" if its instant was already handed out, "replaced" if the camera delivered a
            newer frame of the same instant.
    """

    camera: int
    time: float
    reason: Literal["late", "replaced"]


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
    than that, and a camera may deliver at a higher rate: the newest frame of an instant counts.

    Attributes:
        camera_count: number of cameras of the rig.
        frame_rate: instants per second.
        timeout: seconds, by the times of the frames, for which an instant waits for missing cameras
            although a newer one began.
    """

    camera_count: int
    frame_rate: float | int
    timeout: float | int = 0.0
    _open: dict[int, dict[int, tuple[float, Detections]]] = field(default_factory=dict, repr=False)
    _closed: int | None = field(default=None, repr=False)
    _origin: tuple[int, float] | None = field(default=None, repr=False)
    _newest: float = field(default=-np.inf, repr=False)
    _dropped: list[DroppedFrame] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: if there is no camera, the rate is not positive, or the timeout is
                negative or not finite.
        """
        self.camera_count = as_count(self.camera_count, "camera_count")
        if self.camera_count < 1:
            raise InvalidInputError("camera_count is 0; an instant needs at least one camera.")
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
        time = as_number(time, f"The time of a frame of camera {camera}")
        number = self._number(time)
        if self._closed is not None and number <= self._closed:
            self._dropped.append(DroppedFrame(camera, time, "late"))
            return ()
        frames = self._open.setdefault(number, {})
        before = frames.get(camera)
        if before is not None:
            older = min(before[0], time)
            self._dropped.append(DroppedFrame(camera, older, "replaced"))
        if before is None or time >= before[0]:
            frames[camera] = time, detections
        self._newest = max(self._newest, time)
        return self._finished()

    def finish(self) -> tuple[Instant, ...]:
        """Return the instants that still wait for cameras, at the end of a stream."""
        return tuple(self._close(number) for number in sorted(self._open))

    def _number(self, time: float) -> int:
        """The instant of a time."""
        if self._origin is None:
            self._origin = 0, time
        number, start = self._origin
        return number + int(np.floor((time - start) * self.frame_rate + 0.5))

    def _finished(self) -> tuple[Instant, ...]:
        """Close what is complete, and everything older than it or older than the timeout."""
        order = sorted(self._open)
        last = None
        for number in order:
            time = max(taken for taken, _ in self._open[number].values())
            complete = len(self._open[number]) == self.camera_count
            begun = number < order[-1] and self.timeout == 0
            if complete or begun or (self.timeout > 0 and self._newest - time > self.timeout):
                last = number
        return tuple(self._close(n) for n in order if last is not None and n <= last)

    def _close(self, number: int) -> Instant:
        """Hand out an open instant."""
        frames = sorted(self._open.pop(number).items())
        time = float(np.mean([taken for _, (taken, _) in frames]))
        self._closed, self._origin = number, (number, time)
        boxes = [
            replace(
                found,
                frame=np.full(len(found), number),
                camera=np.full(len(found), camera),
                clock=None,
            )
            for camera, (_, found) in frames
        ]
        cameras = tuple(camera for camera, _ in frames)
        dropped, self._dropped = tuple(self._dropped), []
        return Instant(number, time, Detections.concatenate(boxes), cameras, dropped)
