"""Tracks as a table with one row per position: CSV, or Parquet with the `parquet` extra."""

import csv
import io
from pathlib import Path

import numpy as np

from catfree.adapters.files._documents import (
    StrPath,
    naming_file,
    read_text,
    write_bytes_atomically,
)
from catfree.errors import FileFormatError, MissingDependencyError, quoted
from catfree.types import Origin, Tracks
from catfree.types.results import require_sound_tracks

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


def write_tracks_csv(path: StrPath, tracks: Tracks) -> Path:
    """Write tracks as CSV with a header, numbers in full precision.

    Columns: `frame`, `track_id`, ground coordinates `x`, `y` and position in scene units, `sigma`,
    the covariance of x and y, `supporting_cameras`, `origin` (detected, extended, ...), the
    velocity of x and y in scene units per frame number with its covariance and, where the method
    gives it, `existence`.

    Args:
        path: the file.
        tracks: what to write.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist.
    """
    columns = _columns(tracks)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    return write_bytes_atomically(path, text.getvalue().encode())


def read_tracks_csv(path: StrPath) -> Tracks:
    """Read what `write_tracks_csv` wrote.

    Args:
        path: the file.

    Returns:
        The tracks, number for number, without `support`, which is not in the table. Tables of
        version 0.1 give no velocities (NaN).

    Raises:
        InvalidInputError: if the file does not exist, a number in it is not finite, or a sigma is
            negative.
        FileFormatError: naming the first malformed column or line.
    """
    source = Path(path)
    try:
        lines = list(csv.reader(io.StringIO(read_text(source, "tracks"))))
    except csv.Error as error:
        raise FileFormatError(f"{source} is not valid CSV: {quoted(error)}.") from error
    header, rows = (lines[0], lines[1:]) if lines else ([], [])
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise FileFormatError(f"{source} has no column {missing[0]!r}; is it a table of tracks?")
    for line, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise FileFormatError(
                f"{source}: line {line} has {len(row)} columns instead of {len(header)}."
            )
    text = dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else {}
    column = {}
    for name in header:
        values = text.get(name, ())
        try:
            if name == "origin":
                column[name] = np.array([Origin[value.upper()] for value in values], np.int64)
            else:
                column[name] = np.array(values, np.int64 if name in _WHOLE else np.float64)
        except (ValueError, KeyError, OverflowError) as error:
            raise FileFormatError(
                f"{source}: column {quoted(name)} is invalid: {quoted(error)}."
            ) from error
    velocity = velocity_covariance = None
    if all(name in column for name in _VELOCITY):
        velocity = np.stack([column["velocity_x"], column["velocity_y"]], axis=-1)
        velocity_covariance = _symmetric(column, "velocity_covariance")
    position = [column[f"position_{axis}"] for axis in "xyz"]
    tracks = Tracks(
        frame=column["frame"],
        track_id=column["track_id"],
        position=np.stack(position, axis=-1),
        ground_xy=np.stack([column["x"], column["y"]], axis=-1),
        sigma=column["sigma"],
        covariance=_symmetric(column, "covariance"),
        supporting_cameras=column["supporting_cameras"],
        origin=column["origin"],
        existence=column.get("existence"),
        velocity=velocity,
        velocity_covariance=velocity_covariance,
    )
    naming_file(source, lambda: require_sound_tracks(tracks))
    return tracks


def write_tracks_parquet(path: StrPath, tracks: Tracks) -> Path:
    """Write tracks as Parquet with the columns of `write_tracks_csv`.

    Args:
        path: the file.
        tracks: what to write.

    Returns:
        The path.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if the folder does not exist.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingDependencyError(
            "Writing Parquet needs pyarrow: pip install 'catfree[parquet]'."
        ) from error
    sink = pyarrow.BufferOutputStream()
    # Explicit, because types cannot be inferred from columns without rows.
    kinds = {name: pyarrow.int64() for name in _WHOLE} | {"origin": pyarrow.string()}
    columns = _columns(tracks)
    schema = pyarrow.schema([(name, kinds.get(name, pyarrow.float64())) for name in columns])
    rows = {name: column.tolist() for name, column in columns.items()}
    table = pyarrow.table(rows, schema=schema)
    pyarrow.parquet.write_table(table, sink)
    return write_bytes_atomically(path, sink.getvalue().to_pybytes())


def _symmetric(column: dict[str, np.ndarray], name: str) -> np.ndarray:
    """(M, 2, 2) from the columns of its three different entries."""
    xx, xy, yy = (column[f"{name}_{axes}"] for axes in ("xx", "xy", "yy"))
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)


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
    if tracks.existence is not None:
        columns["existence"] = tracks.existence
    return columns
