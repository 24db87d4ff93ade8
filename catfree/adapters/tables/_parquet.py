"""Parquet files of one table each, with checksums."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from catfree.adapters.files._documents import StrPath, require_file
from catfree.errors import FileFormatError, quoted
from catfree.types._validation import as_path
from catfree.types._writing import replacing
from catfree.types.results._arrow_table import require_pyarrow

if TYPE_CHECKING:
    import pyarrow


def write_parquet(path: StrPath, table: "pyarrow.Table", **options: Any) -> Path:
    """Write a table so that a reader never sees part of it.

    Args:
        path: the file.
        table: the table to write.
        options: options of `pyarrow.parquet.write_table`.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    import pyarrow.parquet

    with replacing(path) as stream:
        pyarrow.parquet.write_table(table, stream, write_page_checksum=True, **options)
    return as_path(path, "path")


def read_parquet(path: StrPath, meaning: str) -> "pyarrow.Table":
    """Read the table of one file.

    Args:
        path: the file.
        meaning: description of the file, for the message.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not Parquet, damaged, or has two columns of one name.
    """
    require_pyarrow()
    import pyarrow.parquet

    source = require_file(path, meaning)
    # Not read_table, which would make columns of folder names.
    with (
        reading(source),
        pyarrow.parquet.ParquetFile(source, page_checksum_verification=True) as file,
    ):
        table = file.read()
    twice = [name for name, count in Counter(table.column_names).items() if count > 1]
    if twice:
        raise FileFormatError(f"{source} has two columns {quoted(twice[0])}. Keep one of them.")
    return table


def open_dataset(source: Path | Sequence[str]) -> Any:
    """Open tables as one `pyarrow.dataset.Dataset` that verifies the checksums of what it reads.

    Args:
        source: a file, a folder, or the paths of files.

    Raises:
        MissingDependencyError: if pyarrow is not installed.
    """
    require_pyarrow()
    import pyarrow.dataset

    options = pyarrow.dataset.ParquetFragmentScanOptions(page_checksum_verification=True)
    parquet = pyarrow.dataset.ParquetFileFormat(default_fragment_scan_options=options)
    return pyarrow.dataset.dataset(source, format=parquet)


@contextmanager
def reading(path: StrPath) -> Iterator[None]:
    """Replace the many kinds of errors that pyarrow raises for damaged files by one.

    Raises:
        FileFormatError: naming the file.
    """
    try:
        yield
    except Exception as error:
        raise FileFormatError(f"{path} is not readable Parquet: {quoted(error)}.") from error


def values_of(table: "pyarrow.Table", names: Sequence[str], path: StrPath) -> dict[str, Any]:
    """Return columns as NumPy arrays.

    Raises:
        FileFormatError: if NumPy lacks the type of a column.
    """
    with reading(path):
        return {name: table[name].to_numpy() for name in names}
