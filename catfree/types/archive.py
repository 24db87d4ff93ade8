"""Arrays to and from one `.npz` file: no pickle, atomic, bit for bit."""

import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError

_KIND = "catfree_kind"


def save_arrays(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, object]) -> Path:
    """Write named arrays to `path` so that a reader never sees a half-written file.

    Args:
        path: target file; written exactly there (no suffix is added). Its folder must exist.
        kind: the name of the type that is stored; `load_arrays` checks it.
        arrays: name to array; entries that are None are left out.

    Returns:
        The path that was written.

    Raises:
        InvalidInputError: if the folder does not exist.
        OSError: if the disk is full or not writable; no partial file is left behind.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise InvalidInputError(
            f"Cannot write {target}: the folder {target.parent} does not exist. Create it first."
        )
    present = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    descriptor, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(descriptor, "wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **{_KIND: np.array(kind)}, **present)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return target


def load_arrays(path: str | os.PathLike[str], kind: str) -> dict[str, np.ndarray]:
    """Read what `save_arrays` wrote.

    Args:
        path: the file to read.
        kind: the type name that the file must hold.

    Returns:
        Name to array, without the entries that were None.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if the file is not an archive of that kind.
    """
    source = Path(path)
    if not source.is_file():
        raise InvalidInputError(f"Cannot load {kind}: there is no file {source}.")
    try:
        with np.load(source, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise FileFormatError(
            f"{source} is not a readable catfree archive ({error}). Save it again with .save()."
        ) from error
    stored = str(arrays.pop(_KIND, "nothing of catfree"))
    if stored != kind:
        raise FileFormatError(
            f"{source} holds {stored}, not {kind}. Load it with the type that saved it."
        )
    return arrays
