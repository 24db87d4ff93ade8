"""Workers start quickly; lent variables are restored, in any order of borrowers."""

import os
import pickle
import signal
import subprocess
import sys
from unittest import mock

import pytest
from hypothesis import given, strategies as st

from catfree._worker import inherited, start_worker

NAMES = st.sampled_from(["CATFREE_TEST_ONE", "CATFREE_TEST_TWO"])
VALUES = st.dictionaries(NAMES, st.text("ab", min_size=1, max_size=3))


@given(VALUES, st.lists(VALUES, min_size=1, max_size=4), st.randoms())
def test_the_environment_is_as_before_when_the_last_borrower_left(own, lent, random):
    """Borrowers of several threads come and leave in any order."""
    with mock.patch.dict(os.environ, own):
        before = dict(os.environ)
        borrowers = [inherited(values) for values in lent]
        for one, values in zip(borrowers, lent, strict=True):
            one.__enter__()
            assert all(os.environ[name] == value for name, value in values.items())
        random.shuffle(borrowers)
        for one in borrowers:
            one.__exit__(None, None, None)
        assert dict(os.environ) == before


def test_a_worker_has_its_environment_before_it_imports_a_library():
    code = (
        "import pickle, sys; pickle.loads(sys.stdin.buffer.read())\n"
        "print(sorted({'numpy', 'jax', 'cv2'} & set(sys.modules)))"
    )
    command, start = [sys.executable, "-c", code], pickle.dumps(start_worker)
    assert subprocess.run(command, input=start, stdout=-1, check=True).stdout.strip() == b"[]"


INTERRUPTED = """
import os, signal, time
import numpy  # which takes time
from catfree._worker import spawned_pool

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell
    try:
        with spawned_pool(2) as pool:
            tasks = [pool.submit(os.getpid) for _ in range(2)]
            print("begun", flush=True)
            [task.result() for task in tasks]
            time.sleep(60)
    except KeyboardInterrupt:
        print("ended")
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="Windows has other interruptions")
def test_workers_that_are_interrupted_while_they_import_say_nothing(tmp_path):
    """Ctrl-C in a terminal reaches all processes of the command."""
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    command = [sys.executable, str(script)]
    with subprocess.Popen(command, **pipes, start_new_session=True) as parent:
        assert parent.stdout.readline().strip() == b"begun"
        os.killpg(parent.pid, signal.SIGINT)
        said, errors = parent.communicate(timeout=60)
    assert (said.strip(), errors, parent.returncode) == (b"ended", b"", 0)
