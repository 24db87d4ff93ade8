"""One camera's pictures in order: a video file or a folder of images."""

import contextlib
import hashlib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from catfree.adapters.files._camera_names import files_ending, require_readable_name
from catfree.adapters.files._documents import IMAGE_SUFFIXES
from catfree.adapters.files._fingerprint import hash_file
from catfree.adapters.protocols import Image
from catfree.adapters.video._common_clock import RATE_TOLERANCE, Times, nearest_frame, rate_of
from catfree.adapters.video._timestamps import (
    open_capture,
    packet_times,
    read_timestamps,
    sidecar_of,
)
from catfree.errors import FileFormatError, InvalidInputError

FARTHEST_DECODED = 1000  # frames: decoding up to there is faster than looking for a key frame
JUMP_MARGIN = 50  # frames by which seeking may come out too late

# Times of packets within this share of a frame of an even clock count as even: they add nothing to
# the frame rate.
_EVEN = 0.25

# The first bytes of file formats.
_AVI = b"RIFF"
_MATROSKA = b"\x1aE\xdf\xa3"  # WebM, too


def open_source(path: Path) -> "VideoFile | ImageFolder":
    """Open a folder of images or a video file.

    Raises:
        InvalidInputError: if there is nothing at that path, it is not UTF-8, or it is a folder
            without images.
        FileFormatError: if its first picture cannot be decoded.
    """
    require_readable_name(path)
    if path.is_dir():
        return ImageFolder(path)
    if not path.is_file():
        raise InvalidInputError(f"There is no video file or image folder {path}.")
    return VideoFile(path)


class ImageFolder:
    """Images of one folder in natural order of their names; only a table tells their times.

    Attributes:
        files: the images; the other attributes are as in `VideoFile`.
    """

    def __init__(self, path: Path) -> None:
        """List the images, decode the first and read `timestamps.csv`, if there is one."""
        self.path = path
        self.files = files_ending(path, IMAGE_SUFFIXES)
        if not self.files:
            raise InvalidInputError(
                f"The folder {path} holds no images ({', '.join(IMAGE_SUFFIXES)})."
            )
        self.frame_count = len(self.files)
        first = self.read(0)
        if first is None:
            raise FileFormatError(f"{self.describe(0)} cannot be decoded.")
        self.image_size = (first.shape[1], first.shape[0])
        table = sidecar_of(path)
        self.times = None if table is None else read_timestamps(table, self.frame_count)
        self.fps: float | None = None
        if self.times is not None and len(self.times) > 1:
            self.fps = rate_of(self.times)
        self.timeless = self.times is None

    def open(self) -> "ImageFolder":
        """Return the folder itself, as there is nothing to open."""
        return self

    def read(self, frame: int) -> Image | None:
        """Decode one image."""
        import cv2

        # Not imread: it cannot open every path that Python can, and it warns on standard error.
        try:
            content = np.fromfile(self.files[frame], np.uint8)
        except OSError:
            return None
        bgr = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
        return None if bgr is None else cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)

    def close(self) -> None:
        """Do nothing, as nothing is open."""

    def describe(self, frame: int) -> str:
        """Frame number and file."""
        return f"frame {frame} ({self.files[frame]})"

    def content_hash(self) -> str:
        """SHA-256 over the hashes of the images in order."""
        return hashlib.sha256("".join(map(hash_file, self.files)).encode()).hexdigest()


class VideoFile:
    """A video file that OpenCV decodes.

    The times of its frames come from its table (`NAME.timestamps.csv`), else from its packets, else
    they are evenly spaced.

    Attributes:
        path: the file.
        frame_count: frames that it claims to hold.
        fps: frames per second, or None if unknown.
        image_size: (width, height) in pixels.
        times: seconds of each frame, or None if frame i is at `i / fps`.
        timeless: whether that is an assumption, as no times are recorded.
    """

    def __init__(self, path: Path) -> None:
        """Read the properties of the file, its first frame and the times of all frames."""
        import cv2

        self.path = path
        self._stamped = False
        with contextlib.closing(self.open()) as reader:
            first = reader.read(0)
            if _is_art(reader.capture):
                raise FileFormatError(
                    f"{path} is a text file, not a video. Pass your own boxes to cf.localize in "
                    "Python; cf.adapters.read_mot reads MOTChallenge files."
                )
            if first is None:
                raise FileFormatError(
                    f"{path} cannot be decoded: it is not a video, truncated or in a format that "
                    "OpenCV does not support. Repair or re-encode it, for instance with ffmpeg."
                )
            shown = reader.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            rate = reader.capture.get(cv2.CAP_PROP_FPS)
            claimed = int(reader.capture.get(cv2.CAP_PROP_FRAME_COUNT))
            stamp = reader.capture.get(getattr(cv2, "CAP_PROP_PTS", -1))  # since OpenCV 4.11
        self.image_size = (first.shape[1], first.shape[0])
        self.fps: float | None = float(rate) if np.isfinite(rate) and rate > 0 else None
        self.times: Times | None = None
        packets = packet_times(path)
        self.timeless = packets is None
        if packets is not None:
            # Matroska states when a recording ends on its clock, not how long it is.
            since_zero = stamp - shown * (self.fps or 0.0) if _has_magic(path, _MATROSKA) else 0.0
            claimed = self._follow(packets, shown, claimed, max(0, round(since_zero)))
        self.frame_count = claimed if claimed > 0 else self._count()
        self._packet_times, self._packet_rate = self.times, self.fps  # by which decoders seek
        table = sidecar_of(path)
        if table is not None:
            self.times, self.timeless = read_timestamps(table, self.frame_count), False
            self.fps = rate_of(self.times) if len(self.times) > 1 else self.fps

    def _follow(self, packets: Times, shown: float, claimed: int, before: int) -> int:
        """Take rate and times from the packets, and return the number of frames.

        Args:
            packets: times of the packets.
            shown: the time of the first frame that can be decoded.
            claimed: number of frames that the container claims, which may be an estimate from its
                length, or less than 1.
            before: how many of these it claims before its first packet.
        """
        gap = float(np.diff(packets).min()) if len(packets) > 1 else 0.0
        stamped = not _has_magic(self.path, _AVI)  # counted instead, in the order of decoding
        undecodable = int(np.searchsorted(packets, shown - gap / 2)) if stamped else 0
        times = packets[undecodable:]
        if not len(times):
            return claimed
        rate = rate_of(times) if len(times) > 1 else self.fps
        if rate is None:
            return len(times)
        self._stamped, nominal = stamped, self.fps or rate
        even = None if undecodable else _even_rate(times, nominal, rate)
        if even == nominal and claimed > 0 and not before:
            lacking = claimed - len(times)
        elif claimed > len(packets):
            # A file that was cut off claims to be longer than its packets. The frames that it lacks
            # are at its end, where they cannot be decoded.
            longest = float(np.diff(times).max(initial=1 / rate)) + 1 / nominal
            end = (claimed - before) / nominal
            lacking = max(0, round((end - times[-1] - longest) * rate))
        else:
            lacking = 0
        if even is not None:
            self.fps = even
            return len(times) + lacking
        self.fps = nominal if abs(rate / nominal - 1) < RATE_TOLERANCE else rate
        self.times = np.append(times, times[-1] + np.arange(1, lacking + 1) / rate)
        return len(self.times)

    def open(self) -> "CaptureReader":
        """Open a decoder before the first frame."""
        return CaptureReader(self.path, self._frame_at if self._stamped else None)

    def _frame_at(self, time: float) -> int:
        """Return the number of the frame whose packet has this time."""
        if self._packet_times is None:
            return round(time * (self._packet_rate or 0.0))
        return int(nearest_frame(self._packet_times, np.array([time]))[0])

    def _count(self) -> int:
        """Count the frames that can be decoded, for files that do not state their number."""
        with contextlib.closing(self.open()) as reader:
            while reader.capture.grab():
                reader.position += 1
            return reader.position

    def describe(self, frame: int) -> str:
        """Frame number, claimed length and file."""
        return f"frame {frame} of {self.frame_count} ({self.path})"

    def content_hash(self) -> str:
        """SHA-256 of the file."""
        return hash_file(self.path)


class CaptureReader:
    """A decoder that reads forward, and jumps ahead only where frame times confirm the place."""

    def __init__(self, path: Path, number: Callable[[float], int] | None) -> None:
        """Open the file.

        Args:
            path: the file.
            number: gives the number of the frame at a time in seconds, to notice if the decoder
                skips damaged frames; None if the file has no times.
        """
        self.capture = open_capture(path)
        self.position, self._path = 0, path
        self._number = number
        self._held: Image | None = None

    def read(self, frame: int) -> Image | None:
        """Decode a frame after those read before, or return None if it cannot be decoded."""
        import cv2

        # A frame rate above the camera's own reads the same frame twice.
        if frame == self.position - 1:
            return self._held
        self._held = None
        if frame - self.position > FARTHEST_DECODED:
            self._jump(frame - JUMP_MARGIN)
        while self.position < frame:
            if not self.capture.grab():
                return None
            self._step()
        decoded, bgr = self.capture.read()
        if not decoded:
            return None
        self._step()
        self._held = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
        return self._held if self.position == frame + 1 else None

    def _jump(self, frame: int) -> None:
        """Move to a frame or to one before it; seeking in compressed video is not exact."""
        import cv2

        if self._number is None:
            return
        self.capture.set(cv2.CAP_PROP_POS_FRAMES, frame)
        if self.capture.grab():
            reached = self._number(self.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
            if self.position <= reached <= frame:
                self.position = reached + 1
                return
        self.capture.release()
        self.capture = open_capture(self._path)
        self.position = 0

    def _step(self) -> None:
        """Count the frame that was just read, and those that the decoder skipped before it."""
        import cv2

        if self._number is not None:
            time = self.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            self.position = max(self.position, self._number(time))
        self.position += 1

    def close(self) -> None:
        self.capture.release()


def _even_rate(times: Times, nominal: float, measured: float) -> float | None:
    """Return the rate at which times are even, or None.

    Args:
        times: times of the frames.
        nominal: the rate that the file claims; some programs count one frame too many for it.
        measured: the rate of the times, preferably rounded to a short number.
    """
    simple = float(Fraction(measured).limit_denominator(1001))
    for rate in (nominal, round(measured, 3), simple, measured):
        off = times * rate
        off -= np.arange(len(times))
        if max(off.max(), -off.min()) <= _EVEN:
            return rate
    return None


def _has_magic(path: Path, magic: bytes) -> bool:
    """Return whether a file begins with the bytes of a format."""
    with path.open("rb") as stream:
        return stream.read(len(magic)) == magic


def _is_art(capture: Any) -> bool:
    """Return whether FFmpeg decoded a text file as a picture made of letters (ANSI art)."""
    import cv2

    code = int(capture.get(cv2.CAP_PROP_FOURCC))
    return code == int.from_bytes(b"ansi", "little")
