"""Reading of text, JSON and array files with clear errors, and atomic writing.

Errors in the entries of a document name their place in it; readers add the file by `naming_file`.
"""

import contextlib
import json
import os
import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types._archive import naming_file as naming_file, read_archive
from catfree.types._validation import as_float, as_path, parse_json
from catfree.types._writing import replacing

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
StrPath = str | os.PathLike[str]

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
# Above it, not every whole number is a float.
_LARGEST_WHOLE = 2**53


def parse_numbers(words: Sequence[str], where: str) -> list[float]:
    """Return the numbers of a line of text.

    Raises:
        FileFormatError: naming the place.
    """
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise FileFormatError(
            f"{where} has a value that is not a number: {quoted(error)}."
        ) from error


def require_file(path: StrPath, meaning: str) -> Path:
    """Return the path if it is a file.

    Args:
        path: the expected file.
        meaning: description of the file, for the message: `calibration of camera C1`.

    Raises:
        InvalidInputError: if there is no such file.
    """
    source = as_path(path, meaning)
    if not os.path.isfile(source):
        if os.path.isdir(source):
            raise InvalidInputError(
                f"{source} is a folder, not a file ({meaning}). Name a file in it."
            )
        raise InvalidInputError(f"There is no file {source} ({meaning}). Check the path.")
    return source


def require_folder(path: StrPath, meaning: str) -> Path:
    """Return the path if it is a folder.

    Raises:
        InvalidInputError: if there is no such folder.
    """
    source = as_path(path, meaning)
    if not os.path.isdir(source):
        raise InvalidInputError(f"There is no folder {source} ({meaning}). Check the path.")
    return source


def read_text(path: StrPath, meaning: str) -> str:
    """Read a UTF-8 text file.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not text, such as arrays with a wrong suffix, or cannot be read.
    """
    source = require_file(path, meaning)
    try:
        return source.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        advice = "If it is text, save it as UTF-8."
        if zipfile.is_zipfile(source):
            advice = "If it holds arrays that `save` wrote, name it .npz."
        raise FileFormatError(
            f"{source} ({meaning}) is not readable text: {quoted(error)}. {advice}"
        ) from error


def read_json(path: StrPath, meaning: str) -> Any:
    """Read a JSON file.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not JSON, as when truncated (stating line and column), an object
            repeats a key, or a string holds a lone surrogate, which cannot be written to any file.
    """
    text = read_text(path, meaning)
    try:
        document = parse_json(text)
        if _SURROGATE.search(text):
            json.dumps(document, ensure_ascii=False).encode("utf-8")
        return document
    except (ValueError, RecursionError) as error:
        raise FileFormatError(
            f"{path} ({meaning}) is not valid JSON ({quoted(error)}). Is the file complete?"
        ) from error


@contextlib.contextmanager
def document_of(path: StrPath, schema: str, kind: str, advice: str) -> Iterator[dict[str, Any]]:
    """Read a JSON file that states its `schema`; errors in the block report it as damaged.

    Args:
        path: the file.
        schema: the expected version of its format.
        kind: description of the file, for messages.
        advice: last sentence of messages.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not JSON, is of another version, or the block finds it damaged.
    """
    document = read_json(path, kind)
    stated = document.get("schema") if isinstance(document, dict) else document
    if stated != schema:
        raise FileFormatError(
            f"{path} is a {kind} of another version: {quoted(stated)} instead of {schema!r}. "
            f"{advice}"
        )
    try:
        yield document
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else quoted(error)
        raise FileFormatError(f"{path} is damaged ({reason}). {advice}") from error


def read_npz(path: StrPath, meaning: str, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Read some arrays of an `.npz` archive, without pickle.

    Args:
        path: the archive.
        meaning: description for the message.
        names: the required arrays.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not an archive, is truncated, or lacks one of the arrays.
    """
    arrays = read_archive(require_file(path, meaning), names)
    missing = [name for name in names if name not in arrays]
    if missing:
        with zipfile.ZipFile(path) as archive:
            stored = sorted(name.removesuffix(".npy") for name in archive.namelist())
        raise FileFormatError(
            f"{path} ({meaning}) has no array {quoted(missing[0])}; it holds "
            f"{shortened(', '.join(stored))}."
        )
    return arrays


def entry(mapping: Any, key: str, where: str = "the file") -> Any:
    """Return one required entry of a parsed document.

    Raises:
        FileFormatError: naming the place and the missing key.
    """
    if not isinstance(mapping, dict):
        raise FileFormatError(f"{where} must be an object with named entries.")
    if key not in mapping:
        raise FileFormatError(f"{where} has no {quoted(key)}.")
    return mapping[key]


def text_of(value: Any, where: str) -> str:
    """Return a name that a parsed document gives as a string or a number.

    Raises:
        FileFormatError: naming the place.
    """
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise FileFormatError(f"{where} is {quoted(value)}, not a name.")
    return value if isinstance(value, str) else quoted(value)


def list_of(value: Any, where: str) -> list[Any]:
    """Return a list of a parsed document.

    Raises:
        FileFormatError: naming the place.
    """
    if not isinstance(value, list):
        raise FileFormatError(f"{where} must be a list, got {quoted(value)}.")
    return value


def is_whole(value: Any) -> bool:
    """Return whether this is a whole number that float64 holds exactly."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= _LARGEST_WHOLE and value == int(value)


def whole_number(value: Any, where: str) -> int:
    """Return a whole number of a parsed document.

    Raises:
        FileFormatError: naming the place.
    """
    if not is_whole(value):
        raise FileFormatError(f"{where} is {quoted(value)}, not a whole number of at most 2^53.")
    return int(value)


def numbers_of(
    mapping: Any,
    key: str,
    shape: tuple[int, ...] | None,
    where: str = "the file",
    *,
    finite: bool = True,
) -> np.ndarray:
    """Return the numbers of one required entry of a parsed document; see `entry` and `numbers`.

    Raises:
        FileFormatError: as `entry` and `numbers`.
        InvalidInputError: as `numbers`.
    """
    value = entry(mapping, key, where)
    return numbers(value, shape, f"{key} of {where}", finite=finite)


def numbers(
    value: Any, shape: tuple[int, ...] | None, where: str, *, finite: bool = True
) -> np.ndarray:
    """Convert to a float64 array of this shape; nested and flat lists are both accepted.

    Text and nested lists of another shape, such as a transposed matrix, are not.

    Args:
        value: the file's entry.
        shape: shape of the result; None for a list of any length.
        where: the place in the file, for messages.
        finite: whether NaN and infinity are errors; otherwise the caller checks for them.

    Raises:
        FileFormatError: naming the place.
        InvalidInputError: if a number is not finite.
    """
    try:
        array = np.asarray(as_float(value), np.float64)
    except InvalidInputError as error:
        raise FileFormatError(f"{where} must hold numbers only.") from error
    if finite and not np.isfinite(array).all():
        raise InvalidInputError(f"{where} is not finite. Correct or remove it.")
    if shape is None:
        return array.ravel()
    given, wanted = (tuple(n for n in sides if n != 1) for sides in (array.shape, shape))
    if array.size != int(np.prod(shape)) or (len(given) == len(wanted) and given != wanted):
        raise FileFormatError(
            f"{where} must hold {' x '.join(map(str, shape))} numbers, got shape {array.shape}."
        )
    return array.reshape(shape)


def write_bytes_atomically(path: StrPath, content: bytes) -> Path:
    """Write a file so that a reader never sees part of it.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is a folder.
        WriteError: if the disk is full or not writable; no partial file is left behind.
    """
    with replacing(path) as stream:
        stream.write(content)
    return as_path(path, "path")


def write_text_atomically(path: StrPath, content: str) -> Path:
    """Write UTF-8 text so that a reader never sees part of it; see `write_bytes_atomically`.

    Raises:
        InvalidInputError: if UTF-8 cannot encode the text, such as a name in another encoding.
        WriteError: if the disk is full or not writable.
    """
    try:
        encoded = content.encode("utf-8")
    except UnicodeEncodeError as error:
        part = ascii(content[max(error.start - 20, 0) : error.end + 20])
        raise InvalidInputError(
            f"Cannot write {path}: {part} is not valid UTF-8. Rename what it names."
        ) from error
    return write_bytes_atomically(path, encoded)
