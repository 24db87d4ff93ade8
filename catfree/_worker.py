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
# The C library keeps up to 256 MB for the next array; some engines have it return them at once.
KEPT_MEMORY = {
    "MALLOC_TRIM_THRESHOLD_": str(2**28),
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
}
# JAX reads these with the first array, which this process may not have made yet.
OF_JAX = ("PJRT_NPROC", "XLA_FLAGS")
# Compilation takes two thirds of the time without XLA's newer code generator, and its code is as
# fast. XLA ends a process that names an option that it does not know, as a later one may not.
QUICK_COMPILATION = "--xla_cpu_use_fusion_emitters=false"
LAST_WITH_OPTION = (0, 10)  # of jaxlib
HAS_MASKS = hasattr(signal, "pthread_sigmask")  # not on Windows
POLL = 0.1  # seconds between two looks for reports

# Neither JAX nor OpenCV survive a fork.
SPAWN = multiprocessing.get_context("spawn")

# Set only in worker processes: the queue `reports` to which they report.
from_parent: dict[str, Any] = {}

# Who lends variables at present, and the values before.
_lending = threading.Lock()
_borrowers: list[dict[str, str]] = []
_before: dict[str, str | None] = {}


def jaxlib_version() -> tuple[int, ...]:
    """Major and minor version of jaxlib, without importing it."""
    from importlib.metadata import version  # not for workers, which import this module, too

    return tuple(map(int, version("jaxlib").split(".")[:2]))


def compilation_environment() -> dict[str, str]:
    """Return the flags of XLA that this process has, or those that make it compile quickly."""
    if "XLA_FLAGS" in os.environ:
        return {"XLA_FLAGS": os.environ["XLA_FLAGS"]}
    return {"XLA_FLAGS": QUICK_COMPILATION} if jaxlib_version() <= LAST_WITH_OPTION else {}


def worker_environment() -> dict[str, str]:
    """Return the environment that worker processes should start with.

    Each library uses one thread, XLA compiles in two thirds of the time, and freed memory is kept
    for the next array. Workers with this environment write the same bytes, whoever starts them, on
    processors of one kind. `run_shards` and `catfree shard` set it themselves; other engines take
    it as they take any environment, for instance
    `ray.init(runtime_env={"env_vars": cf.worker_environment()})`.

    Returns:
        Values by name. If this process has `XLA_FLAGS`, workers get the same.
    """
    return {**ONE_THREAD, **KEPT_MEMORY, **compilation_environment()}


@contextlib.contextmanager
def inherited(environment: Mapping[str, str]) -> Iterator[None]:
    """Let processes that start meanwhile inherit variables, except those of JAX.

    A spawned process imports the caller's script, and often NumPy with it, before `start_worker`
    runs. This process has imported NumPy already, so the variables do not affect it. Of several
    threads, the last one to leave restores what was before the first.
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
    """Finish the block before an interruption ends it; a second one ends it at once."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # somebody else decides
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
    """Block Ctrl-C in this thread, and until they unblock it in processes that start meanwhile."""
    if not HAS_MASKS:
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class SpawnedProcesses(ProcessPoolExecutor):
    """Processes that start as tasks need them; Ctrl-C ends them when they have imported."""

    def __init__(self, count: int, environment: Mapping[str, str], reports: Any = None) -> None:
        super().__init__(count, SPAWN, start_worker, (environment, reports))

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a task, for which a process may start."""
        # An interruption would leave a process behind that the executor does not know.
        with postponed_interruption(), _blocked_interruption():
            return super().submit(fn, *args, **kwargs)


@contextlib.contextmanager
def spawned_pool(count: int, reports: Any = None) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor whose processes are spawned, as tasks need them; an error cancels the rest.

    Until it is shut down, the environment of this process holds that of `worker_environment`
    without the variables of JAX; other processes started meanwhile inherit it.

    Args:
        count: most processes.
        reports: a queue made by `SPAWN`, which the processes have as `from_parent["reports"]`.
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
    """Yield tasks as they end, and meanwhile pass on the sum of what their processes report.

    Args:
        tasks: of processes that put numbers of finished steps into the queue.
        reports: the queue.
        on_report: called with the number of steps that are finished.
    """
    done, pending = 0, set(tasks)
    while pending:
        finished, pending = wait(pending, POLL, FIRST_COMPLETED)
        while not reports.empty():
            done += reports.get()
            on_report(done)
        yield from finished


def start_worker(environment: Mapping[str, str], reports: Any = None) -> None:
    """Set the environment of this process, and end it when its parent dies or at Ctrl-C."""
    # An exception would print where it was, or be lost in a callback while the work goes on.
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
        os._exit(1)  # nobody waits for the result; a shard without a receipt runs again

    threading.Thread(target=follow, daemon=True).start()
