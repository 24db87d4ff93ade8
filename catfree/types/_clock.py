"""The `Clock` that turns frame numbers into seconds."""

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError, quoted
from catfree.types._validation import as_float, as_integer, as_number, as_positive, require_finite

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Seconds from 1970 to 2001. No recording is that long, so larger times are absolute.
ABSOLUTE = 1e9
# Larger frame numbers are not exact as floats.
_LARGEST = 2.0**53


@dataclass(frozen=True, init=False)
class Clock:
    """The time of each frame number: `start + frame / frame_rate` seconds.

    Attributes:
        frame_rate: steps of the frame number per second.
        start: seconds of frame 0.
        utc: whether seconds count from 1970-01-01T00:00:00 UTC; otherwise from the start of the
            recording.
    """

    frame_rate: float
    start: float
    utc: bool

    def __init__(self, frame_rate: Any, start: Any = 0.0, utc: Any = False) -> None:
        """Check and store plain numbers.

        Args:
            frame_rate: as the attribute, like all others.
            start: of frame 0.
            utc: whether seconds count from 1970.

        Raises:
            InvalidInputError: if a value is not a finite number, or the rate is not positive.
        """
        if not isinstance(utc, bool | np.bool_):
            raise InvalidInputError(f"utc is {quoted(utc)}; it must be true or false.")
        object.__setattr__(self, "frame_rate", as_positive(frame_rate, "frame_rate"))
        object.__setattr__(self, "start", as_number(start, "start"))
        object.__setattr__(self, "utc", bool(utc))

    def seconds(self, frame: Any) -> Float[np.ndarray, "..."]:
        """Return the float64 seconds of frame numbers of any shape."""
        return np.asarray(self.start + as_integer(frame, "frame") / self.frame_rate)

    def frame_at(self, seconds: Any) -> Int[np.ndarray, "..."]:
        """Return the int64 number of the frame nearest to each time; half-way cases round up.

        Args:
            seconds: times of any shape, on this clock.

        Raises:
            InvalidInputError: if a time is not finite, or so far away that frame numbers are not
                exact.
        """
        time = np.asarray(as_float(seconds), np.float64)
        require_finite(time, "seconds")
        with np.errstate(over="ignore"):
            frame = np.floor((time - self.start) * self.frame_rate + 0.5)
        if (np.abs(frame) >= _LARGEST).any():
            raise InvalidInputError(
                "seconds are too far from the start of the clock for an exact frame number; are "
                "they on this clock, and not milliseconds?"
            )
        return np.asarray(frame, np.int64)

    def describe(self) -> str:
        """Describe what second 0 means: an ISO date, or the start of the recording."""
        if not self.utc:
            return "start of recording"
        try:
            return (_EPOCH + timedelta(seconds=self.start)).isoformat().replace("+00:00", "Z")
        except OverflowError:
            return f"{self.start!r} s after 1970-01-01T00:00:00Z"


def clock_to_array(clock: Clock | None) -> Float[np.ndarray, "3"] | None:
    """Return the rate, the start and the UTC flag as an array, for archives."""
    if clock is None:
        return None
    return np.array([clock.frame_rate, clock.start, clock.utc], np.float64)


def clock_from_array(values: Any) -> Clock | None:
    """Invert `clock_to_array`.

    Raises:
        InvalidInputError: if these are not the three numbers of a valid clock.
    """
    if values is None:
        return None
    array = np.asarray(as_float(values), np.float64)
    if array.shape != (3,) or array[2] not in (0, 1):
        raise InvalidInputError(f"clock is {quoted(values)}, not rate, start and kind of a clock.")
    return Clock(float(array[0]), float(array[1]), bool(array[2]))


def clock_to_text(clock: Clock | None) -> str:
    """Return the clock as JSON, for the metadata of tables."""
    return json.dumps(None if clock is None else asdict(clock))


def clock_from_text(text: str | bytes) -> Clock | None:
    """Invert `clock_to_text`.

    Raises:
        InvalidInputError: if the text is damaged, or a value is out of range.
    """
    try:
        clock = json.loads(text)
        values = None if clock is None else [clock[name] for name in ("frame_rate", "start", "utc")]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InvalidInputError(f"{quoted(text)} is not a clock: {quoted(error)}.") from error
    return None if values is None else Clock(*values)


def require_clock(clock: Any) -> Clock | None:
    """Return a clock or None; raise for anything else.

    Raises:
        InvalidInputError: naming the type of the argument.
    """
    if not (clock is None or isinstance(clock, Clock)):
        raise InvalidInputError(
            f"clock must be a Clock or None, got {type(clock).__name__}. Pass cf.Clock(frame_rate)."
        )
    return clock
