"""Measure accuracy and cost of `cf.Tracker`: `python -m benchmarks.online [DATA]`.

With DATA (see `benchmarks.methods`), and for simulated worlds with seeds `--worlds FIRST END`, a
table compares MODA at 0.5 m of current positions (lag 0), of positions that are final after 2 s, of
these when the tracker has already learned its cameras from the same sequence, and of `cf.localize`
on all frames. Frames without a known rate count as two per second.

`--speed N` adds N instants of 7 cameras with about 25 boxes each, and prints the time per instant
and the memory. The time is CPU time of the process, the most that an idle machine takes; the first
instants, which compile and often learn, are counted separately.
"""

import argparse
import json
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks.figures import file_of
from benchmarks.methods import sequences
from benchmarks.paper.scoring import ground_rows, score_rows
from benchmarks.paper.sequences import Sequence
from catfree.synthetic import make_world

RATE = 2.0  # frames per second if the file does not state it
WARM = 130  # instants until noise is learned from a full sample
PAUSE = 3600.0  # seconds between two passes of a tracker over a sequence
SPEED_FRAMES = 200  # frames of the simulated world, repeated forwards and backwards


def rate_of(name: str, data: Path) -> float:
    """Read the frames per second stated in a file of boxes."""
    path = data / file_of(name)
    if not path.is_file():
        return RATE
    return float(json.loads(path.read_text(encoding="utf-8")).get("fps", RATE))


def stream(
    sequence: Sequence, rate: float, lag: float, *, learned: bool = False
) -> tuple[cf.Tracks, cf.Tracks]:
    """Track a sequence; return provisional and final tracks, and its frame numbers.

    Args:
        sequence: boxes and scene.
        rate: instants per second.
        lag: lag of the tracker in seconds.
        learned: run the tracker over the sequence twice, and report the second pass.
    """
    tracker = cf.Tracker(sequence.scene, lag=lag)
    boxes = sequence.detections
    frames = np.unique(boxes.frame)
    step = np.median(np.diff(frames))
    before = (frames[-1] / step / rate + PAUSE,) if learned else ()
    now, final = [], []
    for earlier in (*before, 0.0):
        for frame in frames.tolist():
            update = tracker.update(boxes[boxes.frame == frame], frame / step / rate - earlier)
            now.append(update.provisional)
            final.append(update.final)
    final.append(tracker.finish().final)
    return _joined(now, step * rate), _joined(final, step * rate)


def _joined(parts: list[cf.Tracks], rate: float) -> cf.Tracks:
    parts = [part[part.frame >= 0] for part in parts]  # times of the first pass are negative
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(parts[0])
        if getattr(parts[0], name) is not None and name != "clock"
    }
    frame = np.round(columns["frame"] * (rate / 1e6)).astype(np.int64)
    return cf.Tracks(**columns | {"frame": frame})


def worlds(seeds: range) -> Iterator[Sequence]:
    """Simulate crowds without embeddings."""
    for seed in seeds:
        world = make_world("wildtrack", seed, frames=60, people=20)
        d = world.detections
        boxes = cf.Detections(d.frame, d.camera, d.box, d.score, d.ankles_confirmed)
        yield Sequence(
            f"world {seed}", boxes, world.scene, world.ground_truth, np.arange(60),
            true_centres=np.asarray(world.true_scene.rig.centers),
        )  # fmt: skip


def compare(sequence: Sequence, rate: float) -> str:
    """Format a row of the table: name, then MODA and IDF1 of the four."""
    batch = cf.localize(sequence.detections, sequence.scene).tracks
    now, _ = stream(sequence, rate, 0.0)
    _, late = stream(sequence, rate, 2.0)
    _, again = stream(sequence, rate, 2.0, learned=True)
    cells = [sequence.name]
    for tracks in (now, late, again, batch):
        found = score_rows(ground_rows(tracks, sequence), sequence)
        identified = "-" if found.tracking is None else f"{found.tracking.idf1:.1f}"
        cells += [f"{found.moda:.1f}", identified]
    return "| " + " | ".join(cells) + " |"


def measure_speed(instants: int, embeddings: bool) -> None:
    """Print the time per instant and the memory."""
    world = make_world("wildtrack", 1, frames=SPEED_FRAMES, people=32, background=12)
    d = world.detections
    embedding = d.embedding if embeddings else None
    boxes = cf.Detections(
        d.frame, d.camera, d.box, d.score, d.ankles_confirmed, embedding=embedding
    )
    parts = [boxes[boxes.frame == f] for f in range(SPEED_FRAMES)]
    parts += parts[-2:0:-1]
    tracker = cf.Tracker(world.scene, lag=2.0)
    seconds, memory = [], []
    for k in range(instants):
        start = time.process_time()
        tracker.update(parts[k % len(parts)], k / RATE)
        seconds.append(time.process_time() - start)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    print(f"{len(boxes) / SPEED_FRAMES / 7:.0f} boxes per camera, CPU milliseconds per instant:")
    for name, part in (("first", seconds[:WARM]), ("then", seconds[WARM:])):
        if part:
            half, most = np.percentile(part, [50, 99]) * 1e3
            print(
                f"{name} {len(part)}: median {half:.1f}, 99 % {most:.1f}, max {max(part) * 1e3:.0f}"
            )
    middle = WARM + (instants - WARM) // 2
    if instants > WARM:
        early, late = (np.median(part) * 1e3 for part in (seconds[WARM:middle], seconds[middle:]))
        print(f"median of the first and second half: {early:.1f}, {late:.1f}")
        print(f"peak memory after {WARM}, {middle}, {instants}: "
              f"{memory[WARM]:.0f}, {memory[middle]:.0f}, {memory[-1]:.0f} MB")  # fmt: skip


def main() -> None:
    """Print a Markdown table and the speed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    parser.add_argument("--worlds", type=int, nargs=2, default=(0, 0), metavar=("FIRST", "END"))
    parser.add_argument("--speed", type=int, default=0, metavar="INSTANTS")
    parser.add_argument("--embeddings", action="store_true", help="in the worlds of --speed")
    options = parser.parse_args()
    if options.data is not None or options.worlds[1]:
        kinds = ("lag 0", "lag 2 s", "lag 2 s, learned", "batch")
        print("| sequence | " + " | ".join(f"{kind}: MODA | IDF1" for kind in kinds) + " |")
        print("|---" * (1 + 2 * len(kinds)) + "|")
    if options.data is not None:
        for sequence in sequences(options.data):
            if options.only in sequence.name:
                print(compare(sequence, rate_of(sequence.name, options.data)), flush=True)
    for sequence in worlds(range(*options.worlds)):
        print(compare(sequence, RATE), flush=True)
    if options.speed:
        measure_speed(options.speed, options.embeddings)


if __name__ == "__main__":
    main()
