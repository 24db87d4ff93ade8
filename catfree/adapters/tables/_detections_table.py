"""Detections as a Parquet table with one row per box, read in ranges of frames."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from catfree.adapters.files._camera_names import files_ending
from catfree.adapters.files._documents import StrPath, naming_file
from catfree.adapters.tables._parquet import open_dataset, reading, values_of, write_parquet
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Clock, Detections
from catfree.types._clock import clock_from_text, clock_to_text
from catfree.types._validation import (
    as_count,
    as_float,
    as_integer,
    as_path,
    require_instance,
)
from catfree.types.results._arrow_table import require_pyarrow

if TYPE_CHECKING:
    import pyarrow

_BOX = ("x1", "y1", "x2", "y2")
_REQUIRED = ("frame", "camera", *_BOX)
_ROWS_PER_GROUP = 1 << 16  # a reader of a range of frames skips the other groups
_CLOCK = b"clock"


def write_detections_parquet(path: StrPath, detections: Detections) -> Path:
    """Write detections as Parquet, sorted by frame and camera.

    Columns: `frame`, `camera`, the box `x1`, `y1`, `x2`, `y2` in pixels and, where present,
    `score`, `ankles_confirmed`, `embedding` (list of D numbers) and `keypoints` (list of 51). The
    clock is in the metadata of the schema.

    Args:
        path: the file.
        detections: the detections to write.

    Returns:
        The path.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if the folder does not exist.
    """
    require_instance(detections, Detections, "detections")
    pyarrow = require_pyarrow()
    ordered = detections[np.lexsort((detections.camera, detections.frame))]
    columns: dict[str, Any] = {"frame": ordered.frame, "camera": ordered.camera}
    columns |= dict(zip(_BOX, np.ascontiguousarray(ordered.box.T), strict=True))
    for name in ("score", "ankles_confirmed"):
        if getattr(ordered, name) is not None:
            columns[name] = getattr(ordered, name)
    for name in ("embedding", "keypoints"):
        values = getattr(ordered, name)
        if values is not None:
            width = max(math.prod(values.shape[1:]), 1)  # lists of no numbers have no rows
            columns[name] = pyarrow.FixedSizeListArray.from_arrays(values.ravel(), width)
    table = pyarrow.table(columns, metadata={_CLOCK: clock_to_text(ordered.clock)})
    return write_parquet(path, table, row_group_size=_ROWS_PER_GROUP, compression="zstd")


def read_detections_parquet(
    path: StrPath, first: int | None = None, stop: int | None = None
) -> Detections:
    """Read detections from a Parquet file, or from a folder of such files.

    Args:
        path: the file or folder, as `write_detections_parquet` writes them.
        first: leave out boxes of earlier frames; None for none.
        stop: leave out boxes of this frame and later ones; None for none.

    Returns:
        The detections; only the wanted rows are in memory.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if there is no such file, or a row is invalid.
        FileFormatError: if a file is not Parquet or a column is missing or malformed.
    """
    opened = open_detections_table(path)
    import pyarrow.dataset

    frame, rows = pyarrow.dataset.field("frame"), pyarrow.dataset.scalar(True)
    if first is not None:
        rows &= frame >= as_count(first, "first")
    if stop is not None:
        rows &= frame < as_count(stop, "stop")
    with reading(path):
        table = opened.to_table(filter=rows)
    column = values_of(table, _REQUIRED, path)
    options = optional_columns(table, path)
    if "score" in table.column_names:
        options |= values_of(table, ["score"], path)
    with naming_file(path):
        box = np.stack([as_float(column[name]) for name in _BOX], axis=-1)
        return Detections(column["frame"], column["camera"], box, **options)


def is_of_catfree(table: "pyarrow.Table") -> bool:
    """Return whether `write_detections_parquet` wrote a table."""
    return _CLOCK in (table.schema.metadata or {})


def optional_columns(table: "pyarrow.Table", path: StrPath) -> dict[str, Any]:
    """Return confirmed ankles, embeddings (N, D), keypoints (N, 17, 3) and clock, if present.

    Raises:
        FileFormatError: if the lists of a column have a wrong or varying length.
        InvalidInputError: if the clock is damaged.
    """
    columns: dict[str, Any] = {"clock": clock_of(table, path)}
    if "ankles_confirmed" in table.column_names:
        columns |= values_of(table, ["ankles_confirmed"], path)
    with reading(path):
        for name in ("embedding", "keypoints"):
            if name in table.column_names:
                columns[name] = _numbers_of_lists(table[name].combine_chunks())
        if "keypoints" in columns:
            columns["keypoints"] = columns["keypoints"].reshape(-1, 17, 3)
    return columns


def _numbers_of_lists(values: Any) -> np.ndarray:
    """Numbers (N, D) of a column of lists of one length, which its type may leave open."""
    import pyarrow.compute

    length = pyarrow.compute.call_function("list_value_length", [values])
    lengths = length.unique().to_pylist()
    if len(lengths) > 1 or None in lengths:
        raise ValueError("the lists of a column have different lengths, or some are missing")
    width = lengths[0] if lengths else getattr(values.type, "list_size", 0)
    return values.flatten().to_numpy(zero_copy_only=False).reshape(len(values), width)


def open_detections_table(path: StrPath) -> Any:
    """Open a Parquet file or folder as a `pyarrow.dataset.Dataset`, without reading rows.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if there is no such file or folder, or other files are beside tables.
        FileFormatError: if it is not a table of detections.
    """
    require_pyarrow()
    source = as_path(path, "path")
    if not source.exists():
        raise InvalidInputError(f"There is no table of detections {source}. Check the path.")
    if source.is_dir() and files_ending(source, [".parquet"]):
        # Arrow skips names that begin like these.
        files = (p for p in source.iterdir() if p.is_file() and not p.name.startswith((".", "_")))
        other = min((p for p in files if p.suffix.lower() != ".parquet"), default=None)
        if other is not None:
            raise InvalidInputError(
                f"The folder {source} holds Parquet tables and other files, such as {other.name}. "
                "Name the file with the boxes, or a folder of the tables alone."
            )
    if source.suffix.lower() in (".csv", ".json", ".txt"):
        raise FileFormatError(
            f"{source} is not Parquet. Read it with `cf.read_detections`, and pass the detections "
            "or write them with `write_detections_parquet`."
        )
    with reading(source):
        opened = open_dataset(source)
        names = opened.schema.names
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        raise FileFormatError(
            f"{source} has no column {missing[0]!r}; a table of detections has the columns "
            f"{', '.join(_REQUIRED)}."
        )
    return opened


def frame_range(path: StrPath) -> tuple[int, int]:
    """Return the first frame of a table of detections and the one after the last.

    Raises:
        InvalidInputError: as `open_detections_table`, or if the table has no rows.
        FileFormatError: as `open_detections_table`.
    """
    opened = open_detections_table(path)
    low, high = [], []
    with reading(path):
        for batch in opened.to_batches(columns=["frame"], batch_size=1 << 20):
            if len(batch):
                frame = batch.column(0).to_numpy()
                low.append(frame.min())
                high.append(frame.max())
    if not low:
        raise InvalidInputError(f"{path} holds no boxes, so there is nothing to cut into shards.")
    with naming_file(path):
        first, last = as_integer([min(low), max(high)], "frame")
    return int(first), int(last) + 1


def clock_of(table: Any, path: StrPath) -> Clock | None:
    """Return the clock of an open table of detections, or None.

    Args:
        table: the result of `open_detections_table`, or rows of it.
        path: path of the table, for the message.

    Raises:
        InvalidInputError: if its metadata are damaged.
    """
    text = (table.schema.metadata or {}).get(_CLOCK)
    with naming_file(path):
        return None if text is None else clock_from_text(text)
