"""Text, JSON and array files: one clear error on the way in, atomic on the way out."""

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError
from catfree.types._archive import replacing

StrPath = str | os.PathLike[str]
T = TypeVar("T")


def require_file(path: StrPath, meaning: str) -> Path:
    """The path, if there is a file.

    Args:
        path: where it should be.
        meaning: what the file is, for the message: `calibration of camera C1`.

    Raises:
        InvalidInputError: if there is none.
    """
    source = Path(path)
    if not source.is_file():
        raise InvalidInputError(f"There is no file {source} ({meaning}). Check the path.")
    return source


def require_folder(path: StrPath, meaning: str) -> Path:
    """The path, if there is a folder.

    Raises:
        InvalidInputError: if there is none.
    """
    source = Path(path)
    if not source.is_dir():
        raise InvalidInputError(f"There is no folder {source} ({meaning}). Check the path.")
    return source


def read_text(path: StrPath, meaning: str) -> str:
    """The content of a UTF-8 text file.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not text or cannot be read.
    """
    source = require_file(path, meaning)
    try:
        return source.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{source} ({meaning}) is not readable text: {error}.") from error


def read_json(path: StrPath, meaning: str) -> Any:
    """The content of a JSON file.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not JSON, with the line and column, as for a truncated file.
    """
    text = read_text(path, meaning)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(
            f"{path} ({meaning}) is not valid JSON ({error}). Is the file complete?"
        ) from error


def read_npz(path: StrPath, meaning: str, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Some arrays of an `.npz` archive, without pickle.

    Args:
        path: the archive.
        meaning: what it is, for the message.
        names: the arrays that must be there.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is no archive, is truncated, or lacks one of the arrays.
    """
    source = require_file(path, meaning)
    try:
        with source.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            stored = sorted(archive.files)
            arrays = {name: archive[name] for name in names if name in stored}
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{source} ({meaning}) is not a readable .npz: {error}.") from error
    missing = [name for name in names if name not in arrays]
    if missing:
        raise FileFormatError(
            f"{source} ({meaning}) has no array {missing[0]!r}; it holds {', '.join(stored)}."
        )
    return arrays


def entry(mapping: Any, key: str, source: StrPath, where: str) -> Any:
    """One required entry of a parsed document.

    Raises:
        FileFormatError: naming the file, the place in it and the missing key.
    """
    if not isinstance(mapping, dict):
        raise FileFormatError(f"{source}: {where} must be an object with named entries.")
    if key not in mapping:
        raise FileFormatError(f"{source}: {where} has no {key!r}.")
    return mapping[key]


def numbers(value: Any, shape: tuple[int, ...] | None, source: StrPath, where: str) -> np.ndarray:
    """A float64 array of this shape; nested lists and flat lists are both accepted.

    A shape of None stands for a list of any length.

    Raises:
        FileFormatError: naming the file and the place in it.
    """
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileFormatError(f"{source}: {where} does not hold numbers only.") from error
    if shape is None:
        return array.ravel()
    if array.size != int(np.prod(shape)):
        raise FileFormatError(
            f"{source}: {where} must hold {' x '.join(map(str, shape))} numbers, "
            f"got shape {array.shape}."
        )
    return array.reshape(shape)


def naming_file(source: StrPath, build: Callable[[], T]) -> T:
    """Call a type's constructor and put the file's name in front of its complaint."""
    try:
        return build()
    except InvalidInputError as error:
        raise InvalidInputError(f"{source}: {error}") from error


def write_bytes_atomically(path: StrPath, content: bytes) -> Path:
    """Write a file so that a reader never sees half of it.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is one itself.
        OSError: if the disk is full or not writable; no partial file is left behind.
    """
    with replacing(path) as stream:
        stream.write(content)
    return Path(path)


def write_text_atomically(path: StrPath, content: str) -> Path:
    """Write UTF-8 text so that a reader never sees half of it; see `write_bytes_atomically`.

    Raises:
        InvalidInputError: if the text holds what UTF-8 cannot, such as a name in another encoding.
    """
    try:
        encoded = content.encode("utf-8")
    except UnicodeEncodeError as error:
        part = ascii(content[max(error.start - 20, 0) : error.end + 20])
        raise InvalidInputError(
            f"Cannot write {path}: {part} is not valid UTF-8. Rename what it names."
        ) from error
    return write_bytes_atomically(path, encoded)
