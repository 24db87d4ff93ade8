"""Tracks as a table with one row per position: CSV, or Parquet with the `parquet` extra."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from catfree.adapters.files._documents import (
    StrPath,
    naming_file,
)
from catfree.adapters.files._text_rows import read_csv, write_csv
from catfree.adapters.tables._parquet import read_parquet, write_parquet
from catfree.errors import FileFormatError, quoted
from catfree.types import Clock, Origin, Plane, Tracks
from catfree.types._clock import ABSOLUTE
from catfree.types._validation import require_instance
from catfree.types.results._arrow_table import symmetric
from catfree.types.results._tracks import require_sound_tracks

_COLUMNS = (
    "frame",
    "track_id",
    "x",
    "y",
    "position_x",
    "position_y",
    "position_z",
    "sigma",
    "covariance_xx",
    "covariance_xy",
    "covariance_yy",
    "supporting_cameras",
    "origin",
)
# Tables of version 0.1 do not have these.
_VELOCITY = (
    "velocity_x",
    "velocity_y",
    "velocity_covariance_xx",
    "velocity_covariance_xy",
    "velocity_covariance_yy",
)
_WHOLE = ("frame", "track_id", "supporting_cameras")
_TIME = "time_s"  # not in tables of version 0.2

_OFF_CLOCK = 1e-6  # seconds by which a time in a table may differ from the clock


def write_tracks_csv(path: StrPath, tracks: Tracks) -> Path:
    """Write tracks as CSV with a header, numbers in full precision.

    Columns: `frame`, `track_id`, ground coordinates `x`, `y` and position in scene units, `sigma`,
    the covariance of x and y, `supporting_cameras`, `origin` (detected, extended, ...), the
    velocity of x and y in scene units per frame number with its covariance, `time_s` (empty
    without a clock) and, where the method gives it, `existence`.

    Args:
        path: the file.
        tracks: the tracks to write.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist.
    """
    require_instance(tracks, Tracks, "tracks")
    columns = _columns(tracks)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return write_csv(path, columns, rows)


def read_tracks_csv(path: StrPath) -> Tracks:
    """Read tracks that `write_tracks_csv` wrote.

    Args:
        path: the file.

    Returns:
        The tracks, with exactly the same numbers but without `support`, which is not in the table.
        The clock is the one with the shortest numbers that gives the times of at least two frames;
        times beyond 1e9 are UTC. Tables of version 0.1 give no velocities (NaN), those of version
        0.2 no clock.

    Raises:
        InvalidInputError: if the file does not exist, or a number in it is not finite or out of
            range, as a negative variance is.
        FileFormatError: naming the first malformed column or line, or if the times are not those
            of one clock.
    """
    table = read_csv(path, "tracks")
    missing = [name for name in _COLUMNS if name not in table.header]
    if missing:
        raise FileFormatError(f"{path} has no column {missing[0]!r}; is it a table of tracks?")
    column = {}
    for name, values in table.columns(once=table.header).items():
        try:
            if name == "origin":
                column[name] = np.array([Origin[value.upper()] for value in values], np.int64)
            elif name == _TIME and not any(values):
                continue
            else:
                column[name] = np.array(values, np.int64 if name in _WHOLE else np.float64)
        except (ValueError, KeyError, OverflowError) as error:
            raise FileFormatError(
                f"{path}: column {quoted(name)} is invalid: {quoted(error)}."
            ) from error
    velocity = velocity_covariance = None
    if all(name in column for name in _VELOCITY):
        velocity = np.stack([column["velocity_x"], column["velocity_y"]], axis=-1)
        velocity_covariance = symmetric(column, "velocity_covariance")
    position = [column[f"position_{axis}"] for axis in "xyz"]
    tracks = Tracks(
        frame=column["frame"],
        track_id=column["track_id"],
        position=np.stack(position, axis=-1),
        ground_xy=np.stack([column["x"], column["y"]], axis=-1),
        sigma=column["sigma"],
        covariance=symmetric(column, "covariance"),
        supporting_cameras=column["supporting_cameras"],
        origin=column["origin"],
        existence=column.get("existence"),
        velocity=velocity,
        velocity_covariance=velocity_covariance,
        clock=_clock_of(path, column["frame"], column.get(_TIME)),
    )
    with naming_file(path):
        require_sound_tracks(tracks)
    return tracks


def write_tracks_parquet(
    path: StrPath, tracks: Tracks, camera_names: Sequence[str] | None = None
) -> Path:
    """Write the table of `Tracks.to_arrow` as Parquet, as described in `docs/table.md`.

    Args:
        path: the file.
        tracks: the tracks to write.
        camera_names: (C,) names for the metadata, or None.

    Returns:
        The path.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if the folder does not exist, or there are more than 64 cameras.
        WriteError: if the disk is full or not writable.
    """
    require_instance(tracks, Tracks, "tracks")
    return write_parquet(path, tracks.to_arrow(camera_names))


def read_tracks_parquet(path: StrPath, ground: Plane | None = None) -> Tracks:
    """Read tracks that `write_tracks_parquet` wrote.

    Args:
        path: the file.
        ground: the scene's ground plane, to compute `position`; if None, `position` is NaN.

    Returns:
        The tracks, with exactly the same numbers (velocities to within rounding), without what the
        table does not store; see `Tracks.from_arrow`.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if the file does not exist, or a value in it is out of range.
        FileFormatError: if it is not a Parquet file of this table; files of version 0.2 and earlier
            are not, `tracks.csv` beside them can be read.
    """
    table = read_parquet(path, "tracks")
    with naming_file(path):
        return Tracks.from_arrow(table, ground)


def _clock_of(path: StrPath, frame: np.ndarray, time: np.ndarray | None) -> Clock | None:
    """Return the clock that fits the frames' times, or None if fewer than two frames have any."""
    if time is None or len(np.unique(frame)) < 2:
        return None
    first, last = int(frame.argmin()), int(frame.argmax())
    with np.errstate(all="ignore"):
        mean_rate = (frame[last] - frame[first]) / (time[last] - time[first])
    if np.isfinite(time).all() and 0 < mean_rate < np.inf:
        utc = bool(time[first] > ABSOLUTE)
        # Prefer the short numbers that people choose to those that rounding leaves.
        short = [round(mean_rate, digits) for digits in range(4)]
        for rate in (*short, float(Fraction(mean_rate).limit_denominator(1001)), float(mean_rate)):
            begin = float(time[first] - frame[first] / rate) if rate > 0 else np.inf
            for start in (round(begin, 3), round(begin, 6), begin):
                if rate > 0 and (Clock(rate, start).seconds(frame) == time).all():
                    return Clock(rate, start, utc)
        start = float(time[first] - frame[first] / mean_rate)
        if (np.abs(Clock(mean_rate, start).seconds(frame) - time) <= _OFF_CLOCK).all():
            return Clock(mean_rate, start, utc)
    raise FileFormatError(f"{path}: column {_TIME!r} is invalid: no clock gives these times.")


def _columns(tracks: Tracks) -> dict[str, np.ndarray]:
    values = [
        tracks.frame,
        tracks.track_id,
        *np.asarray(tracks.ground_xy).T,
        *np.asarray(tracks.position).T,
        tracks.sigma,
        *np.asarray(tracks.covariance).reshape(-1, 4)[:, [0, 1, 3]].T,
        tracks.supporting_cameras,
        np.array([Origin(int(value)).name.lower() for value in tracks.origin]),
        *np.asarray(tracks.velocity).T,
        *np.asarray(tracks.velocity_covariance).reshape(-1, 4)[:, [0, 1, 3]].T,
    ]
    columns: dict[str, np.ndarray] = dict(zip(_COLUMNS + _VELOCITY, values, strict=True))
    time = tracks.time
    columns[_TIME] = np.full(len(tracks), "") if time is None else time
    if tracks.existence is not None:
        columns["existence"] = tracks.existence
    return columns
