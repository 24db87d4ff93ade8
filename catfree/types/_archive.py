"""Arrays to and from one `.npz` file: no pickle, atomic, bit for bit."""

import contextlib
import os
import uuid
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError

_KIND = "catfree_kind"

# What damage anywhere in a zip of arrays is known to raise in NumPy and the standard library.
_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
)


def save_arrays(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, object]) -> Path:
    """Write named arrays to `path` so that a reader never sees a half-written file.

    Args:
        path: target file; written exactly there (no suffix is added). Its folder must exist.
        kind: the name of the type that is stored; `load_arrays` checks it.
        arrays: name to array; entries that are None are left out.

    Returns:
        The path that was written.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is one itself.
        OSError: if the disk is full or not writable; no partial file is left behind.
    """
    present = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    with replacing(path) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{_KIND: np.array(kind)}, **present)
    return Path(path)


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A stream whose content takes the place of a file once all of it is written.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is one itself.
        OSError: if the disk is full or not writable; no partial file is left behind.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise InvalidInputError(
            f"Cannot write {target}: the folder {target.parent} does not exist. Create it first."
        )
    if target.is_dir():
        raise InvalidInputError(f"Cannot write {target}: it is a folder. Name a file in it.")
    # Not a file of `tempfile`, which only its owner may read.
    temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    try:
        with temporary.open("xb") as stream:
            yield stream
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


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
        required: names that the file must hold; None for whatever it holds.
        optional: names that it may hold besides.

    Returns:
        Name to array, without the entries that were None.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if the file is not an archive of that kind with those names.
    """
    source = Path(path)
    if not source.is_file():
        raise InvalidInputError(f"Cannot load {kind}: there is no file {source}.")
    if not zipfile.is_zipfile(source):
        raise FileFormatError(
            f"{source} is not a readable catfree archive: it is no .npz file, or damaged. Give a "
            f"file that {kind}.save() wrote."
        )
    try:
        # Opened here, because NumPy leaves a file that it cannot read open.
        with source.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except _DAMAGE as error:
        raise FileFormatError(
            f"{source} is not a readable catfree archive ({error}). Save it again with .save()."
        ) from error
    stored = str(arrays.pop(_KIND, "nothing of catfree"))
    if stored != kind:
        raise FileFormatError(
            f"{source} holds {stored}, not {kind}. Load it with the type that saved it."
        )
    if required is None:
        return arrays
    missing = [name for name in required if name not in arrays]
    unknown = [name for name in arrays if name not in (*required, *optional)]
    if missing or unknown:
        what = f"lacks {missing[0]}" if missing else f"holds the unknown entry {unknown[0]}"
        raise FileFormatError(
            f"{source} {what}, so another version wrote this {kind}. Save it again with .save()."
        )
    return arrays
