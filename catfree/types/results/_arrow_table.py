"""The Arrow table of tracks: its columns and metadata."""

import json
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from catfree.errors import FileFormatError, InvalidInputError, needing, quoted
from catfree.types._clock import Clock, clock_from_text, clock_to_text
from catfree.types._validation import require_names

if TYPE_CHECKING:
    import pyarrow

ORIGINS = ("detected", "extended", "interpolated")
CAMERA_BITS = 64  # bits of the column `cameras`

_FLOATS = ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy", "existence", "sigma")
_COLUMNS = ("time_s", "frame", "track_id", *_FLOATS, "origin", "cameras")
_OPTIONAL = ("time_s", "vx", "vy", "existence", "cameras")  # may be null
_KIND = "catfree tracks, version 1"
_DESCRIPTIONS = {
    "frame_of_reference": "x and y are coordinates on the ground, along the basis of the scene's "
    "ground plane",
    "units": "time_s: s; x, y, sigma: scene units (meters in a metric scene); vx, vy: scene units "
    "per second; cov_xx, cov_xy, cov_yy: scene units squared; existence: probability",
    "bit_set": "cameras: bit c, of value 2^c, is set if a box of camera c supports the row",
}


def to_table(columns: Mapping[str, Any], camera_names: Sequence[str] | None) -> "pyarrow.Table":
    """Make the table of tracks; see `Tracks.to_arrow`.

    Args:
        columns: the fields of the tracks.
        camera_names: (C,) names, or None.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if there are more than 64 cameras, or the number of names differs.
    """
    arrow = require_pyarrow()
    cameras = columns["support"].shape[1] or np.asarray(camera_names, object).size
    require_names(camera_names, cameras)
    names = None if camera_names is None else [str(name) for name in camera_names]
    bits = _bits_of(columns["support"], columns["cameras"], names)
    frame, clock = columns["frame"], columns["clock"]
    xy, covariance = (np.asarray(columns[name], np.float64) for name in ("ground_xy", "covariance"))
    rate = np.nan if clock is None else clock.frame_rate
    velocity = np.asarray(columns["velocity"], np.float64) * rate
    unknown = np.full(len(frame), np.nan)
    existence = columns["existence"]
    numbers: dict[str, Any] = dict(
        zip(
            _FLOATS,
            [
                *xy.T,
                *velocity.T,
                *covariance.reshape(-1, 4)[:, [0, 1, 3]].T,
                unknown if existence is None else np.asarray(existence, np.float64),
                np.asarray(columns["sigma"], np.float64),
            ],
            strict=True,
        )
    )
    numbers["time_s"] = unknown if clock is None else clock.seconds(frame)
    arrays = {
        name: arrow.array(values, arrow.float64(), from_pandas=name in _OPTIONAL)
        for name, values in numbers.items()
    }
    arrays["frame"] = arrow.array(frame)
    arrays["track_id"] = arrow.array(columns["track_id"])
    arrays["origin"] = arrow.DictionaryArray.from_arrays(
        arrow.array(np.asarray(columns["origin"], np.int8)), arrow.array(ORIGINS)
    )
    absent = arrow.nulls(len(frame), arrow.uint64())
    arrays["cameras"] = absent if bits is None else arrow.array(bits, arrow.uint64())
    schema = arrow.schema(
        [arrow.field(name, arrays[name].type, name in _OPTIONAL) for name in _COLUMNS],
        _metadata(clock, names, existence is not None, bits is not None),
    )
    return arrow.Table.from_arrays([arrays[name] for name in _COLUMNS], schema=schema)


def from_table(table: "pyarrow.Table") -> dict[str, Any]:
    """Return the fields of the tracks in a table; see `Tracks.from_arrow`.

    Args:
        table: made by `to_table`; rows may have been selected, sorted or concatenated since.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if it is not an Arrow table.
        FileFormatError: if it lacks a column, a value or its metadata, or a column has another
            type.
    """
    arrow = require_pyarrow()
    if not isinstance(table, arrow.Table):
        raise InvalidInputError(
            f"Tracks come from a pyarrow.Table, got {type(table).__name__}. Pass a table."
        )
    missing = [name for name in _COLUMNS if name not in table.column_names]
    if missing:
        raise FileFormatError(f"The table has no column {missing[0]!r}; is it a table of tracks?")
    twice = [name for name in _COLUMNS if table.column_names.count(name) > 1]
    if twice:
        raise FileFormatError(f"The table has two columns {twice[0]!r}. Keep one of them.")
    try:
        table.validate(full=True)
    except arrow.ArrowException as error:
        raise FileFormatError(f"The table is damaged: {quoted(error)}.") from error
    clock, has_existence, has_cameras = _described(table.schema.metadata or {})
    numbers = {name: _numbers(table, name, arrow.float64()) for name in _FLOATS}
    velocity = np.stack([numbers["vx"], numbers["vy"]], axis=-1)
    bits = _numbers(table, "cameras", arrow.uint64(), known=True) if has_cameras else None
    frame = _numbers(table, "frame", arrow.int64())
    return {
        "frame": frame,
        "track_id": _numbers(table, "track_id", arrow.int64()),
        "ground_xy": np.stack([numbers["x"], numbers["y"]], axis=-1),
        "sigma": numbers["sigma"],
        "covariance": symmetric(numbers, "cov"),
        "supporting_cameras": np.zeros(len(frame), np.int64)
        if bits is None
        else np.bitwise_count(bits).astype(np.int64),
        "origin": _origins(table),
        "existence": numbers["existence"] if has_existence else None,
        "velocity": velocity if clock is None else _per_frame(velocity, clock.frame_rate),
        "cameras": bits,
        "clock": clock,
    }


def symmetric(columns: Mapping[str, np.ndarray], name: str) -> Float[np.ndarray, "m 2 2"]:
    """(M, 2, 2) matrices from the columns `NAME_xx`, `NAME_xy` and `NAME_yy`."""
    xx, xy, yy = (columns[f"{name}_{axes}"] for axes in ("xx", "xy", "yy"))
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)


def require_pyarrow() -> ModuleType:
    """Import pyarrow.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    with needing("Arrow tables and Parquet need pyarrow: pip install 'catfree[parquet]'."):
        import pyarrow
    return pyarrow


def _bits_of(support: Any, known: Any, names: list[str] | None) -> np.ndarray | None:
    """(M,) the bit sets of the cameras that support each row, or None if unknown."""
    count = support.shape[1]
    if count > CAMERA_BITS:
        name = quoted(names[CAMERA_BITS]) if names else CAMERA_BITS
        raise InvalidInputError(
            f"The column cameras has one bit for each of at most {CAMERA_BITS} cameras, but there "
            f"are {count}: camera {name} has none. Write the tracks as CSV or .npz."
        )
    if not count:
        return known
    bits = np.uint64(1) << np.arange(count, dtype=np.uint64)
    return ((support >= 0) * bits).sum(axis=1, dtype=np.uint64)


def _metadata(
    clock: Clock | None, names: list[str] | None, has_existence: bool, has_cameras: bool
) -> dict[str, str]:
    from catfree import __version__

    zero = "unknown" if clock is None else "start of recording"
    if clock is not None:
        zero = "1970-01-01T00:00:00Z" if clock.utc else zero
    return {
        "table": _KIND,
        **_DESCRIPTIONS,
        "time_zero": zero,
        "frame_zero": "unknown" if clock is None else clock.describe(),
        "clock": clock_to_text(clock),
        "camera_names": json.dumps(names),
        "has_existence": json.dumps(has_existence),
        "has_cameras": json.dumps(has_cameras),
        "catfree_version": __version__,
    }


def _described(metadata: Mapping[bytes, bytes]) -> tuple[Clock | None, bool, bool]:
    """Return the clock, and whether the table has existence probabilities and bit sets."""
    if metadata.get(b"table") != _KIND.encode():
        raise FileFormatError(
            f"The table's metadata do not say {_KIND!r}: another program made it, or dropped them. "
            "Copy them from the original with replace_schema_metadata."
        )
    try:
        clock = clock_from_text(metadata[b"clock"])
        has_existence, has_cameras = (
            bool(json.loads(metadata[name])) for name in (b"has_existence", b"has_cameras")
        )
        return clock, has_existence, has_cameras
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(
            f"The metadata of a table of tracks are damaged: {quoted(error)}."
        ) from error


def _column(table: "pyarrow.Table", name: str, kind: Any, *, known: bool = False) -> Any:
    """Return one column as an array of a type; `known` columns have no nulls."""
    arrow = require_pyarrow()
    column = table[name]
    if column.null_count and (known or name not in _OPTIONAL):
        raise FileFormatError(f"The table has no value in a row of column {name!r}.")
    try:
        cast = column.cast(kind)
    except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError) as error:
        raise FileFormatError(
            f"Column {name!r} has type {column.type}, not {kind}: {quoted(error)}."
        ) from error
    return cast.combine_chunks()


def _numbers(table: "pyarrow.Table", name: str, kind: Any, *, known: bool = False) -> np.ndarray:
    # A copy, because Arrow's arrays are read-only.
    return np.array(_column(table, name, kind, known=known).to_numpy(zero_copy_only=False))


def _origins(table: "pyarrow.Table") -> np.ndarray:
    arrow = require_pyarrow()
    names = _column(table, "origin", arrow.string()).dictionary_encode()
    known = names.dictionary.to_pylist()
    for name in known:
        if name not in ORIGINS:
            raise FileFormatError(f"Column 'origin' holds {quoted(name)}, not one of {ORIGINS}.")
    values = np.array([ORIGINS.index(name) for name in known], np.int64)
    return values[np.array(names.indices.to_numpy(zero_copy_only=False), np.int64)]


def _per_frame(velocity: np.ndarray, rate: float) -> np.ndarray:
    """Divide by the frame rate such that multiplying restores every bit."""
    slow = velocity / rate
    for toward in (-np.inf, np.inf):
        near = np.nextafter(velocity / rate, toward)
        with np.errstate(over="ignore", invalid="ignore"):  # then it is not the velocity
            slow = np.where((slow * rate != velocity) & (near * rate == velocity), near, slow)
    return slow
