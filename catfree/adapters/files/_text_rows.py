"""Text files with one row per line: CSV with a header, and plain numbers."""

import contextlib
import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import (
    StrPath,
    naming_file,
    parse_numbers,
    read_text,
    write_text_atomically,
)
from catfree.errors import FileFormatError, InvalidInputError, quoted

_SEPARATOR = re.compile(r"\s*,\s*|\s+")
_ROW = re.compile(r"(\w+)\[(\d+)[^]]*\]")
_TOO_LARGE = 2.0**53  # from here on, not every whole number is a float


class CsvTable(NamedTuple):
    """The words of a CSV file, without blank rows and surrounding spaces.

    Attributes:
        source: the file.
        header: the first row; empty if there are no rows.
        rows: the other rows.
        lines: line number of each of these rows.
    """

    source: Path | str
    header: list[str]
    rows: list[list[str]]
    lines: list[int]

    def columns(self, once: Collection[str] = ()) -> dict[str, tuple[str, ...]]:
        """Return the words of each column by its name in the header.

        Args:
            once: names of columns that may not occur twice; of other repeated columns, the last is
                taken.

        Raises:
            FileFormatError: naming such a repeated column, or the first line with too few or too
                many columns.
        """
        twice = [name for name in once if self.header.count(name) > 1]
        if twice:
            raise FileFormatError(
                f"{self.source} has two columns {quoted(twice[0])}. Keep one of them."
            )
        for line, row in zip(self.lines, self.rows, strict=True):
            if len(row) != len(self.header):
                raise FileFormatError(
                    f"{self.source}: line {line} has {len(row)} columns instead of "
                    f"{len(self.header)}. Separate columns by commas and write decimals with a "
                    "point."
                )
        words = zip(*self.rows, strict=True) if self.rows else [()] * len(self.header)
        return dict(zip(self.header, words, strict=True))


def write_csv(path: StrPath, header: Iterable[str], rows: Iterable[Iterable[object]]) -> Path:
    """Write a CSV file that `read_csv` reads, and return its path."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return write_text_atomically(path, text.getvalue())


def read_csv(path: StrPath, meaning: str) -> CsvTable:
    """Read a CSV file, whose columns may also be separated by semicolons or tabs.

    Args:
        path: the file.
        meaning: description for messages.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: naming the first line that is not CSV.
    """
    text = read_text(path, meaning)
    header = text.lstrip().partition("\n")[0]
    reader = csv.reader(io.StringIO(text), delimiter=max(",;\t", key=header.count))
    rows, lines = [], []
    try:
        for row in reader:
            words = [word.strip() for word in row]
            if any(words):
                rows.append(words)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise FileFormatError(
            f"{path}: line {reader.line_num} is not valid CSV: {quoted(error)}."
        ) from error
    return CsvTable(str(path), rows[0] if rows else [], rows[1:], lines[1:])


@contextlib.contextmanager
def naming_line(source: StrPath, lines: Sequence[int] | None) -> Iterator[None]:
    """Combine `naming_file` and `naming_row`.

    Args:
        source: the file.
        lines: (N,) line number of each row; None for a file without lines.
    """
    place = None if lines is None else (lambda row: f"in line {lines[row]}")
    with naming_file(source), naming_row(place):
        yield


@contextlib.contextmanager
def naming_row(place: Callable[[int], str] | None) -> Iterator[None]:
    """Name the place of a row, if it is known, in errors that begin with `column[row]`."""
    try:
        yield
    except (FileFormatError, InvalidInputError) as error:
        entry = _ROW.match(str(error))
        if entry is None or place is None:
            raise
        rest = str(error)[entry.end() :]
        raise type(error)(f"{entry[1]} {place(int(entry[2]))}{rest}") from error


def read_rows(
    path: StrPath, meaning: str, columns: Sequence[int], *, more: bool = False, whole: int = 0
) -> tuple[Float[np.ndarray, "row column"], list[int]]:
    """Read lines of equally many numbers, separated by commas or spaces; skip blank lines.

    Args:
        path: the file.
        meaning: description for messages.
        columns: allowed numbers of columns.
        more: whether more columns are allowed.
        whole: number of leading columns that hold whole numbers.

    Returns:
        The numbers, and the line number of each row.

    Raises:
        InvalidInputError: if there is no such file, or naming the first line with a number that is
            not finite.
        FileFormatError: naming the first line that has another number of columns, or a value that
            is not a number or not a whole one below 2^53.
    """
    rows, lines = [], []
    for line, text in enumerate(read_text(path, meaning).splitlines(), start=1):
        if not text.strip():
            continue
        words = _SEPARATOR.split(text.strip().rstrip(","))
        fits = len(words) in columns or (more and len(words) > max(columns))
        if not fits or (rows and len(words) != len(rows[0])):
            wanted = str(len(rows[0])) if rows else " or ".join(map(str, columns))
            raise FileFormatError(
                f"{path} ({meaning}): line {line} has {len(words)} columns instead of {wanted}. "
                "Separate columns by commas or spaces."
            )
        rows.append(parse_numbers(words, f"{path}: line {line}"))
        lines.append(line)
    table = np.array(rows, np.float64).reshape(len(rows), -1 if rows else columns[0])
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        raise InvalidInputError(
            f"{path}: line {lines[int(np.argmax(bad))]} has a number that is not finite."
        )
    first = table[:, :whole]
    bad = (first != np.round(first)) | (np.abs(first) >= _TOO_LARGE)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise FileFormatError(
            f"{path} ({meaning}): column {column + 1} of line {lines[row]} is "
            f"{first[row, column]:g}, not a whole number below 2^53."
        )
    return table, lines
