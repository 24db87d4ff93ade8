"""The exceptions of catfree.

Each message says in one or two sentences what is wrong, where (file, camera, frame, index) and what
to do. Catch `CatFreeError` to catch them all.
"""

import contextlib
import reprlib
from collections.abc import Iterator
from typing import Any

_LONGEST_QUOTE = 120  # characters; fits a matrix row

_short_repr = reprlib.Repr()
_short_repr.maxlevel = 3
_short_repr.maxstring = _short_repr.maxother = _short_repr.maxlong = _LONGEST_QUOTE
_short_repr.maxlist = _short_repr.maxtuple = _short_repr.maxdict = 8


def quoted(value: Any) -> str:
    """Format a value on one line of an error message, dropping the middle if it is long.

    An exception gives its message without the final period; anything else gives its `repr`, or its
    type if `repr` fails.
    """
    is_error = isinstance(value, BaseException)
    try:
        text = str(value).rstrip(". ") if is_error else _short_repr.repr(value)
    except Exception:  # Python refuses to print integers of thousands of digits
        is_whole = isinstance(value, int)
        text = f"a number of {value.bit_length()} bits" if is_whole else f"a {type(value).__name__}"
    return shortened(" ".join(map(str.strip, text.splitlines())))


def shortened(text: str) -> str:
    """Shorten long text, such as a camera's name, by dropping its middle."""
    if len(text) <= _LONGEST_QUOTE:
        return text
    half = _LONGEST_QUOTE // 2
    return f"{text[:half]} ... {text[-half:]}"


class CatFreeError(Exception):
    """Base class of all errors that catfree raises deliberately."""


class InvalidInputError(CatFreeError, ValueError):
    """An argument or a file's content violates the documented contract."""


class FileFormatError(CatFreeError, ValueError):
    """A file exists but does not have the content that its format requires."""


class WriteError(CatFreeError, OSError):
    """A file cannot be written: the disk is full, or the folder is not writable."""


class DownloadError(CatFreeError, OSError):
    """A file cannot be downloaded; the message says what to fetch by hand and where to put it."""


class InsufficientDataError(CatFreeError):
    """A stage has too few cameras, detections, frames or shared people."""


class GroundRejectedError(CatFreeError):
    """No plane in the scene qualifies as the ground that people walk on."""


class CalibrationError(CatFreeError):
    """No camera rig is supported by the evidence."""


class DegenerateGeometryError(CatFreeError, ValueError):
    """Points or rays are in a degenerate configuration, so the result is undetermined."""


class ForkedProcessError(CatFreeError, RuntimeError):
    """A forked process would deadlock; the message says how to start a process that does not."""


class MissingDependencyError(CatFreeError, ImportError):
    """An optional dependency is not installed; the message contains the pip command."""


@contextlib.contextmanager
def needing(sentence: str) -> Iterator[None]:
    """Raise `MissingDependencyError` with this sentence if an import in the block fails."""
    try:
        yield
    except ImportError as error:
        raise MissingDependencyError(sentence) from error


class ShardError(CatFreeError):
    """Shards of one or more recordings failed; the message names each with its reason.

    Attributes:
        finished: the joined tables of the recordings that did not fail.
        reasons: one sentence per recording that failed.
    """

    def __init__(
        self, message: str, finished: tuple[Any, ...] = (), reasons: tuple[str, ...] = ()
    ) -> None:
        super().__init__(message)
        self.finished = finished
        self.reasons = reasons
