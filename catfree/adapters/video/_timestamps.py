"""Times of a camera's frames: from the packets of its video file, or from a table beside it."""

import math
import os
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import require_file
from catfree.adapters.video._common_clock import Times
from catfree.errors import FileFormatError, quoted

_COLUMNS = ("frame_id", "timestamp_s")
_MEANING = "times of frames"
_LONGEST_LINE = 200  # characters
_LATEST = 1e11  # seconds, year 5138: larger numbers are not seconds


def sidecar_of(path: Path) -> Path | None:
    """Return the table of times that belongs to a video file or image folder, if there is one.

    Args:
        path: `NAME.mp4` has `NAME.timestamps.csv` beside it, a folder has `timestamps.csv` in it.
    """
    table = path / "timestamps.csv" if path.is_dir() else path.with_suffix(".timestamps.csv")
    return table if os.path.isfile(table) else None  # its name may be too long


def read_timestamps(path: Path, frame_count: int) -> Times:
    """Read `frame_id,timestamp_s`: one line per frame, in order, counted from 0.

    Args:
        path: the table.
        frame_count: frames of the camera; each needs a line.

    Returns:
        (T,) increasing seconds.

    Raises:
        FileFormatError: naming the first line that is malformed, out of order or not later than
            the one before, or if the numbers of lines and frames differ.
    """
    times = array("d")
    with require_file(path, _MEANING).open(encoding="utf-8-sig", newline=None) as stream:
        try:
            header = stream.readline(_LONGEST_LINE)
            if tuple(word.strip() for word in header.split(",")) != _COLUMNS:
                raise FileFormatError(
                    f"{path}: line 1 is {quoted(header.strip())}, not the header "
                    f"{','.join(_COLUMNS)}."
                )
            ended = False  # by an empty line; only empty lines may follow
            while line := stream.readline(_LONGEST_LINE):
                if not line.strip():
                    ended = True
                elif ended:
                    raise FileFormatError(f"{path}: line {len(times) + 2} is empty.")
                else:
                    times.append(_parsed(line, path, times))
        except (OSError, UnicodeDecodeError) as error:
            raise FileFormatError(
                f"{path} ({_MEANING}) is not readable text: {quoted(error)}."
            ) from error
    if len(times) != frame_count:
        raise FileFormatError(
            f"{path} ends with line {len(times) + 1}, for {len(times)} frames, but the footage has "
            f"{frame_count}. Give every frame one line."
        )
    return np.array(times, np.float64)


def _parsed(line: str, path: Path, times: array) -> float:
    """Return the time of the next frame."""
    number = len(times) + 2
    try:
        frame, time = line.split(",")
        index, seconds = int(frame), float(time)
    except ValueError:
        raise FileFormatError(
            f"{path}: line {number} is {quoted(line.strip())}, not the number of a frame and its "
            "time in seconds."
        ) from None
    if index != len(times):
        raise FileFormatError(
            f"{path}: line {number} has frame_id {quoted(index)}, but frame {len(times)} is next; "
            "frames count from 0, without gaps."
        )
    if not math.isfinite(seconds) or abs(seconds) > _LATEST:
        raise FileFormatError(
            f"{path}: line {number} has timestamp_s {seconds:g}, which is not a time in seconds."
        )
    if times and seconds <= times[-1]:
        raise FileFormatError(
            f"{path}: line {number} has timestamp_s {seconds:.6f}, not after {times[-1]:.6f} "
            "before it; times must increase."
        )
    return seconds


def open_capture(path: Path, *options: int) -> Any:
    """Return OpenCV's capture of a video; FFmpeg takes text before a colon for a protocol."""
    import cv2

    return cv2.VideoCapture(str(path.absolute()), *options)


def packet_times(path: Path) -> Float[np.ndarray, " t"] | None:
    """Return the presentation times of a video's packets, in order, without decoding them.

    OpenCV delivers raw packets (`CAP_PROP_FORMAT` -1): `grab` only reads the container, and
    `CAP_PROP_POS_MSEC` is the packet's time after the start of the stream. Packets come in the
    order of decoding, hence the sorting.

    Args:
        path: the video file.

    Returns:
        (T,) increasing seconds from the first packet on, or None if the file or this build of
        OpenCV has no usable times.
    """
    import cv2

    capture = open_capture(path, cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened() or not capture.set(cv2.CAP_PROP_FORMAT, -1):
            return None
        milliseconds, grab, get = array("d"), capture.grab, capture.get
        position = cv2.CAP_PROP_POS_MSEC
        while grab():
            milliseconds.append(get(position))
    except cv2.error:
        return None
    finally:
        capture.release()
    times = np.array(milliseconds, np.float64)
    times.sort()
    times /= 1000
    usable = len(times) and np.isfinite(times).all() and abs(times[0]) < _LATEST
    return times if usable and (np.diff(times) > 0).all() else None
