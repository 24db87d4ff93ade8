"""A forked process raises an error instead of waiting forever."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

CHILD = """
import multiprocessing, warnings
import numpy as np
import catfree as cf
warnings.simplefilter("ignore")
rig = cf.Rig(np.tile(np.eye(3), (2, 1, 1)), np.tile(np.diag([1.0, -1, -1]), (2, 1, 1)),
             np.array([[0.0, 0, 5], [1, 0, 5]]), (10, 10))
scene = cf.Scene.from_rig(rig, cf.Plane([0, 0, 1], 0))
nobody = cf.Detections([], [], np.zeros((0, 4)))
def work(queue):
    try:
        queue.put(len(cf.localize(nobody, scene).tracks))
    except cf.CatFreeError as error:
        queue.put(str(error))
context = multiprocessing.get_context("fork")
for use in [lambda: cf.filters.otsu(np.arange(4.0)), lambda: None]:
    queue = context.SimpleQueue()
    process = context.Process(target=work, args=(queue,))
    process.start()
    print(queue.get())
    process.join()
    use()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_a_process_forked_after_jax_was_used_says_so():
    done = subprocess.run(
        [sys.executable, "-c", CHILD], capture_output=True, text=True, timeout=120, check=True
    )
    before, after = done.stdout.splitlines()
    assert before == "0"  # forked before any computation
    assert "spawn start method" in after
