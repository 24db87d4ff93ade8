"""The environment and the start of worker processes, set before NumPy and JAX read it."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import Any, TypeVar

T = TypeVar("T")

# Workers share the processors, so each library uses one thread.
ONE_THREAD = {
    "PJRT_NPROC": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
# The C library keeps up to 256 MB for the next array; some systems make it return them at once.
KEPT_MEMORY = {
    "MALLOC_TRIM_THRESHOLD_": str(2**28),
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
}
# JAX reads these at the first array, which this process may not have created yet.
OF_JAX = ("PJRT_NPROC", "XLA_FLAGS")
# Compilation takes a third less time without XLA's newer code generator, and the code is as fast.
# XLA ends a process that names an unknown option, which this may become in a later version.
QUICK_COMPILATION = "--xla_cpu_use_fusion_emitters=false"
LAST_WITH_OPTION = (0, 10)  # jaxlib version
HAS_MASKS = hasattr(signal, "pthread_sigmask")  # not on Windows
POLL = 0.1  # seconds between two looks for reports

# JAX and OpenCV do not survive a fork.
SPAWN = multiprocessing.get_context("spawn")

# Set only in worker processes: the queue `reports` for their reports.
from_parent: dict[str, Any] = {}

# The active lenders of variables, and the values before.
_lending = threading.Lock()
_borrowers: list[dict[str, str]] = []
_before: dict[str, str | None] = {}


def jaxlib_version() -> tuple[int, ...]:
    """Return major and minor version of jaxlib, without importing it."""
    from importlib.metadata import version  # workers, which also import this module, do not need it

    return tuple(map(int, version("jaxlib").split(".")[:2]))


def compilation_environment() -> dict[str, str]:
    """Return the flags of XLA of this process, or flags that make it compile quickly."""
    if "XLA_FLAGS" in os.environ:
        return {"XLA_FLAGS": os.environ["XLA_FLAGS"]}
    return {"XLA_FLAGS": QUICK_COMPILATION} if jaxlib_version() <= LAST_WITH_OPTION else {}


def worker_environment() -> dict[str, str]:
    """Return the environment that worker processes should start with.

    Each library uses one thread, XLA compiles in two thirds of the time, and freed memory is kept
    for the next array. Workers with this environment write identical bytes, however they are
    started, on processors of one kind. `run_shards` and `catfree shard` set it themselves; pass it
    to other systems as any environment, for instance `ray.init(runtime_env={"env_vars":
    cf.worker_environment()})`.

    Returns:
        Values by name. If this process has `XLA_FLAGS`, workers get the same.
    """
    return {**ONE_THREAD, **KEPT_MEMORY, **compilation_environment()}


@contextlib.contextmanager
def inherited(environment: Mapping[str, str]) -> Iterator[None]:
    """Let processes started in the block inherit variables, except those of JAX.

    A spawned process imports the caller's script, and often NumPy with it, before `start_worker`
    runs. This process has already imported NumPy, so the variables do not affect it. If several
    threads are in the block, the last to leave restores the values before the first.
    """
    lent = {name: value for name, value in environment.items() if name not in OF_JAX}
    with _lending:
        _borrowers.append(lent)
        for name, value in lent.items():
            _before.setdefault(name, os.environ.get(name))
            os.environ[name] = value
    try:
        yield
    finally:
        with _lending:
            _borrowers.remove(lent)
            if not _borrowers:
                for name, value in _before.items():
                    if value is None:
                        os.environ.pop(name, None)
                    else:
                        os.environ[name] = value
                _before.clear()


@contextlib.contextmanager
def postponed_interruption() -> Iterator[None]:
    """Delay an interruption until the block has finished; a second one acts at once."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # interruptions are handled elsewhere
        return
    interruptions = []

    def postpone(*interruption: Any) -> None:
        interruptions.append(interruption)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    signal.signal(signal.SIGINT, postpone)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if interruptions:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _blocked_interruption() -> Iterator[None]:
    """Block Ctrl-C in this thread, and in processes started meanwhile until they unblock it."""
    if not HAS_MASKS:
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class SpawnedProcesses(ProcessPoolExecutor):
    """Processes that start as tasks need them; Ctrl-C ends them once they have imported."""

    def __init__(self, count: int, environment: Mapping[str, str], reports: Any = None) -> None:
        super().__init__(count, SPAWN, start_worker, (environment, reports))

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a task, which may start a process."""
        # An interruption would leave behind a process that the executor does not know.
        with postponed_interruption(), _blocked_interruption():
            return super().submit(fn, *args, **kwargs)


@contextlib.contextmanager
def spawned_pool(count: int, reports: Any = None) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor that spawns processes as tasks need them; an error cancels other tasks.

    Until it is shut down, the environment of this process contains `worker_environment` without the
    variables of JAX; other processes started meanwhile inherit it.

    Args:
        count: maximum number of processes.
        reports: a queue made by `SPAWN`, available in the processes as `from_parent["reports"]`.
    """
    environment = worker_environment()
    with inherited(environment), SpawnedProcesses(count, environment, reports) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def as_they_end(
    tasks: Iterable[Future[T]], reports: Any, on_report: Callable[[int], None]
) -> Iterator[Future[T]]:
    """Yield tasks as they end, meanwhile passing on the sum of their processes' reports.

    Args:
        tasks: tasks of processes that put numbers of finished steps into the queue.
        reports: the queue.
        on_report: called with the number of finished steps.
    """
    done, pending = 0, set(tasks)
    while pending:
        finished, pending = wait(pending, POLL, FIRST_COMPLETED)
        while not reports.empty():
            done += reports.get()
            on_report(done)
        yield from finished


def start_worker(environment: Mapping[str, str], reports: Any = None) -> None:
    """Set the environment of this process, and end it at Ctrl-C or when its parent dies."""
    # An exception would print a traceback, or be lost in a callback while the work continues.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if HAS_MASKS:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.environ.update(environment)
    from_parent["reports"] = reports
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def follow() -> None:
        parent.join()
        os._exit(1)  # no one waits for the result; a shard without a receipt runs again

    threading.Thread(target=follow, daemon=True).start()
