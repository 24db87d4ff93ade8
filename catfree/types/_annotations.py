"""Types of arguments that many functions share."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array

from catfree.errors import InvalidInputError, quoted

HostOrDevice = np.ndarray | Array
Progress = Callable[[str, int, int], None]  # called as `progress(stage, done, total)`


def no_progress(stage: str, done: int, total: int) -> None:
    """Ignore a report; the default if the caller passes no `progress`."""


def as_progress(progress: Progress | None) -> Progress:
    """Return what the caller passes as `progress`; a function that ignores reports for none.

    Raises:
        InvalidInputError: if it cannot be called, as True.
    """
    if progress and not callable(progress):
        raise InvalidInputError(
            f"progress is {quoted(progress)}; it must be a function, which is called as "
            "progress(stage, done, total)."
        )
    return progress or no_progress
