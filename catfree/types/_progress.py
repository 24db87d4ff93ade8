"""Progress reports of long computations."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]  # called as `progress(stage, done, total)`


def no_progress(stage: str, done: int, total: int) -> None:
    """Ignore a report; the default if the caller passes no `progress`."""
