"""Types of arguments that many functions share."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array

HostOrDevice = np.ndarray | Array
Progress = Callable[[str, int, int], None]  # called as `progress(stage, done, total)`


def no_progress(stage: str, done: int, total: int) -> None:
    """Ignore a report; the default if the caller passes no `progress`."""
