"""Measure long recordings in shards: `python -m benchmarks.day --hours 24`.

Boxes of four simulated cameras at five frames per second are made in stretches, run in shards by
two processes, and joined. Prints the throughput, the memory of a worker, how many people keep one
identity over all shards that they cross and, for the first hour, the difference from one run
without shards. `--dask` compares two Dask workers with one process on the same shards.
"""

import argparse
import os
import resource
import shutil
import time
from pathlib import Path

import numpy as np

import catfree as cf
from catfree._run._stages import localize_people
from catfree._run.sharded._executors import spawned_workers
from catfree.adapters import read_detections_parquet, write_detections_parquet
from catfree.evaluation import crop, detection_metrics, tracking_metrics
from catfree.evaluation._position_matching import matched_rows
from catfree.evaluation._rows import read_sequence
from catfree.synthetic import DetectorModel, make_layout, make_world
from catfree.types import Detections

RATE = 5
STRETCH = 5_000  # frames to simulate at a time; not a multiple of a shard's length
LAYOUT = make_layout("ring4", 0)


def simulate(folder: str, stretch: int, frames: int, people: int, embedding: int) -> None:
    """Write the boxes and the truth of one stretch, whose people leave at its end."""
    first, count = stretch * STRETCH, min(STRETCH, frames - stretch * STRETCH)
    boxes, truth = (Path(folder) / kind / f"{stretch:04d}" for kind in ("boxes", "truth"))
    if truth.with_suffix(".npy").exists():
        return
    model = DetectorModel(embedding_size=embedding)
    world = make_world(LAYOUT, stretch, frames=count, people=people, detector=model)
    d = world.detections
    embedding_ = None if d.embedding is None else d.embedding.astype(np.float32)
    moved = Detections(d.frame + first, d.camera, d.box, d.score, embedding=embedding_)
    write_detections_parquet(boxes.with_suffix(".parquet"), moved)
    rows = world.ground_truth + np.array([first, 100_000 * stretch, 0, 0])
    np.save(truth.with_suffix(".npy"), rows)


def peak_memory(_: int) -> tuple[int, float]:
    """Return the process id and its peak memory in GB."""
    time.sleep(0.5)  # so each worker gets a task
    return os.getpid(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def kept_identity(truth: np.ndarray, rows: np.ndarray, cuts: np.ndarray) -> tuple[int, int]:
    """Count people who cross a cut, and those with one identity in all their shards."""
    sequence = read_sequence(truth, rows, np.unique(truth[:, 0]), identified=True)
    at, found = matched_rows(sequence, 0.5)
    person, frame = truth[at, 1].astype(int), truth[at, 0]
    shard, identity = np.searchsorted(cuts, frame, side="right"), rows[found, 1].astype(int)
    crossing = kept = 0
    for one in np.unique(person):
        mine = person == one
        names = set()
        for part in np.unique(shard[mine]):
            values, count = np.unique(identity[mine & (shard == part)], return_counts=True)
            names.add(int(values[count.argmax()]))
        if len(np.unique(shard[mine])) > 1:
            crossing += 1
            kept += len(names) == 1
    return crossing, kept


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--embedding", type=int, default=16)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("benchmark_day"))
    parser.add_argument("--whole", type=float, default=1.0, help="hours of the run without shards")
    parser.add_argument("--dask", action="store_true")
    options = parser.parse_args()
    frames = int(options.hours * 3600 * RATE)
    for kind in ("boxes", "truth"):
        (options.folder / kind).mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    with spawned_workers(options.workers) as pool:
        stretches = range(-(-frames // STRETCH))
        tasks = [
            pool.submit(simulate, str(options.folder), s, frames, options.people, options.embedding)
            for s in stretches
        ]
        for task in tasks:
            task.result()
    print(f"simulated {options.hours:g} h in {time.perf_counter() - begin:.0f} s", flush=True)
    plan = cf.shards(options.folder / "boxes", frame_rate=RATE)

    def run(name: str, executor: object) -> float:
        out = options.folder / name
        shutil.rmtree(out, ignore_errors=True)
        begin = time.perf_counter()
        cf.run_shards(plan, scene=LAYOUT.scene, out=out, executor=executor)
        return time.perf_counter() - begin

    with spawned_workers(options.workers) as pool:
        seconds = run("day", pool)
        memory = dict(pool.map(peak_memory, range(2 * options.workers)))
    print(
        f"{len(plan)} shards, {options.workers} workers: {seconds:.0f} s, "
        f"{options.hours * 3600 / seconds:.1f} times real time; most memory of a worker "
        f"{max(memory.values()):.2f} GB, of this process {peak_memory(0)[1]:.2f} GB",
        flush=True,
    )
    stored = cf.open_tracks(options.folder / "day")
    print(f"{len(stored)} positions of {stored.people} identities", flush=True)
    cuts = np.array([part.stop for part in stored.parts[:-1]])
    crossing = kept = 0
    for s in stretches:
        truth = np.load(options.folder / "truth" / f"{s:04d}.npy")
        first, last = truth[:, 0].min(), truth[:, 0].max()
        rows = crop(stored.between(first / RATE, (last + 1) / RATE).to_rows(), LAYOUT.area)
        more = kept_identity(truth, rows, cuts)
        crossing, kept = crossing + more[0], kept + more[1]
    print(f"{kept} of {crossing} people who cross shards keep one identity", flush=True)
    if options.whole:
        compare(options.folder, min(options.whole, options.hours), stored)
    if options.dask:
        from dask import config
        from dask.distributed import Client, LocalCluster

        from examples.shards_on_dask import worker_settings

        with spawned_workers(1) as pool:
            one = run("one", pool)
        with (
            config.set(worker_settings()),
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            two = run("dask", client)
        same = all(
            (options.folder / "one" / part.path.name).read_bytes()
            == (options.folder / "dask" / part.path.name).read_bytes()
            for part in stored.parts
        )
        print(f"one process {one:.0f} s, two Dask workers {two:.0f} s: {one / two:.2f} times; ")
        print(f"the same table to the byte: {same}")


def compare(folder: Path, hours: float, stored: cf.StoredTracks) -> None:
    """Print the scores of the first hours with and without shards."""
    stop = int(hours * 3600 * RATE)
    boxes = read_detections_parquet(folder / "boxes", 0, stop)
    begin = time.perf_counter()
    whole = localize_people(boxes, LAYOUT.scene, cf.Settings()).tracks
    seconds = time.perf_counter() - begin
    truth = np.concatenate([np.load(path) for path in sorted((folder / "truth").glob("*.npy"))])
    truth, frames = truth[truth[:, 0] < stop], np.arange(stop)
    print(f"the first {hours:g} h without shards: {3600 * hours / seconds:.1f} times real time")
    for name, tracks in (("without", whole), ("with", stored.between(0, stop / RATE))):
        rows = crop(tracks.to_rows(), LAYOUT.area)
        moda = detection_metrics(truth, rows, frames).moda
        idf1 = tracking_metrics(truth, rows, frames).idf1
        print(f"{name} shards: MODA {moda:.2f}, IDF1 {idf1:.2f}", flush=True)


if __name__ == "__main__":
    main()
