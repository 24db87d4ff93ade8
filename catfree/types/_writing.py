"""Atomic writing of files, with one clear error on failure."""

import contextlib
import errno
import os
import re
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from catfree.errors import CatFreeError, InvalidInputError, WriteError
from catfree.types._validation import as_path

# Temporary names are random and do not extend the target's, so they are neither too long nor taken.
# They keep the suffix, by which some writers choose the format.
_PREFIX, _LONGEST_SUFFIX = ".catfree-", 8
_TEMPORARY = re.compile(r"\.catfree-[0-9a-f]{32}(\.[^./\\]{0,7})?")
# A live writer touches its temporary file every few seconds; one untouched for an hour is a
# leftover of a killed process.
ABANDONED_AFTER = 3600.0

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


def is_temporary(name: str) -> bool:
    """Return whether `replacement` made this name, as left over by a killed process."""
    return _TEMPORARY.fullmatch(name) is not None


def remove_abandoned(folder: str | os.PathLike[str]) -> None:
    """Remove temporary files of killed processes from a folder, but not from its subfolders.

    Args:
        folder: need not exist.
    """
    oldest = time.time() - ABANDONED_AFTER
    with contextlib.suppress(OSError), os.scandir(folder) as files:
        for file in files:
            with contextlib.suppress(OSError):  # another process removed it first
                if is_temporary(file.name) and file.stat().st_mtime < oldest:
                    os.unlink(file)


@contextlib.contextmanager
def replacement(path: str | os.PathLike[str], *, suffix: str | None = None) -> Iterator[Path]:
    """Yield an empty file that replaces `path` when the block ends without an error.

    If `path` is a link, its target is replaced, and the link stays.

    The empty file is in the same folder, under a random name, so that nobody can plant a link
    there. Its path is absolute, because FFmpeg takes the text before a colon for a protocol.

    Args:
        path: the file to make or to replace.
        suffix: suffix of the temporary name, for writers that choose the format by it; None for
            that of `path`.

    Raises:
        InvalidInputError: if the folder does not exist, or the path is a folder, a device, a pipe
            or invalid.
        WriteError: if the disk is full or not writable; no partial file is left behind.
    """
    target = as_path(path, "path")
    try:
        if target.is_symlink():
            target = Path(os.path.realpath(target))
        if not target.parent.is_dir():
            raise InvalidInputError(
                f"Cannot write {target}: the folder {target.parent} does not exist. Create it "
                "first."
            )
        if target.is_dir():
            raise InvalidInputError(f"Cannot write {target}: it is a folder. Name a file in it.")
        if target.exists() and not target.is_file():
            raise InvalidInputError(
                f"Cannot write {target}: it is a device or a pipe. Name a file instead."
            )
        ending = target.suffix if suffix is None else suffix
        name = f"{_PREFIX}{uuid.uuid4().hex}{ending[:_LONGEST_SUFFIX]}"
        temporary = target.absolute().with_name(name)
        try:
            # Not `tempfile`: only the owner may read its files.
            temporary.open("xb").close()
            yield temporary
            os.replace(temporary, target)
        except BaseException:
            # The file or the folder may not exist.
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
    except CatFreeError:
        raise
    except OSError as error:
        raise cannot_write(target, error) from error


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yield a stream whose content replaces a file once complete.

    Raises:
        InvalidInputError: as `replacement`.
        WriteError: as `replacement`.
    """
    with replacement(path) as temporary, temporary.open("wb") as stream:
        yield stream


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder if it does not exist, and return its path.

    Raises:
        WriteError: if it cannot be made, or no file can be made in it.
    """
    folder = as_path(path, "folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error, "make the folder") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        denied = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        raise cannot_write(folder, denied, "write to the folder")
    return folder


def cannot_write(path: str | os.PathLike[str], error: OSError, task: str = "write") -> WriteError:
    """Make the error for a file or folder that cannot be written, with advice for its cause."""
    if isinstance(error, WriteError):
        return error
    advice = "Free some space, or name" if error.errno in _NO_SPACE else "Name"
    made = WriteError(f"Cannot {task} {path}: {error.strerror or error}. {advice} another place.")
    made.errno = error.errno
    return made
