"""Speed of `cf.localize`, cold and warm, by size: `python benchmarks/localize.py`.

The paper's implementation takes 135 s from detection through tracking on 40 frames of 7 cameras.
"""

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

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


def cold(frames: int, people: int, background: int, method: str) -> tuple[int, float, float]:
    """Detections, seconds of `localize` in a new process, and of the whole process."""
    code = COLD.format(frames=frames, people=people, background=background, method=method)
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    count, first, total = result.stdout.split()
    return int(count), float(first), float(total)


def warm(
    frames: int, people: int, background: int, method: str, repeats: int
) -> tuple[int, float, dict[str, float]]:
    """Detections, median seconds of `localize`, and the seconds of its stages."""
    import catfree as cf
    from catfree.synthetic import make_world

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
    )


def main() -> None:
    """Print cold and warm times, the growth with frames, and the memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--background", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--method", choices=["paper", "evidence"], default="paper")
    options = parser.parse_args()
    crowd = (options.people, options.background, options.method)
    count, first, total = cold(40, *crowd)
    print(f"cold process, 40 frames, {count} boxes: localize {first:.2f} s, all {total:.2f} s")
    base = None
    for frames in (40, 100, 400):
        count, seconds, stages = warm(frames, *crowd, options.repeats)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        base = base or seconds / frames
        each = ", ".join(f"{stage} {part:.2f}" for stage, part in stages.items())
        print(
            f"warm, {frames:4d} frames, {count:6d} boxes: {seconds:6.2f} s, "
            f"{seconds / frames / base:.2f} x linear, peak {memory:.0f} MiB ({each})"
        )
    print("The paper reports 135 s for 40 frames of WildTrack.")


if __name__ == "__main__":
    main()
