"""`catfree` and `python -m catfree`: the command line in a process of its own."""

import os
import sys

from catfree._run.sharded._worker import ONE_THREAD

# Compilation takes two thirds of the time without XLA's newer code generator, and its code is as
# fast. XLA ends a process that names an option that it does not know, as a later one may not.
QUICK_COMPILATION = "--xla_cpu_use_fusion_emitters=false"
LAST_WITH_OPTION = (0, 10)  # of jaxlib
# Workers of other engines are started without us, and all write the same bytes.
OF_WORKERS = ("shard", "run-sites")


def jaxlib_version() -> tuple[int, ...]:
    """Major and minor version of jaxlib, without importing it."""
    from importlib.metadata import version  # not for workers, which import this module, too

    return tuple(map(int, version("jaxlib").split(".")[:2]))


def main() -> int:
    """Run the command line; what OpenCV and FFmpeg would say is said in its own sentences."""
    # Cameras have threads of their own, which would only wait for OpenCV's.
    os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet
    command = "".join(sys.argv[1:2])
    if command not in OF_WORKERS and jaxlib_version() <= LAST_WITH_OPTION:
        os.environ.setdefault("XLA_FLAGS", QUICK_COMPILATION)
    if command in ("shard", "watch"):
        # A shard as in the workers of other engines, to the byte; instants are too short for more.
        os.environ.update(ONE_THREAD)
    # Workers import this module, too, and NumPy must not count the processors before they start.
    from catfree.cli import main as command_line

    return command_line()


if __name__ == "__main__":
    sys.exit(main())
