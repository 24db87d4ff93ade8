"""SIGKILL at random moments: remaining files are intact, and the next run resumes from them."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.reliability.tally import Tally
from catfree._run._result_folder import write_results
from catfree._run._run import run_stages
from catfree.adapters.protocols import FrameDetections
from catfree.settings import Settings
from catfree.synthetic import World, make_world, ring

CAMERAS, FRAMES, SIZE = 3, 45, (320, 180)
KILLS_PER_RUN = 3
ROW = "kills"


class FromPicture:
    """Look up boxes by the camera and frame stored in the picture's first pixel."""

    fingerprint = "reliability"

    def __init__(self, world: World) -> None:
        self._boxes = world.detections

    def __call__(self, image: Any) -> FrameDetections:
        """Return the boxes of one picture."""
        time.sleep(0.005)  # so that kills also hit the detection
        frame, camera = int(image[0, 0, 0]), int(image[0, 0, 1])
        boxes = self._boxes[(self._boxes.frame == frame) & (self._boxes.camera == camera)]
        return FrameDetections(boxes.box, np.ones(len(boxes)))


def kill(tally: Tally, folder: Path, seed: int, kills: int) -> None:
    """Kill a small run repeatedly, then let it finish, and compare every byte.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
        seed: seed of all random choices.
        kills: number of kills.
    """
    rng = np.random.default_rng([seed, 7])
    pictures = folder / "pictures"
    for camera in range(CAMERAS):
        (pictures / str(camera)).mkdir(parents=True)
        for frame in range(FRAMES):
            image = rng.integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)
            image[0, 0] = (0, camera, frame)  # blue, green, red
            cv2.imwrite(str(pictures / str(camera) / f"{frame:03d}.png"), image)
    first = folder / "whole"
    if kills > KILLS_PER_RUN:  # otherwise it takes longer than it saves
        _start(pictures, folder / "compiling").wait()
    started = _start(pictures, first)
    begin = time.perf_counter()
    started.wait()
    span = time.perf_counter() - begin
    whole = _contents(first)
    if started.returncode or whole.get("tracks.csv", b"").count(b"\n") < 2:
        tally.count(ROW, "loss", "the uninterrupted run found nobody")
        return
    for number in range(kills):
        out = folder / f"run_{number // KILLS_PER_RUN}"
        process = _start(pictures, out)
        time.sleep(float(rng.uniform(0, span)))
        process.kill()
        process.wait()
        for name, content in _contents(out).items():
            if whole.get(name) != content:
                tally.count(ROW, "loss", f"kill {number} left half of {name}")
        if (number + 1) % KILLS_PER_RUN and number + 1 < kills:
            tally.count(ROW, "valid")
            continue
        last = _start(pictures, out)
        last.wait()
        again = _contents(out)
        differ = sorted(n for n in whole.keys() | again.keys() if whole.get(n) != again.get(n))
        lost = last.returncode != 0 or bool(differ)
        tally.count(ROW, "loss" if lost else "valid", f"kill {number}: {differ}")
        shutil.rmtree(out, ignore_errors=True)


def _start(pictures: Path, out: Path) -> subprocess.Popen[str]:
    """Start a run in its own process; return once it has imported everything."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.reliability.kills", str(pictures), str(out)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | compiled_in(pictures.parent),
        cwd=Path(__file__).parents[2],
    )
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.close()
    return process


def compiled_in(folder: Path) -> dict[str, str]:
    """Return the environment of a process that caches compiled code in its own folder.

    Recompiling would take most of the time, so kills would seldom hit anything else. The folder
    must not be shared, because a killed process may leave half of a file.
    """
    return {
        "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def _contents(folder: Path) -> dict[str, bytes]:
    """Read the finished files, whose names are not temporary."""
    files = (path for path in folder.rglob("[!.]*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def main(pictures: Path, out: Path) -> None:
    """Run the stages that are killed."""
    world = make_world(ring(CAMERAS, image_size=SIZE, people=4), frames=FRAMES, people=4)
    print("ready", flush=True)
    settings = Settings.paper()
    outcome = run_stages(
        [pictures / str(camera) for camera in range(CAMERAS)],
        FromPicture(world),
        scene=world.scene,
        settings=settings,
        cache_dir=out / "cache",
    )
    write_results(out, outcome, settings, pictures=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
