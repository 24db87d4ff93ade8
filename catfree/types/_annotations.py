"""Types of arguments that many functions share."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array

from catfree.errors import InvalidInputError, quoted

HostOrDevice = np.ndarray | Array
Progress = Callable[[str, int, int], None]  # called as `progress(stage, done, total)`


def no_progress(stage: str, done: int, total: int) -> None:
    """Ignore a report: the default `progress`."""


def as_progress(progress: Progress | None) -> Progress:
    """Return the caller's `progress`, or a function that ignores reports if it is None.

    Raises:
        InvalidInputError: if it is not callable.
    """
    if progress and not callable(progress):
        raise InvalidInputError(
            f"progress is {quoted(progress)}; it must be a function, which is called as "
            "progress(stage, done, total)."
        )
    return progress or no_progress
