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
    """Give processes that start meanwhile one thread in NumPy, by this process's environment.

    A spawned process imports the caller's script, and often NumPy with it, before `start_worker`
    runs. This process has imported NumPy already, so the variables do not affect it.
    """
    before = {name: os.environ.get(name) for name in OF_NUMPY}
    os.environ.update({name: ONE_THREAD[name] for name in OF_NUMPY})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
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
