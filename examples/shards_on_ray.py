"""Localize a long recording in shards on a Ray cluster.

`RayExecutor` turns Ray tasks into a `concurrent.futures.Executor`, which `cf.run_shards` and
`cf.run_sites` accept like any other. The recording is simulated: boxes of four cameras in a Parquet
table.

    pip install ray 'catfree[parquet]'
    python examples/shards_on_ray.py --out day
"""

import argparse
from concurrent.futures import Executor, Future
from pathlib import Path

import ray

import catfree as cf
from catfree.synthetic import make_world


class RayExecutor(Executor):
    """Run each call as a Ray task with one processor."""

    def submit(self, fn, /, *args, **kwargs) -> Future:
        """Start `fn(*args, **kwargs)` on the cluster."""
        return ray.remote(max_retries=2)(fn).remote(*args, **kwargs).future()


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

    environment = {"env_vars": cf.worker_environment()}
    ray.init(num_cpus=2, include_dashboard=False, runtime_env=environment)
    try:
        (day,) = cf.run_shards(plan, scene=world.scene, out=out, executor=RayExecutor())
    finally:
        ray.shutdown()
    print(f"{len(plan)} shards, {day.people} people, {len(day)} positions in {day.folder}")


if __name__ == "__main__":
    main()
