"""Boxes as lines of JSON in, positions as records out, while the cameras record."""

import json
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from catfree.errors import CatFreeError, InvalidInputError, quoted, shortened
from catfree.methods.online._instant_assembler import (
    LEAP,
    DroppedFrame,
    Instant,
    InstantAssembler,
)
from catfree.methods.online._tracker import Tracker
from catfree.methods.online._update import Update
from catfree.types import Detections, Tracks
from catfree.types._validation import (
    as_float,
    as_instances,
    is_listed,
    parse_json,
    require_instance,
    require_names,
)

Record = dict[str, Any]
TEXT = str | bytes | bytearray  # as delivered by message brokers


def watch(
    lines: Iterable[Any],
    tracker: Tracker,
    camera_names: Sequence[str],
    *,
    frame_rate: float | int,
    timeout: float | int = 0.0,
) -> Iterator[Record]:
    """Yield records of positions for lines of boxes, each as soon as it is available.

    A line is a JSON object for one frame of one camera: `camera` (name, or index where no name is a
    number), `time` (seconds, or an ISO 8601 date and time with its zone), `boxes` (x1, y1, x2, y2
    in pixels each) and, if there are any, `scores` and `embeddings`, one per box. A frame without
    people needs a line, too: without a line, the picture counts as missing.

    Args:
        lines: any source of text or bytes: a file, standard input, a generator fed by a broker.
        tracker: the tracker that locates the people.
        camera_names: names of the scene's cameras, in order.
        frame_rate: instants per second.
        timeout: as for `InstantAssembler`.

    Raises:
        InvalidInputError: at the first record, if the number of names, the rate or the timeout is
            invalid.

    Yields:
        Dictionaries that JSON can hold, told apart by `type`: "provisional" and "final" (`time`
        and `people`: `id`, `x`, `y`, `covariance`, `velocity` in scene units and seconds,
        `existence`; none if nobody is there), "merge" (identity `old` is `new`), "dropped" (a frame
        that came too late or too early, or was replaced by a newer one), "silent" (no frame of
        `camera` came in the ten seconds, or ten intervals, before `time`, or none at all until the
        end; reported once until another frame comes) and "error" (`line`, counted from 1, and
        `message`: a line or an instant that could not be used; reading continues).
    """
    require_instance(tracker, Tracker, "tracker")
    if not is_listed(lines):
        raise InvalidInputError(f"lines must be lines of text, got {type(lines).__name__}.")
    camera_names = as_instances(camera_names, str, "camera_names")
    require_names(camera_names, tracker.scene.rig.camera_count, distinct=True)
    assembler = InstantAssembler(len(camera_names), frame_rate, timeout)
    silence = _Silence(camera_names, LEAP * max(1.0, 1 / assembler.frame_rate))
    waiting: deque[float] = deque()  # times of instants that are not final
    number = 0
    for number, line in enumerate(lines, 1):
        if isinstance(line, TEXT) and not line.strip():
            continue
        try:
            instants = assembler.add(*parse_frame(line, camera_names))
        except CatFreeError as error:
            yield _error(number, error)
            continue
        yield from _answers(instants, tracker, silence, waiting, number)
        yield from _dropped(assembler.take_dropped(), camera_names)
    yield from _answers(assembler.finish(), tracker, silence, waiting, number)
    yield from _dropped(assembler.take_dropped(), camera_names)
    yield from silence.at_end()
    yield from records_of(tracker.finish(), waiting)


class _Silence:
    """Watch for cameras that have delivered no frames for long.

    Attributes:
        names: (C,) names of the cameras.
        patience: seconds without frames that count as long.
        now: time of the last instant.
        last: time of the last frame of each camera, or of the first instant if it has none.
        told: cameras reported since then.
        unheard: cameras without any frame so far.
    """

    def __init__(self, names: Sequence[str], patience: float) -> None:
        self.names, self.patience = names, patience
        self.now, self.last = -math.inf, list[float]()
        self.told: set[int] = set()
        self.unheard = set(range(len(names)))

    def after(self, instant: Instant) -> Iterator[Record]:
        """Report the cameras that have been silent for long at an instant."""
        self.last = self.last or [instant.time] * len(self.names)
        self.now = instant.time
        for camera in instant.cameras:
            self.last[camera] = instant.time
        self.told.difference_update(instant.cameras)
        self.unheard.difference_update(instant.cameras)
        yield from self._tell(c for c, t in enumerate(self.last) if self.now - t >= self.patience)

    def at_end(self) -> Iterator[Record]:
        """Report the cameras that never delivered a frame, if others did."""
        if self.last:
            yield from self._tell(sorted(self.unheard))

    def _tell(self, cameras: Iterable[int]) -> Iterator[Record]:
        for camera in cameras:
            if camera not in self.told:
                self.told.add(camera)
                yield {"type": "silent", "camera": self.names[camera], "time": self.now}


def _answers(
    instants: Iterable[Instant],
    tracker: Tracker,
    silence: _Silence,
    waiting: deque[float],
    line: int,
) -> Iterator[Record]:
    """Track the instants that a line completed; an unusable one does not stop the rest."""
    for instant in instants:
        yield from _dropped(instant.dropped, silence.names)
        yield from silence.after(instant)
        try:
            update = tracker.update(instant.detections, instant.time, instant.cameras)
        except CatFreeError as error:
            yield _error(line, error)
            continue
        waiting.append(instant.time)
        yield from records_of(update, waiting)
        yield _people("provisional", instant.time, update.provisional)


def _error(line: int, error: CatFreeError) -> Record:
    return {"type": "error", "line": line, "message": str(error)}


def _dropped(frames: Iterable[DroppedFrame], names: Sequence[str]) -> Iterator[Record]:
    """Report frames that were left out."""
    for camera, time, reason in frames:
        yield {"type": "dropped", "camera": names[camera], "time": time, "reason": reason}


def records_of(update: Update, waiting: deque[float]) -> Iterator[Record]:
    """Yield the events and the final positions of an update, one record per instant.

    Args:
        update: the tracker's update.
        waiting: times of instants that were not final before; those that now are get removed.
    """
    for event in update.events:
        yield {"type": event.kind, "time": event.time, "old": event.old, "new": event.new}
    final = update.final
    while waiting and waiting[0] <= update.final_until:
        time = waiting.popleft()
        frame = final.clock.frame_at(time) if final.clock else time
        yield _people("final", time, final[final.frame == frame])


def _people(kind: str, time: float, tracks: Tracks) -> Record:
    """Describe the positions of one instant."""
    rate = 1.0 if tracks.clock is None else tracks.clock.frame_rate
    people = []
    for row in range(len(tracks)):
        x, y = tracks.ground_xy[row].tolist()
        person: Record = {
            "id": int(tracks.track_id[row]),
            "x": x,
            "y": y,
            "covariance": tracks.covariance[row].tolist(),
        }
        velocity = tracks.velocity[row] * rate
        if np.isfinite(velocity).all():
            person["velocity"] = velocity.tolist()
        if tracks.existence is not None:
            person["existence"] = float(tracks.existence[row])
        people.append(person)
    return {"type": kind, "time": time, "people": people}


def parse_frame(line: Any, camera_names: Sequence[str]) -> tuple[int, float, Detections]:
    """Read one line of `watch`.

    Returns:
        The index of the camera, the time in seconds, and the boxes as detections of frame 0.

    Raises:
        InvalidInputError: saying what is wrong with the line.
    """
    if not isinstance(line, TEXT):
        raise InvalidInputError(
            f"A line must be the text of a JSON object, got {type(line).__name__}. Pass json.dumps "
            "of an object, or the lines that hold it."
        )
    try:
        record = parse_json(line)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{quoted(line.strip())} is not JSON: {quoted(error)}.") from error
    if not isinstance(record, dict):
        raise InvalidInputError(f"{quoted(line.strip())} is not a JSON object.")
    missing = [key for key in ("camera", "time", "boxes") if key not in record]
    if missing:
        raise InvalidInputError(f"The line has no {quoted(missing[0])}.")
    camera = _camera(record["camera"], camera_names)
    time = _seconds(record["time"])
    try:
        boxes = as_float(record["boxes"])
        if boxes.size and (boxes.ndim != 2 or boxes.shape[1] != 4):
            raise InvalidInputError("not four numbers per box")
        columns = {
            column: as_float(record[key])
            for key, column in (("scores", "score"), ("embeddings", "embedding"))
            if record.get(key) is not None
        }
    except InvalidInputError as error:
        raise InvalidInputError(
            "boxes must be a list of x1, y1, x2, y2 each, scores a list of numbers, and embeddings "
            "a list of lists of equal length."
        ) from error
    count = len(boxes) if boxes.size else 0
    return camera, time, Detections(np.zeros(count, int), np.full(count, camera), boxes, **columns)


def _camera(value: Any, names: Sequence[str]) -> int:
    """Find a camera by name or index; if a name looks like a number, numbers are names."""
    if isinstance(value, str | int) and str(value) in names:
        return list(names).index(str(value))
    counted = not any(name.isdecimal() for name in names)
    if counted and type(value) is int and 0 <= value < len(names):
        return value
    raise InvalidInputError(
        f"There is no camera {_as_written(value)}; there are {', '.join(names)}."
    )


def _as_written(value: Any) -> str:
    """Format a value of a line for a message, with null and true as in JSON."""
    return quoted(value) if isinstance(value, str) else shortened(json.dumps(value))


def _seconds(value: Any) -> float:
    """Convert a number, or an ISO 8601 date and time with a zone (since 1970), to seconds."""
    if isinstance(value, str):
        try:
            moment = datetime.fromisoformat(value)
        except ValueError:
            raise InvalidInputError(
                f"time is {quoted(value)}; it must be seconds, or a date and time such as "
                "2026-05-01T12:00:00.25Z."
            ) from None
        if moment.tzinfo is None:
            raise InvalidInputError(f"time {quoted(value)} has no zone; end it with Z for UTC.")
        return moment.timestamp()
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) < 1e15:
        raise InvalidInputError(f"time is {_as_written(value)}; it must be a number of seconds.")
    return float(value)
