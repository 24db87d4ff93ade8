"""Processes that were forked after JAX had begun to work: its threads are gone, and it waits.

Only processes whose parent had called catfree are told; a parent that used JAX alone is not known.
"""

import os

from catfree.errors import ForkedProcessError

_worked_in: set[int] = set()  # the process in which JAX was first used from here


def require_own_process() -> None:
    """Raise in a process that was forked from one in which catfree had used JAX.

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
