"""`run_shards`: run a plan on any executor, join each recording, and name the failures."""

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from pathlib import Path
from typing import Any

from catfree._run.sharded._join import join_shards
from catfree._run.sharded._receipt import recording_folder
from catfree._run.sharded._run_shard import run_shard
from catfree._run.sharded._shard import Shard, recording_name
from catfree._run.sharded._stored_tracks import StoredTracks
from catfree._worker import spawned_pool
from catfree.adapters.files._documents import StrPath
from catfree.adapters.protocols import Detector, Embedder, FittedToCamera
from catfree.errors import CatFreeError, ForkedProcessError, InvalidInputError, ShardError, quoted
from catfree.settings import Settings
from catfree.types import Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._processes import processor_count
from catfree.types._validation import as_count, as_instances, as_path, require_instance

MEMORY_PER_WORKER = 1.5e9  # bytes for a shard of ten minutes
MEMORY = "/proc/meminfo"  # of Linux
RETRIES = 2  # of a shard whose Dask worker died

RecordingKey = tuple[str, str]  # site and date


def run_shards(
    plan: Sequence[Shard],
    *,
    scene: Scene | Mapping[str, Scene],
    out: StrPath,
    settings: Settings | None = None,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    executor: Any = None,
    progress: Progress | None = None,
) -> tuple[StoredTracks, ...]:
    """Run the shards of one or many recordings and join each recording to one table.

        (day,) = cf.run_shards(cf.shards("boxes.parquet", frame_rate=5), scene=scene, out="day")

    Finished shards are not run again, so a killed call resumes where it stopped; shards of an
    earlier plan are replaced. A recording that fails does not stop the others.

    Args:
        plan: shards of one recording, as `shards` returns them, or of several recordings,
            concatenated and distinguished by `site` and `date`.
        scene: cameras and ground; one for all, or one per site.
        out: folder of the results; a shard with a site and a date goes to `site=.../date=...`.
        settings: of the localization.
        detector: as `run`, for shards of videos; shards of boxes need none.
        embedder: as `run`, for shards of videos.
        executor: a `concurrent.futures.Executor` whose processes are not forked, or a
            `dask.distributed.Client`; it is not shut down. None for spawned processes, one per
            processor if memory allows; then call from under `if __name__ == "__main__":`.
        progress: called as `progress("shards", done, total)`.

    Returns:
        The joined table of each recording, in the order of the plan.

    Raises:
        ShardError: after everything else has finished, naming each failed recording and the reason,
            including errors of detector or embedder; its attribute `finished` holds the other
            tables.
        InvalidInputError: if the plan is empty, a site has no scene, or `executor` is not
            an executor.
        ForkedProcessError: if the executor would fork its processes.
    """
    recordings = _by_recording(plan)
    scenes = {key: _scene_of(scene, key[0]) for key in recordings}
    report = as_progress(progress)
    failed: dict[RecordingKey, CatFreeError] = {}
    waiting = {key: len(parts) for key, parts in recordings.items()}
    joined: dict[RecordingKey, StoredTracks] = {}
    with executor_for(executor) as pool:
        tasks: dict[Future[Any], Shard] = {}
        for shard in plan:
            task = submitted(
                pool,
                run_shard,
                shard,
                scene=scenes[shard.site, shard.date],
                out=os.path.abspath(as_path(out, "out")),  # workers may run in another folder
                settings=settings,
                detector=detector if shard.videos else None,
                embedder=embedder if shard.videos else None,
            )
            tasks[task] = shard
        report("shards", 0, len(plan))
        try:
            for done, task in enumerate(as_completed(tasks), start=1):
                shard = tasks.pop(task)
                key = (shard.site, shard.date)
                waiting[key] -= 1
                error = error_of(task, shard.name)
                if error is not None:
                    failed.setdefault(key, error)
                elif not waiting[key] and key not in failed:
                    try:
                        joined[key] = join_shards(recording_folder(out, *key), recordings[key])
                    except CatFreeError as reason:
                        failed[key] = reason
                report("shards", done, len(plan))
        except BaseException:
            for task in tasks:
                task.cancel()
            raise
    finished = tuple(joined[key] for key in recordings if key in joined)
    if failed:
        reasons = tuple(_reason(*key, error) for key, error in failed.items())
        several = f"{len(failed)} of {len(recordings)} recordings failed. "
        message = (several if len(recordings) > 1 else "") + " ".join(reasons)
        raise ShardError(message, finished, reasons) from next(iter(failed.values()))
    return finished


def submitted(
    pool: Executor, function: Callable[..., Any], *arguments: Any, **options: Any
) -> Future[Any]:
    """Submit a task, which fails at once if the executor's processes have died."""
    try:
        return pool.submit(function, *arguments, **options)
    except BrokenExecutor as error:
        task: Future[Any] = Future()
        task.set_exception(error)
        return task


@contextlib.contextmanager
def executor_for(executor: Any) -> Iterator[Executor]:
    """Yield the given executor, that of a Dask client, or one of spawned processes.

    Args:
        executor: as `run_shards`.

    Raises:
        InvalidInputError: if `executor` is neither.
        ForkedProcessError: if the executor would fork its processes.
    """
    if executor is None:
        with spawned_workers() as pool:
            yield pool
    elif isinstance(executor, Executor):
        require_not_forking(executor)
        yield executor
    elif callable(getattr(executor, "get_executor", None)):
        yield executor.get_executor(pure=False, retries=RETRIES)
    else:
        raise InvalidInputError(
            "executor must be a concurrent.futures.Executor or a dask.distributed.Client, got "
            f"{type(executor).__name__}."
        )


def spawned_workers(count: int | None = None) -> contextlib.AbstractContextManager[Executor]:
    """Open an executor of spawned processes; see `spawned_pool`.

    Args:
        count: maximum number of processes; None for as many as processors and memory allow.

    Raises:
        InvalidInputError: if `count` is less than 1.
    """
    return spawned_pool(default_workers() if count is None else as_count(count, "workers", least=1))


def require_not_forking(executor: Executor) -> None:
    """Raise if an executor forks its processes, in which JAX would hang."""
    context = getattr(executor, "_mp_context", None)
    if context is not None and context.get_start_method() == "fork":
        raise ForkedProcessError(
            "This executor forks its processes, in which JAX would wait forever: pass "
            "mp_context=multiprocessing.get_context('spawn') to it."
        )


def default_workers() -> int:
    """Return the number of worker processes that processors and available memory allow.

    Memory that holds copies of files is available, though not free.
    """
    processors = processor_count()
    try:
        lines = dict(line.split(":") for line in Path(MEMORY).read_text().splitlines())
        available = 1024 * int(lines["MemAvailable"].split()[0])
    except (OSError, ValueError, LookupError):  # not known on this system
        return processors
    return max(1, min(processors, int(available / MEMORY_PER_WORKER)))


def error_of(task: Future[Any], name: str) -> CatFreeError | None:
    """Return why a task failed, in one sentence that names the task, or None.

    Raises:
        BaseException: if the task was told to exit.
    """
    error = task.exception()
    if error is None:
        return None
    if isinstance(error, CatFreeError):
        reason = type(error)(f"{name}: {error}")
    elif isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
        reason = CatFreeError(
            f"{name}: its worker process died; it was killed or ran out of memory, or a script "
            "starts it without `if __name__ == '__main__':`. Run again: finished shards are kept."
        )
    elif isinstance(error, Exception):  # user detectors and embedders may raise anything
        reason = CatFreeError(f"{name}: {type(error).__name__}: {error}")
    else:
        raise error
    reason.__cause__ = error
    return reason


def _by_recording(plan: Sequence[Shard]) -> dict[RecordingKey, list[Shard]]:
    recordings: dict[RecordingKey, list[Shard]] = {}
    for shard in as_instances(plan, Shard, "plan"):
        recordings.setdefault((shard.site, shard.date), []).append(shard)
    if not recordings:
        raise InvalidInputError("The plan is empty. Make one with cf.shards.")
    for (site, date), parts in recordings.items():
        indices = [shard.index for shard in parts]
        if len(set(indices)) < len(indices):
            raise InvalidInputError(
                f"The plan has {parts[0].name} twice, from different recordings or the same one. "
                f"Give each recording its own site or date (here {quoted(site)}, {quoted(date)})."
            )
    return recordings


def _scene_of(scene: Scene | Mapping[str, Scene], site: str) -> Scene:
    if isinstance(scene, Scene):
        return scene
    require_instance(scene, Mapping, "scene")
    if site not in scene:
        raise InvalidInputError(f"There is no scene for site {quoted(site)}. Add it to the scenes.")
    return scene[site]


def _reason(site: str, date: str, error: CatFreeError) -> str:
    where = recording_name(site, date)
    return f"{where}: {error}" if where not in str(error) else str(error)
