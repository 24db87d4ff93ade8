"""Writing files: complete under their name, or not there at all, and one sentence if it fails."""

import contextlib
import errno
import os
import re
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from catfree.errors import InvalidInputError, WriteError

# A name of its own instead of one that begins like the target's: no longer than the target's may
# be, and nobody else's. It keeps the suffix, by which some writers choose the format.
_PREFIX, _LONGEST_SUFFIX = ".catfree-", 8
_TEMPORARY = re.compile(r"\.catfree-[0-9a-f]{32}(\.[^./\\]{0,7})?")

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


def is_temporary(name: str) -> bool:
    """Whether `replacement` gives such names, so that a file of it is left over from a kill."""
    return _TEMPORARY.fullmatch(name) is not None


@contextlib.contextmanager
def replacement(path: str | os.PathLike[str], *, suffix: str | None = None) -> Iterator[Path]:
    """An empty file that takes the place of `path` once the block ends without an error.

    It lies in the same folder, under a random name that nobody can put a link at beforehand.

    Args:
        path: the file to make or to replace.
        suffix: of the name until then, for writers that choose the format by it; None for that of
            `path`.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is one itself.
        WriteError: if the disk is full or not writable; no partial file is left behind.
    """
    target = Path(path)
    try:
        if not target.parent.is_dir():
            raise InvalidInputError(
                f"Cannot write {target}: the folder {target.parent} does not exist. Create it "
                "first."
            )
        if target.is_dir():
            raise InvalidInputError(f"Cannot write {target}: it is a folder. Name a file in it.")
        ending = target.suffix if suffix is None else suffix
        name = f"{_PREFIX}{uuid.uuid4().hex}{ending[:_LONGEST_SUFFIX]}"
        temporary = target.with_name(name)
        try:
            # Not a file of `tempfile`, which only its owner may read.
            temporary.open("xb").close()
            yield temporary
            os.replace(temporary, target)
        except BaseException:
            # The file may never have been made, or the folder be gone.
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(target, error) from error


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A stream whose content takes the place of a file once all of it is written.

    Raises:
        InvalidInputError: as `replacement`.
        WriteError: as `replacement`.
    """
    with replacement(path) as temporary, temporary.open("wb") as stream:
        yield stream


def make_folder(path: str | os.PathLike[str], *, parents: bool = True) -> Path:
    """The folder, made if it does not exist.

    Raises:
        WriteError: if it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=parents, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error, "make the folder") from error
    return folder


def cannot_write(path: str | os.PathLike[str], error: OSError, task: str = "write") -> WriteError:
    """The error of a file or folder that could not be written, with advice that fits the reason."""
    if isinstance(error, WriteError):
        return error
    advice = "Free some space, or name" if error.errno in _NO_SPACE else "Name"
    made = WriteError(f"Cannot {task} {path}: {error.strerror or error}. {advice} another place.")
    made.errno = error.errno
    return made
