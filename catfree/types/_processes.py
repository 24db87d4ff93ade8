"""This process: its processors, and whether it was forked from one that had used JAX."""

import os
import sys

from catfree.errors import ForkedProcessError

_forked_after_jax = False


def processor_count() -> int:
    """Number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def require_own_process() -> None:
    """Raise in a process that was forked from one in which JAX had been used.

    A fork is noticed if the parent had imported `catfree.types`, as each part of catfree that uses
    JAX does.

    Raises:
        ForkedProcessError: instead of waiting forever for threads that `fork` did not copy.
    """
    if _forked_after_jax:
        raise ForkedProcessError(
            "This process was forked from one that had already used JAX, whose threads it lacks: "
            "JAX would wait forever. Start processes with the spawn start method, for instance "
            "multiprocessing.get_context('spawn')."
        )


def _note_fork() -> None:
    """Remember, in a process that was just forked, whether its parent had used JAX."""
    global _forked_after_jax
    bridge = sys.modules.get("jax._src.xla_bridge")
    _forked_after_jax = bridge is not None and bridge.backends_are_initialized()


if hasattr(os, "register_at_fork"):  # there is no fork on Windows
    os.register_at_fork(after_in_child=_note_fork)
