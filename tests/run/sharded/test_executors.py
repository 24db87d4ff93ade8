"""Any executor runs the shards; failures are named and stop nothing else."""

import multiprocessing
import os
import signal
import subprocess
import sys
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

import numpy as np
import pytest

import catfree as cf
from catfree._run.sharded import _executors as module
from catfree._worker import (
    LAST_WITH_OPTION,
    QUICK_COMPILATION,
    jaxlib_version,
    start_worker,
    worker_environment,
)
from catfree.errors import ForkedProcessError, InvalidInputError, ShardError
from catfree.synthetic import make_layout, make_world
from catfree.types import Detections
from tests.run.sharded.walks import plan_of, seen_by, walks, write

SCENE = make_layout("ring4", 0).scene


class AtOnce(Executor):
    """Run each task on submission."""

    def __init__(self):
        self.ended = False

    def submit(self, task, /, *arguments, **options):
        future = Future()
        try:
            future.set_result(task(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future

    def shutdown(self, wait=True, *, cancel_futures=False):
        self.ended = True


@pytest.fixture
def cheap(monkeypatch):
    """Make shards that take no time, with invented results."""
    rng = np.random.default_rng(0)
    whole = walks(rng, 4, 100)

    def run(shard, *, scene, out, settings, detector, embedder):
        if shard.site == "broken":
            raise InvalidInputError("The lens cap is on.")
        folder = module.recording_folder(out, shard.site, shard.date)
        folder.mkdir(parents=True, exist_ok=True)
        return write(folder, shard, seen_by(shard, whole, rng))

    monkeypatch.setattr(module, "run_shard", run)
    return plan_of(100, 50, 10)


def named(plan, site, date=""):
    return [replace(shard, site=site, date=date) for shard in plan]


@pytest.mark.slow
def test_recordings_are_joined_and_the_executor_stays_open(cheap, tmp_path):
    executor, steps = AtOnce(), []
    plan = [*named(cheap, "north", "monday"), *named(cheap, "south")]
    tables = cf.run_shards(
        plan,
        scene=SCENE,
        out=tmp_path,
        executor=executor,
        progress=lambda *step: steps.append(step),
    )
    assert [table.folder for table in tables] == [
        tmp_path / "site=north" / "date=monday",
        tmp_path / "site=south",
    ]
    assert all(len(table) and table.people == 4 for table in tables)
    assert not executor.ended
    assert steps == [("shards", done, 4) for done in range(5)]
    dataset = pytest.importorskip("pyarrow.dataset", reason="pyarrow is not installed")
    whole = dataset.dataset(tmp_path, partitioning="hive").to_table()
    assert set(whole["site"].to_pylist()) == {"north", "south"}
    assert len(whole) == sum(map(len, tables))


def test_a_failing_site_stops_no_other(cheap, tmp_path):
    plan = [*named(cheap, "broken"), *named(cheap, "north")]
    with pytest.raises(ShardError, match=r"1 of 2 recordings failed.*broken.*lens cap") as caught:
        cf.run_shards(
            plan, scene={"broken": SCENE, "north": SCENE}, out=tmp_path, executor=AtOnce()
        )
    (table,) = caught.value.finished
    assert table.people == 4


def test_shards_that_a_broken_pool_refuses_are_named_and_stop_no_other(cheap, tmp_path):
    class Breaks(AtOnce):
        """Accept the shards of one site, then lose all processes."""

        def submit(self, task, /, shard, **options):
            if shard.site == "south":
                raise BrokenProcessPool("A child process terminated abruptly.")
            return super().submit(task, shard, **options)

    plan = [*named(cheap, "north"), *named(cheap, "south")]
    with pytest.raises(ShardError, match=r"1 of 2 .* \d of 2 \(south\): its worker process died"):
        cf.run_shards(plan, scene=SCENE, out=tmp_path, executor=Breaks())
    assert cf.open_tracks(tmp_path / "site=north").people == 4


@pytest.mark.slow
def test_a_plan_of_fewer_shards_replaces_an_earlier_one(cheap, tmp_path):
    options = {"scene": SCENE, "out": tmp_path, "executor": AtOnce()}
    cf.run_shards(plan_of(100, 25, 10), **options)
    (table,) = cf.run_shards(cheap, **options)
    assert len(table.parts) == 2
    for folder in (tmp_path, tmp_path / "_shards"):
        assert {path.stem for path in folder.glob("part-*")} == {"part-00000", "part-00001"}


def test_a_part_of_a_plan_leaves_the_rest_of_it_alone(cheap, tmp_path):
    options = {"scene": SCENE, "out": tmp_path, "executor": AtOnce()}
    with pytest.raises(ShardError, match=r"1 of 2 shards of the plan are not finished \(1\)"):
        cf.run_shards(cheap[:1], **options)
    (table,) = cf.run_shards(cheap[1:], **options)
    (again,) = cf.run_shards(cheap[:1], **options)
    assert len(table.parts) == len(again.parts) == 2


@pytest.mark.slow
def test_a_plan_that_fails_leaves_an_earlier_one_alone(cheap, tmp_path, monkeypatch):
    options = {"scene": SCENE, "out": tmp_path, "executor": AtOnce()}
    (table,) = cf.run_shards(plan_of(100, 25, 10), **options)

    def run(shard, **options):
        raise InvalidInputError("This folder holds shards of another scene.")

    monkeypatch.setattr(module, "run_shard", run)
    with pytest.raises(ShardError, match="another scene"):
        cf.run_shards(cheap, **options)
    assert module.join_shards(tmp_path).parts == table.parts


def test_networks_are_for_shards_of_videos(cheap, tmp_path, monkeypatch):
    given, run = {}, module.run_shard
    detector, embedder = cf.adapters.BackgroundDetector(), cf.adapters.ColorEmbedder()

    def noting(shard, **options):
        given.setdefault(shard.site, set()).add((options["detector"], options["embedder"]))
        return run(shard, **options)

    monkeypatch.setattr(module, "run_shard", noting)
    videos = [replace(shard, videos=("a.mp4", "b.mp4")) for shard in named(cheap, "videos")]
    tables = cf.run_shards(
        [*videos, *named(cheap, "boxes")], scene=SCENE, out=tmp_path, executor=AtOnce(),
        detector=detector, embedder=embedder,
    )  # fmt: skip
    assert len(tables) == 2
    assert given == {"videos": {(detector, embedder)}, "boxes": {(None, None)}}


def test_scenes_belong_to_sites(cheap, tmp_path):
    with pytest.raises(InvalidInputError, match="no scene for site 'south'"):
        cf.run_shards(
            named(cheap, "south"), scene={"north": SCENE}, out=tmp_path, executor=AtOnce()
        )


def test_plans_are_checked(cheap, tmp_path):
    options = {"scene": SCENE, "out": tmp_path, "executor": AtOnce()}
    with pytest.raises(InvalidInputError, match="plan is empty"):
        cf.run_shards([], **options)
    with pytest.raises(InvalidInputError, match="shard 0 of 2 twice"):
        cf.run_shards([*cheap, *cheap], **options)
    with pytest.raises(InvalidInputError, match=r"concurrent.futures.Executor or a dask"):
        cf.run_shards(cheap, scene=SCENE, out=tmp_path, executor="threads")


def test_a_failing_detector_stops_no_other_site_and_its_error_is_kept(cheap, tmp_path, monkeypatch):
    run, failure = module.run_shard, RuntimeError("CUDA out of memory")

    def failing(shard, **options):
        if shard.site == "a":
            raise failure
        return run(shard, **options)

    monkeypatch.setattr(module, "run_shard", failing)
    plan = [*named(cheap, "a"), *named(cheap, "b")]
    sentence = r"shard \d of 2 \(a\): RuntimeError: CUDA out of memory"
    with pytest.raises(ShardError, match=sentence) as caught:
        cf.run_shards(plan, scene=SCENE, out=tmp_path, executor=AtOnce())
    assert len(caught.value.finished) == 1
    assert caught.value.__cause__.__cause__ is failure


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_who_tells_a_shard_to_exit_ends_the_run(cheap, tmp_path, monkeypatch, kind):
    def run(shard, **options):
        raise kind

    monkeypatch.setattr(module, "run_shard", run)
    with ThreadPoolExecutor(1) as pool, pytest.raises(kind):
        cf.run_shards(cheap, scene=SCENE, out=tmp_path, executor=pool)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_pool_that_forks_is_refused(cheap, tmp_path):
    with (
        ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as pool,
        pytest.raises(ForkedProcessError, match=r"mp_context=multiprocessing.get_context\('spawn"),
    ):
        cf.run_shards(cheap, scene=SCENE, out=tmp_path, executor=pool)


@pytest.mark.slow
def test_threads_do(tmp_path):
    world = make_world("ring4", 2, frames=60, people=3)
    plan = cf.shards(world.detections, every=6, overlap=2, frame_rate=5)
    with ThreadPoolExecutor(2) as pool:
        (table,) = cf.run_shards(plan, scene=world.true_scene, out=tmp_path, executor=pool)
        assert pool.submit(abs, -1).result() == 1
    assert len(table) > 60


def nobody(frames):
    return Detections(
        np.arange(frames), np.zeros(frames, int), np.tile([0.0, 0, 10, 30], (frames, 1))
    )


def kill_at(shard, **options):
    """Run a shard; the second shard ends its process."""
    if shard.index == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return cf.run_shard(shard, **options)


@pytest.mark.slow
def test_a_worker_that_dies_loses_no_finished_shard(tmp_path, monkeypatch):
    plan = cf.shards(nobody(100), every=10, overlap=0, frame_rate=5)
    assert len(plan) == 2
    monkeypatch.setattr(module, "run_shard", kill_at)
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(
            1, mp_context=context, initializer=start_worker, initargs=(worker_environment(),)
        ) as pool,
        pytest.raises(ShardError, match=r"shard 1 of 2: its worker process died.*__main__"),
    ):
        cf.run_shards(plan, scene=SCENE, out=tmp_path, executor=pool)
    assert [path.name for path in tmp_path.glob("_shards/part-*.json")] == ["part-00000.json"]
    monkeypatch.undo()
    (table,) = cf.run_shards(plan, scene=SCENE, out=tmp_path)  # our own spawned processes
    assert len(table.parts) == 2


def test_an_interruption_ends_a_worker_at_once_and_without_a_word(capfd):
    with module.spawned_workers(1) as pool:
        assert pool.submit(abs, -1).result() == 1
        with pytest.raises(BrokenProcessPool):
            pool.submit(signal.raise_signal, signal.SIGINT).result()
    assert capfd.readouterr().err == ""


SCRIPT = """
import os
import numpy  # as most scripts do, before a worker's own code can run
import catfree as cf
from catfree._run.sharded._executors import spawned_workers

NAMES = ("OPENBLAS_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_", "PJRT_NPROC")
AT_IMPORT = [os.environ.get(name) for name in NAMES]

def at_import():
    return AT_IMPORT

def has(environment):
    return environment.items() <= os.environ.items()

if __name__ == "__main__":
    with spawned_workers(1) as pool:
        print(*pool.submit(at_import).result(), pool.submit(has, cf.worker_environment()).result())
    print(*AT_IMPORT, AT_IMPORT == [os.environ.get(name) for name in NAMES])
"""


@pytest.mark.slow
@pytest.mark.parametrize("own", [None, "2"])
def test_workers_start_in_their_environment_and_this_process_keeps_its_own(tmp_path, own):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    environment = {k: v for k, v in os.environ.items() if k not in worker_environment()}
    if own is not None:
        environment["OPENBLAS_NUM_THREADS"] = own
    command = [sys.executable, str(script)]
    said = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    # JAX's variables are set in the worker, because this process may not have used JAX yet.
    kept = worker_environment()["MALLOC_TRIM_THRESHOLD_"]
    assert said.stdout.split() == ["1", kept, "None", "True", str(own), "None", "None", "True"]


def test_workers_get_the_flags_of_xla_that_this_process_has(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=here")
    assert worker_environment()["XLA_FLAGS"] == "--xla_dump_to=here"
    monkeypatch.delenv("XLA_FLAGS")
    quick = jaxlib_version() <= LAST_WITH_OPTION
    assert worker_environment().get("XLA_FLAGS") == (QUICK_COMPILATION if quick else None)


def test_workers_fit_the_machine():
    assert 1 <= module.default_workers() <= (os.cpu_count() or 1)


@pytest.mark.parametrize(
    ("available", "expected"), [("46000000", 31), ("4500000", 3), ("90000", 1), (None, 32)]
)
def test_workers_fit_the_available_memory_whatever_files_are_cached(
    tmp_path, monkeypatch, available, expected
):
    stated = "" if available is None else f"MemAvailable:   {available} kB\n"
    (tmp_path / "meminfo").write_text(f"MemTotal:  64000000 kB\nMemFree:    100000 kB\n{stated}")
    monkeypatch.setattr(module, "MEMORY", str(tmp_path / "meminfo"))
    monkeypatch.setattr(module, "processor_count", lambda: 32)
    assert module.default_workers() == expected
