"""Trajectories in the format of PedPy and of Jülich's pedestrian dynamics archive."""

from pathlib import Path

import numpy as np

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.tables.tracks._tracked_rows import numbered_frames, tracked
from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.types._validation import as_positive


def write_pedpy(path: StrPath, tracks: Tracks, frame_rate: float | int | None = None) -> Path:
    """Write `id frame x y z` with the frame rate and the unit in the header.

    `pedpy.load_trajectory(trajectory_file=...)` reads it. Frame numbers that step by more than 1
    are renumbered without gaps, and the frame rate counts steps. Positions without a track are left
    out; ids count from 1, and z is 0.

    Args:
        path: the file.
        tracks: the tracks, in meters.
        frame_rate: increments of the frame number per second; None to take it from the tracks'
            clock.

    Returns:
        The path.

    Raises:
        InvalidInputError: if neither clock nor frame rate is known, a position is not finite, or
            the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    kept = tracked(tracks, path)
    if frame_rate is not None:
        rate = as_positive(frame_rate, "frame_rate")
    elif tracks.clock is not None:
        rate = tracks.clock.frame_rate
    else:
        raise InvalidInputError(
            f"Cannot write {path}: the tracks have no clock, so their frame rate is not known. "
            "Pass frame_rate=."
        )
    frame, step = numbered_frames(kept.frame)
    lines = [
        f"# framerate: {rate / step!r} fps",
        "# x/m y/m z/m in the coordinates of the ground",
        "# id\tframe\tx/m\ty/m\tz/m",
    ]
    order = np.lexsort((frame, kept.track_id))
    xy = np.asarray(kept.ground_xy, np.float64)
    lines += [
        f"{person + 1}\t{at}\t{x!r}\t{y!r}\t0.0"
        for person, at, (x, y) in zip(
            kept.track_id[order].tolist(), frame[order].tolist(), xy[order].tolist(), strict=True
        )
    ]
    return write_text_atomically(path, "\n".join([*lines, ""]))
