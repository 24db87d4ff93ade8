"""Localize a long recording in shards on a Dask cluster.

Two workers on this machine stand in for a cluster; to use a real one, pass the address of its
scheduler to `Client`. The recording is simulated: boxes of four cameras in a Parquet table.

    pip install 'catfree[distributed]'
    python examples/shards_on_dask.py --out day
"""

import argparse
from pathlib import Path

import dask
from distributed import Client, LocalCluster

import catfree as cf
from catfree.synthetic import make_world

START = "distributed.nanny.pre-spawn-environ."


def worker_settings() -> dict[str, object]:
    """Return Dask settings with which its workers are as fast as processes without it.

    By default they return memory to the system after each large array, which takes a sixth of their
    time, and pause up to 50 times per second to profile themselves.
    """
    environment = {START + name: value for name, value in cf.worker_environment().items()}
    return {
        **environment,
        "distributed.worker.profile.enabled": False,
        "distributed.worker.memory.monitor-interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
        "distributed.admin.tick.interval": "1s",
    }


def main() -> None:
    """Simulate, cut, localize and join."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("day"), help="folder for the results")
    parser.add_argument("--frames", type=int, default=3000, help="frames to simulate, 5 per second")
    parser.add_argument("--every", type=float, default=120.0, help="seconds per shard")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)

    world = make_world("ring4", frames=arguments.frames, people=6)
    boxes = cf.adapters.write_detections_parquet(out / "_boxes.parquet", world.detections)
    plan = cf.shards(boxes, every=arguments.every, overlap=10, frame_rate=5)

    with (
        dask.config.set(worker_settings()),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        (day,) = cf.run_shards(plan, scene=world.scene, out=out, executor=client)
    print(f"{len(plan)} shards, {day.people} people, {len(day)} positions in {day.folder}")


if __name__ == "__main__":  # worker processes skip this
    main()
