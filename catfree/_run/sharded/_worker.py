"""Start of a worker process, imported before NumPy and JAX count the processors."""

import multiprocessing
import os
import threading

# Workers share the processors, so each library uses one thread.
ONE_THREAD = {
    "PJRT_NPROC": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}


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
