"""How long computations say how far they have come."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]  # called as `progress(stage, done, total)`


def no_progress(stage: str, done: int, total: int) -> None:
    """Tell nobody: what is called where the caller passed no `progress`."""
