"""This process: its processors, and whether it was forked from one that had used JAX."""

import os

from catfree.errors import ForkedProcessError

_worked_in: set[int] = set()  # the process in which catfree first used JAX


def processor_count() -> int:
    """Number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def require_own_process() -> None:
    """Raise in a process that was forked from one in which catfree had used JAX.

    If the parent had used only JAX, not catfree, the fork is not detected.

    Raises:
        ForkedProcessError: instead of waiting forever for threads that `fork` did not copy.
    """
    if not _worked_in:
        _worked_in.add(os.getpid())
    if os.getpid() not in _worked_in:
        raise ForkedProcessError(
            "This process was forked from one that had already used JAX, whose threads it lacks: "
            "JAX would wait forever. Start processes with the spawn start method, for instance "
            "multiprocessing.get_context('spawn')."
        )
