"""One clock for cameras whose frames have times of their own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InsufficientDataError, InvalidInputError, quoted
from catfree.types import Clock, Detections
from catfree.types._clock import ABSOLUTE
from catfree.types._validation import as_finite, as_positive, is_listed, require_instance

# A request for 30 ticks per second from a camera of 29.97 means that camera's rate.
RATE_TOLERANCE = 0.01
# A frame shows a tick if it is within this many ticks of it: half a tick, and slack for the jitter
# of cameras whose frames lie midway between two ticks.
REACH = 0.6

Times = Float[np.ndarray, " _"]  # seconds of frames, increasing; of any length


def on_common_clock(
    detections: Detections, timestamps: Sequence[Any], frame_rate: float | int | None = None
) -> Detections:
    """Renumber the frames of detections so that equal numbers mean equal times.

    Tick k is at `start + k / frame_rate` seconds, where `start` is the earliest timestamp. Each box
    gets the tick nearest to its frame. No two frames of one camera share a tick: the farther one
    moves to a free neighboring tick within 0.6 ticks of it, or is left out with its boxes. These
    are the ticks of `SynchronizedVideos`.

    Args:
        detections: boxes whose frame numbers count the frames of each camera, from 0.
        timestamps: (C) arrays: (T_c,) increasing seconds of camera c's frames 0 to T_c - 1. Times
            beyond 1e9 count from 1970-01-01T00:00:00 UTC.
        frame_rate: ticks per second; None for the lowest rate among the cameras, from the mean of
            the intervals near their median, or of all if none is near it.

    Returns:
        The detections with ticks as frame numbers, and the clock.

    Raises:
        InvalidInputError: naming the first camera whose timestamps are invalid, are too few for its
            boxes, or are absolute while another camera's are not; or if the rate is higher than a
            camera's.
        InsufficientDataError: if no camera has two timestamps, which the rate requires.
    """
    require_instance(detections, Detections, "detections")
    if not is_listed(timestamps):
        raise InvalidInputError(
            f"timestamps must list those of each camera, got {type(timestamps).__name__}."
        )
    times = [_increasing(values, camera) for camera, values in enumerate(timestamps)]
    stated = {f"{camera}": seconds for camera, seconds in enumerate(times) if len(seconds)}
    rates = {name: rate_of(seconds) for name, seconds in stated.items() if len(seconds) > 1}
    rate = common_rate(rates, frame_rate)
    if rate is None:
        raise InsufficientDataError(
            "No camera has two timestamps, so the frame rate is unknown. Pass frame_rate."
        )
    start, utc = common_start(list(stated.values()), list(stated))
    ticks = [ticks_of_frames(seconds, start, rate) for seconds in times]
    tick = np.full(len(detections), -1)
    for camera in np.unique(detections.camera).tolist():
        rows = np.flatnonzero(detections.camera == camera)
        frame = detections.frame[rows]
        known = len(ticks[camera]) if camera < len(ticks) else 0
        bad = (frame < 0) | (frame >= known)
        if bad.any():
            raise InvalidInputError(
                f"frame[{rows[bad][0]}] is {frame[bad][0]}, but camera {camera} has {known} "
                "timestamps, for its frames from 0 on. Give every frame a timestamp."
            )
        tick[rows] = ticks[camera][frame]
    kept = np.flatnonzero(tick >= 0)
    return replace(detections[kept], frame=tick[kept], clock=Clock(rate, start, utc))


def rate_of(times: Times) -> float:
    """Return the frames per second of at least two increasing times.

    Args:
        times: seconds.

    Returns:
        The rate from the mean of the intervals near their median: gaps of dropped frames do not
        count, and rounding of times to milliseconds does no harm. If no interval is near it, as
        when frames come in pairs, the rate is from the mean of all.
    """
    step = np.diff(times)
    middle = float(np.median(step))
    near = step[np.abs(step - middle) <= middle / 2]
    return 1 / float((near if len(near) else step).mean())


def common_rate(rates: dict[str, float], frame_rate: float | int | None) -> float | None:
    """Return the ticks per second: the lowest rate among the cameras, or the requested one.

    Args:
        rates: frames per second by camera name, of cameras that have a rate.
        frame_rate: the wanted rate, or None.

    Raises:
        InvalidInputError: if it is not a positive number, or a camera is slower.
    """
    if frame_rate is None:
        return min(rates.values(), default=None)
    wanted = as_positive(frame_rate, "frame_rate")
    for name, rate in rates.items():
        if wanted > rate * (1 + RATE_TOLERANCE):
            raise InvalidInputError(
                f"frame_rate is {wanted:g}, but camera {quoted(name)} has only {rate:g} frames "
                "per second. Pass at most the lowest rate."
            )
    return wanted


def common_start(times: Sequence[Times], names: Sequence[str]) -> tuple[float, bool]:
    """Return the earliest time, and whether times count from 1970 (UTC).

    Args:
        times: seconds of each camera's frames, none empty.
        names: names of these cameras.

    Raises:
        InvalidInputError: if some times are absolute and others are not.
    """
    first = [float(seconds[0]) for seconds in times]
    absolute = [start > ABSOLUTE for start in first]
    if any(absolute) and not all(absolute):
        raise InvalidInputError(
            f"Camera {quoted(names[absolute.index(True)])} has absolute times (seconds since "
            f"1970), but camera {quoted(names[absolute.index(False)])} does not: it cannot be "
            "placed on that clock. Give all cameras absolute times, or none."
        )
    return min(first, default=0.0), any(absolute)


def nearest_frame(times: Times, seconds: Times) -> Int[np.ndarray, " _"]:
    """Return the index of the time nearest to each of some seconds; half-way cases round up."""
    after = np.clip(np.searchsorted(times, seconds), 1, max(len(times) - 1, 1))
    upper = np.minimum(after, len(times) - 1)
    return np.where(times[upper] - seconds <= seconds - times[after - 1], upper, after - 1)


def ticks_of_frames(times: Times, start: float, rate: float) -> Int[np.ndarray, " _"]:
    """Return the tick of each frame, or -1 for a frame that is left out; see `on_common_clock`.

    Args:
        times: increasing seconds of one camera's frames.
        start: seconds of tick 0, not after any frame.
        rate: ticks per second.
    """
    exact = (times - start) * rate
    tick = np.floor(exact + 0.5).astype(np.int64)
    _make_room(tick, exact, 0)
    # The same toward later ticks, mirrored.
    mirrored = -tick[::-1]
    _make_room(mirrored, -exact[::-1], -np.iinfo(np.int64).max)
    tick = -mirrored[::-1]
    # Of the frames that still share a tick, the nearest stays.
    order = np.lexsort((np.abs(exact - tick), tick))
    best = np.zeros(len(tick), bool)
    best[order[np.diff(tick[order], prepend=-1) > 0]] = True
    return np.where(best, tick, -1)


def _make_room(tick: Int[np.ndarray, " n"], exact: Times, lowest: int) -> None:
    """Move frames that share a tick with the next one to the tick before, in place.

    Frames in the way move along, if a free tick follows and none ends farther than `REACH` away.

    Args:
        tick: tick of each frame, ascending, possibly repeated.
        exact: tick of each frame before rounding.
        lowest: tick that no frame may go below.
    """
    movable = tick - exact >= 1 - REACH
    for last in np.flatnonzero((np.diff(tick) == 0) & movable[:-1]).tolist():
        first = last
        while movable[first] and first > 0 and tick[first - 1] == tick[first] - 1:
            first -= 1
        is_free = first == 0 or tick[first - 1] < tick[first] - 1
        if movable[first] and is_free and tick[first] > lowest:
            tick[first : last + 1] -= 1
            movable[first : last + 1] = False


def _increasing(values: Any, camera: int) -> Times:
    name = f"timestamps[{camera}]"
    times = as_finite(values, (None,), name)
    if (np.diff(times) <= 0).any():
        at = int(np.argmax(np.diff(times) <= 0)) + 1
        raise InvalidInputError(
            f"{name}[{at}] is {times[at]:.6f}, not after {times[at - 1]:.6f} before it; times of "
            "frames must increase."
        )
    return times
