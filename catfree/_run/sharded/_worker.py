"""Start of a worker process, imported before NumPy and JAX count the processors."""

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Iterator

# Workers share the processors, so each library uses one thread.
ONE_THREAD = {
    "PJRT_NPROC": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
# Those that NumPy reads when it is imported.
OF_NUMPY = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextlib.contextmanager
def one_thread_from_the_start() -> Iterator[None]:
    """Let processes that start meanwhile have one thread in NumPy.

    A spawned process imports the caller's script, and with it often NumPy, before `start_worker`.
    The NumPy of this process has counted the processors before.
    """
    before = {name: os.environ.get(name) for name in OF_NUMPY}
    os.environ.update({name: ONE_THREAD[name] for name in OF_NUMPY})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def start_worker() -> None:
    """Limit the threads of this process, and end it when its parent dies."""
    os.environ.update(ONE_THREAD)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def follow() -> None:
        parent.join()
        os._exit(1)  # nobody waits for the result; a shard without a receipt runs again

    threading.Thread(target=follow, daemon=True).start()
