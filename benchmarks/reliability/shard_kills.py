"""SIGKILL of shard workers and their parent: a resumed run equals an undisturbed one."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.reliability.kills import compiled_in
from benchmarks.reliability.tally import Tally
from catfree.errors import ShardError
from catfree.settings import Settings
from catfree.synthetic import make_world

ROW = "shard kills"
KILLS_PER_RUN = 5


def kill_shards(tally: Tally, folder: Path, seed: int, kills: int) -> None:
    """Kill the parent or a worker of sharded runs, let them finish, and compare every byte.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
        seed: seed of all random choices.
        kills: number of kills.
    """
    rng = np.random.default_rng([seed, 8])
    _start(folder, folder / "whole").wait()  # compiles
    begin = time.perf_counter()
    _start(folder, folder / "again").wait()
    span = time.perf_counter() - begin
    whole = _table(folder / "whole")
    for number in range(kills):
        out = folder / f"run_{number // KILLS_PER_RUN}"
        process = _start(folder, out)
        time.sleep(float(rng.uniform(0, span)))
        workers = _children(process.pid)
        victim = workers[0] if workers and rng.random() < 0.5 else process.pid
        with contextlib.suppress(ProcessLookupError):  # it has just finished
            os.kill(victim, signal.SIGKILL)
        _, sentence = process.communicate(timeout=300)
        if "Traceback" in sentence and "ShardError" not in sentence.splitlines()[-1]:
            tally.count(ROW, "traceback", f"kill {number}: {sentence[-300:]}")
            continue
        if (number + 1) % KILLS_PER_RUN and number + 1 < kills:
            tally.count(ROW, "valid")
            continue
        _start(folder, out).communicate(timeout=300)
        lost = _table(out) != whole or not whole
        tally.count(ROW, "loss" if lost else "valid", f"kill {number}")
        shutil.rmtree(out, ignore_errors=True)


def _start(folder: Path, out: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "benchmarks.reliability.shard_kills", str(out)],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | compiled_in(folder),
        cwd=Path(__file__).parents[2],
    )


def _children(process: int) -> list[int]:
    """List the child processes of a process, on Linux; the last is the youngest."""
    found = Path(f"/proc/{process}/task/{process}/children")
    try:
        return [int(child) for child in found.read_text().split()][::-1]
    except OSError:
        return []


def _table(out: Path) -> dict[str, bytes]:
    names = [*out.glob("part-*.parquet"), out / "_shards" / "manifest.json"]
    return {path.name: path.read_bytes() for path in names if path.is_file()}


def main(out: Path) -> int:
    """Run the shards that are killed; return 1 if a worker was killed."""
    import catfree as cf

    world = make_world("ring4", frames=120, people=3)
    plan = cf.shards(world.detections, every=6, overlap=2, frame_rate=5)
    out.mkdir(parents=True, exist_ok=True)
    try:
        cf.run_shards(plan, scene=world.true_scene, out=out, settings=Settings.paper())
    except ShardError as error:
        print(f"ShardError: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
