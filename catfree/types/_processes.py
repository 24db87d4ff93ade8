"""The current process: its processors, and whether it was forked after JAX was used."""

import os
import sys

from catfree.errors import ForkedProcessError

_forked_after_jax = False


def processor_count() -> int:
    """Number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def require_own_process() -> None:
    """Raise if this process was forked from one that had used JAX.

    A fork is detected if the parent had imported `catfree.types`; every part of catfree that uses
    JAX imports it.

    Raises:
        ForkedProcessError: instead of a deadlock on threads that `fork` did not copy.
    """
    if _forked_after_jax:
        raise ForkedProcessError(
            "This process was forked from one that had already used JAX, whose threads it lacks: "
            "JAX would wait forever. Start processes with the spawn start method, for instance "
            "multiprocessing.get_context('spawn')."
        )


def _note_fork() -> None:
    """Record in a newly forked process whether its parent had used JAX."""
    global _forked_after_jax
    bridge = sys.modules.get("jax._src.xla_bridge")
    _forked_after_jax = bridge is not None and bridge.backends_are_initialized()


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_note_fork)
