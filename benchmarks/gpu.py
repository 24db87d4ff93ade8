"""Time `cf.localize` on many scenes on two processor cores, without and with a GPU.

    python benchmarks/gpu.py [--scenes 64]

Two processes share the scenes and the same two cores; with a GPU, both run the compiled functions
on it. The float width is that of the boxes. Each process warms up on one scene before the clock
starts. Without a GPU, only the processor is measured.

64 scenes of 40 frames, 7 cameras and 8,000 boxes with embeddings, on a machine with one H100:

| | float width | seconds | of two cores | MODA, mean |
|---|---|---|---|---|
| cpu | float64 | 98.1 | 1.00 | 93.51 |
| cpu | float32 | 69.3 | 0.71 | 93.51 |
| gpu | float64 | 75.8 | 0.77 | 93.52 |
| gpu | float32 | 89.2 | 0.91 | 93.52 |

Each line was measured once and varies by a quarter. Most of the time is spent on the host, where
boxes are grouped.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import time

import numpy as np

FRAMES = 40
PROCESSES = 2
WIDTHS = ("float64", "float32")


def share(width: str, first: int, scenes: int) -> None:
    """Localize every second scene once told to begin, and print seconds and MODA."""
    import jax

    import catfree as cf
    from catfree.evaluation import detection_metrics_in_area
    from catfree.geometry import fit_similarity
    from catfree.synthetic import make_world

    worlds = [
        make_world("wildtrack", seed, frames=FRAMES, people=30, background=20)
        for seed in range(first, scenes, PROCESSES)
    ]
    inputs = [
        dataclasses.replace(world.detections, box=world.detections.box.astype(width))
        for world in worlds
    ]
    cf.localize(inputs[0], worlds[0].scene)
    print(jax.default_backend(), flush=True)
    sys.stdin.readline()
    start = time.perf_counter()
    tracks = [
        cf.localize(boxes, world.scene).tracks for boxes, world in zip(inputs, worlds, strict=True)
    ]
    seconds = time.perf_counter() - start
    moda = []
    for found, world in zip(tracks, worlds, strict=True):
        to_meters = fit_similarity(np.asarray(world.scene.rig.centers), world.true_centres)
        rows = found.to_rows(np.asarray(to_meters(found.position))[:, :2])
        area = detection_metrics_in_area(world.ground_truth, rows, world.area, np.arange(FRAMES))
        moda.append(area.metrics.moda)
    print(json.dumps([seconds, moda]), flush=True)


def measure(platform: str, width: str, scenes: int) -> tuple[str, float, list[float]]:
    """Return the platform, the seconds of the slower process, and the MODA of every scene."""
    environment = os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    if platform == "cpu":
        environment["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, __file__, "--scenes", str(scenes), "--width", width, "--first"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    runs = [
        subprocess.Popen([*command, str(first)], env=environment, **pipes)
        for first in range(PROCESSES)
    ]
    backends = {run.stdout.readline().strip() for run in runs}
    for run in runs:
        run.stdin.write("begin\n")
        run.stdin.flush()
    results = [json.loads(run.communicate()[0]) for run in runs]
    moda = [score for _, scores in results for score in scores]
    return " ".join(backends), max(seconds for seconds, _ in results), moda


def main() -> None:
    """Print a table of seconds and MODA by platform and float width."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=64)
    parser.add_argument("--first", type=int)
    parser.add_argument("--width", choices=WIDTHS)
    options = parser.parse_args()
    if options.first is not None:
        share(options.width, options.first, options.scenes)
        return
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:PROCESSES])
    base = None
    print("| | float width | seconds | of two cores | MODA, mean | worst change |")
    print("|---|---|---|---|---|---|")
    for platform in ("cpu", "any"):
        for width in WIDTHS:
            backend, seconds, moda = measure(platform, width, options.scenes)
            base = base or (seconds, moda)
            if platform == "any" and backend == "cpu":
                return
            change = min(np.array(moda) - base[1], key=lambda x: -abs(x))
            print(
                f"| {backend} | {width} | {seconds:.1f} | {seconds / base[0]:.2f} | "
                f"{np.mean(moda):.2f} | {change:+.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
