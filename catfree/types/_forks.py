"""Detection of processes forked after JAX started its threads, in which JAX would deadlock.

A fork is detected only if its parent had called catfree, not if the parent had used only JAX.
"""

import os

from catfree.errors import ForkedProcessError

_worked_in: set[int] = set()  # the process in which catfree first used JAX


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
