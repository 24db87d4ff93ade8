"""Time `cf.localize`, cold and warm, by size: `python benchmarks/localize.py`.

Simulated boxes of 7 cameras with embeddings. Warm times are also stated as multiples of the time
that NumPy takes to invert 200,000 3 x 3 matrices in the same process, which depends less on the
machine. The paper's implementation takes 135 s from detection through tracking on 40 frames.
"""

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
import time

import numpy as np

import catfree as cf
from catfree._worker import QUICK_COMPILATION
from catfree.synthetic import make_world

MATRICES = 200_000  # the yardstick: 3 x 3 matrices that NumPy inverts
COLD = """
import time
start = time.perf_counter()
import catfree as cf
from catfree.synthetic import make_world
world = make_world("wildtrack", 0, frames={frames}, people={people}, background={background})
begin = time.perf_counter()
cf.localize(world.detections, world.scene, cf.Settings(method="{method}"))
now = time.perf_counter()
print(len(world.detections), now - begin, now - start)
"""


MEMORY = """
import pickle, sys
from pathlib import Path
import catfree as cf
detections, scene = pickle.load(sys.stdin.buffer)
cf.localize(detections, scene, cf.Settings(method="{method}"))
status = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
print(int(status["VmHWM"].split()[0]) / 1024)
"""


def yardstick(repeats: int = 5) -> float:
    """Measure the median seconds in which NumPy inverts the matrices."""
    matrix = np.random.default_rng(0).normal(size=(MATRICES, 3, 3))
    matrix = matrix @ matrix.transpose(0, 2, 1) + np.eye(3)
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        np.linalg.inv(matrix)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def cold(
    frames: int, people: int, background: int, method: str, **environment: str
) -> tuple[int, float, float]:
    """Count detections; time `localize` in a new process, and the whole process, in seconds."""
    code = COLD.format(frames=frames, people=people, background=background, method=method)
    result = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | environment,
    )
    count, first, total = result.stdout.split()
    return int(count), float(first), float(total)


def peak_memory(detections: cf.Detections, scene: cf.Scene, method: str) -> float:
    """Measure the peak memory in MiB of a new process that localizes these boxes once."""
    result = subprocess.run(
        [sys.executable, "-c", MEMORY.format(method=method)],
        input=pickle.dumps((detections, scene)),
        capture_output=True,
        check=True,
    )
    return float(result.stdout)


def warm(
    frames: int, people: int, background: int, method: str, repeats: int
) -> tuple[int, float, dict[str, float], float]:
    """Count detections; measure median seconds of `localize`, of its stages, and MiB of memory."""
    world = make_world("wildtrack", 1, frames=frames, people=people, background=background)
    settings = cf.Settings(method=method)
    cf.localize(world.detections, world.scene, settings)
    seconds, stages = [], {}
    for _ in range(repeats):
        marks: list[tuple[str, float]] = []

        def record(stage: str, done: int, total: int, marks: list = marks) -> None:
            marks.append((stage, time.perf_counter()))

        start = time.perf_counter()
        cf.localize(world.detections, world.scene, settings, record)
        end = time.perf_counter()
        seconds.append(end - start)
        ends = [mark for _, mark in marks[1:]] + [end]
        for (stage, begin), finish in zip(marks, ends, strict=True):
            stages.setdefault(stage, []).append(finish - begin)
    return (
        len(world.detections),
        float(np.median(seconds)),
        {stage: sum(times) / repeats for stage, times in stages.items()},
        peak_memory(world.detections, world.scene, method),
    )


def main() -> None:
    """Print cold and warm times, the growth with frames, and the memory per size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--background", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--method", choices=["paper", "evidence"], default="evidence")
    parser.add_argument("--frames", type=int, nargs="+", default=[40, 100, 400])
    options = parser.parse_args()
    crowd = (options.people, options.background, options.method)
    count, first, total = cold(40, *crowd)
    print(f"cold process, 40 frames, {count} boxes: localize {first:.2f} s, all {total:.2f} s")
    _, first, total = cold(40, *crowd, XLA_FLAGS=QUICK_COMPILATION)
    print(f"as a command compiles it: localize {first:.2f} s, all {total:.2f} s")
    with tempfile.TemporaryDirectory() as folder:
        kept = {
            "JAX_COMPILATION_CACHE_DIR": folder,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        _, first, total = [cold(40, *crowd, **kept) for _ in range(2)][-1]
    print(f"with compiled functions kept: localize {first:.2f} s, all {total:.2f} s")
    base = None
    for frames in options.frames:
        count, seconds, stages, memory = warm(frames, *crowd, options.repeats)
        base = base or seconds / frames
        each = ", ".join(f"{stage} {part:.2f}" for stage, part in stages.items())
        print(
            f"warm, {frames:4d} frames, {count:6d} boxes: {seconds:6.2f} s, "
            f"{seconds / yardstick():.1f} yardsticks, {seconds / frames / base:.2f} x linear, "
            f"peak {memory:.0f} MiB ({each})"
        )
    print("The paper reports 135 s for 40 frames of WildTrack.")


if __name__ == "__main__":
    main()
