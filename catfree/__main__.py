"""`catfree` and `python -m catfree`: the command line in its own process."""

import os
import sys

from catfree._worker import ONE_THREAD, compilation_environment


def main() -> int:
    """Run the command line, silencing OpenCV and FFmpeg, whose errors it reports itself."""
    # Cameras have their own threads, which would only wait for OpenCV's.
    os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
    # Matrices are small: sharing one among threads takes longer than multiplying it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet
    os.environ.update(compilation_environment())
    if "".join(sys.argv[1:2]) in ("shard", "watch"):
        # A shard must give the same bytes as in other workers; instants are too short for threads.
        os.environ.update(ONE_THREAD)
    # Workers also import this module, and NumPy must not count the processors before they start.
    from catfree.cli import main as command_line

    return command_line()


if __name__ == "__main__":
    sys.exit(main())
