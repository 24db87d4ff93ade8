"""Saving and loading of arrays in one `.npz` file: atomic, bit for bit, without pickle."""

import functools
import inspect
import math
import os
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types._validation import as_path
from catfree.types._writing import replacing

_KIND = "catfree_kind"

# An archive may unpack to this many times its own size, or to this many bytes if that is more.
# Otherwise a few megabytes of zeros could fill the memory.
_LARGEST_RATIO = 100
_ALWAYS_ALLOWED = 2**28

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def save_arrays(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, object]) -> Path:
    """Write named arrays to `path` so that a reader never sees a half-written file.

    Args:
        path: target file; written exactly there (no suffix is added). Its folder must exist.
        kind: the name of the type that is stored; `load_arrays` checks it.
        arrays: name to array; entries that are None are left out.

    Returns:
        The path that was written.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is a folder.
        WriteError: if the disk is full or not writable; no partial file is left behind.
    """
    present = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    present[_KIND] = np.array(kind)
    with replacing(path) as stream:
        np.savez_compressed(stream, allow_pickle=False, **present)
        # Arrays that compress so well that loading would refuse them are stored uncompressed.
        if sum(array.nbytes for array in present.values()) > _largest_content(stream.tell()) // 2:
            stream.seek(0)
            stream.truncate()
            np.savez(stream, allow_pickle=False, **present)
    return as_path(path, "path")


def load_arrays(
    path: str | os.PathLike[str],
    kind: str,
    *,
    required: Collection[str] | None = (),
    optional: Collection[str] = (),
) -> dict[str, np.ndarray]:
    """Read what `save_arrays` wrote.

    Args:
        path: the file to read.
        kind: the type name that the file must hold.
        required: names that the file must hold; None for any names.
        optional: further names that it may hold.

    Returns:
        Name to array, without the entries that were None.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if the file is not an archive of that kind with those names.
    """
    source = as_path(path, "path")
    if not os.path.isfile(source):
        raise InvalidInputError(f"Cannot load {kind}: there is no file {source}.")
    arrays = read_archive(source)
    stored = str(arrays.pop(_KIND, "arrays that catfree did not save"))
    if stored != kind:
        raise FileFormatError(
            f"{source} holds {shortened(stored)}, not {kind}. Load it with the class that saved it."
        )
    if required is None:
        return arrays
    missing = [name for name in required if name not in arrays]
    unknown = [name for name in arrays if name not in (*required, *optional)]
    if missing or unknown:
        entry = shortened((missing or unknown)[0])
        what = f"lacks {entry}" if missing else f"holds the unknown entry {entry}"
        raise FileFormatError(
            f"{source} {what}, so another version wrote this {kind}. Save it again with .save()."
        )
    return arrays


def load_record(path: str | os.PathLike[str], kind: type[Any]) -> dict[str, np.ndarray]:
    """Read the arguments of a record's constructor; optional ones may be missing.

    Args:
        path: the file to read.
        kind: the type that the file must hold.

    Raises:
        InvalidInputError: as `load_arrays`.
        FileFormatError: as `load_arrays`.
    """
    required, optional = arguments_of(kind)
    return load_arrays(path, kind.__name__, required=required, optional=optional)


@functools.cache
def arguments_of(kind: type[Any]) -> tuple[list[str], list[str]]:
    """List the required and the optional constructor arguments; old files may lack the latter."""
    parameters = list(inspect.signature(kind.__init__).parameters.values())[1:]  # without self
    required = [p.name for p in parameters if p.default is p.empty]
    return required, [p.name for p in parameters if p.name not in required]


def read_archive(
    path: str | os.PathLike[str], names: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """Read arrays of any `.npz` file without pickle, checking sizes before allocating memory.

    Args:
        path: the file, which must exist.
        names: arrays to read, if the file has them; None for all.

    Returns:
        Name to array.

    Raises:
        FileFormatError: if it is not an archive of arrays, is damaged, or unpacks to many times its
            size.
    """
    try:
        size = os.path.getsize(path)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            content = sum(member.file_size for member in members)
            if content > _largest_content(size):
                raise ValueError(
                    f"it would unpack to {content} bytes, more than {_LARGEST_RATIO} times its size"
                )
            chosen = {member.filename.removesuffix(".npy"): member for member in members}
            return {
                name: _read_member(archive, member)
                for name, member in chosen.items()
                if names is None or name in names
            }
    # On damaged files the standard library and NumPy raise anything: MemoryError, RecursionError...
    except Exception as error:
        raise FileFormatError(
            f"{path} is not a readable .npz file ({quoted(error)}). Is it complete, and did "
            "catfree or NumPy write it?"
        ) from error


@contextmanager
def naming_file(source: str | os.PathLike[str]) -> Iterator[None]:
    """Prefix errors raised in the block with the file's name."""
    try:
        yield
    except (FileFormatError, InvalidInputError) as error:
        raise type(error)(f"{source}: {error}") from error


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """Read one array, whose header must announce exactly the size that the archive holds."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("it is compressed in a way that NumPy never uses")
    with archive.open(member) as stream:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream)
        if dtype.hasobject:
            raise ValueError("it holds Python objects")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size != member.file_size - stream.tell():
            raise ValueError(f"an array of shape {shape} does not fit into it")
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _largest_content(size: int) -> int:
    """Return the bytes that an archive of `size` bytes may unpack to."""
    return max(_ALWAYS_ALLOWED, _LARGEST_RATIO * size)
