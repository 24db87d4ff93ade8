"""A small part of `python -m benchmarks.reliability`: no traceback, silent NaN, hang or loss."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]

pytest.importorskip("resource", reason="limits of processes are not known to this system")


def test_every_failure_is_one_sentence():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.reliability", "--short", "--seed", "1"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    parts = ("fuzz", "decay", "attacks", "names of cameras", "kills", "full disk")
    assert all(part in done.stdout for part in parts)
