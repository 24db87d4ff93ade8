"""The commands for long recordings and many sites."""

import os
import shlex
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from catfree.cli._inputs import (
    Method,
    Unit,
    network_file,
    open_detector,
    open_embedder,
    open_scene,
    require_files,
    settings_of,
)
from catfree.cli._terminal import fail, print_text, progress_bars, warn
from catfree.errors import InvalidInputError, ShardError, needing, quoted

BOXES = (".npz", ".parquet")
IN_ONE_FILE = "Save the boxes to one file first: cf.read_detections(...)[0].save('boxes.npz')."


def plan(
    recording: Positional[tuple[Path, ...]],
    scene: Path,
    out: Path,
    unit: Unit = "m",
    every: float = 600.0,
    overlap: float = 20.0,
    frame_rate: float | None = None,
    offsets: tuple[int, ...] | None = None,
    silent: Path | None = None,
    detector: Path | None = None,
    embedder: Path | None = None,
    method: Method = "default",
) -> None:
    """Cut a long recording into shards and write them to a plan.

    Args:
        recording: one video file or image folder per camera, or a single file of saved boxes
            (.npz or .parquet), or a folder of Parquet files.
        scene: known cameras and ground (scene.json, or any calibration format).
        out: folder for the results; the plan is `_shards/plan.json` in it.
        unit: length of one unit of a scene whose file does not state it.
        every: seconds per shard.
        overlap: seconds that neighboring shards share.
        frame_rate: frames per second; that of the videos or of the saved boxes if not given.
        offsets: the frame of each camera that shows the first common instant.
        silent: CSV or Parquet table of missing pictures, with the columns frame and camera, for
            boxes. If the boxes are the results of a run, these already contain it; videos do not
            need it.
        detector: ONNX file of a person detector, or a name from `catfree weights list`; without it,
            people are found by background subtraction.
        embedder: ONNX file of a re-identification network, or a name from that list.
        method: the localization method.
    """
    from catfree._run.sharded._plan_file import PlanFile, write_plan
    from catfree._run.sharded._receipt import PLAN
    from catfree._run.sharded._shard import shards
    from catfree.adapters.datasets._detection_files import (
        RESULT_SILENT,
        beside_results,
        read_missing_pictures,
    )
    from catfree.adapters.files._camera_names import plain_numbers
    from catfree.types._writing import make_folder

    networks = {"detector": detector, "embedder": embedder}
    boxes = recording[0] if len(recording) == 1 and _holds_boxes(recording[0]) else None
    if boxes is None:
        require_files(recording, IN_ONE_FILE, scene=scene, **networks)
    elif detector is not None or embedder is not None:
        raise InvalidInputError(
            f"{boxes} is read as boxes, so --detector and --embedder would not be used."
        )
    known, names, warnings = _scene_for(scene, recording if boxes is None else (), unit)
    warn(warnings)  # before any shard can fail
    if silent is None and boxes is not None:
        silent = beside_results(boxes, RESULT_SILENT)
    cameras = names or plain_numbers(known.rig.camera_count)
    parts = shards(
        recording if boxes is None else boxes,
        every,
        overlap,
        frame_rate,
        offsets=offsets,
        silent=None if silent is None else read_missing_pictures(silent, cameras),
        camera_names=names,
    )
    # Beside the other working files, which readers of Parquet folders skip.
    path = out / PLAN
    make_folder(path.parent)
    # Absolute paths, because the processes of the shards may start in another folder.
    files = {
        role: "" if path is None else os.path.abspath(network_file(path))
        for role, path in networks.items()
    }
    places = (os.path.abspath(scene), os.path.abspath(out))
    document = PlanFile(parts, *places, method, unit=unit, **files)
    write_plan(path, document)
    each = shlex.join(["catfree", "shard", "--plan", str(path), "--index", "N"])
    print_text(
        f"{path} is the plan. Run `{each}` with N from 0 to {len(parts) - 1}, "
        f"then `{shlex.join(['catfree', 'join', str(out)])}`."
    )


def shard(plan: Path, index: int) -> None:
    """Localize one shard of a plan, unless it is already finished.

    Args:
        plan: the plan that `catfree plan` wrote.
        index: index of the shard, from 0.
    """
    from catfree._run.sharded._plan_file import read_plan, shard_at
    from catfree._run.sharded._run_shard import run_shard

    document = read_plan(plan)
    chosen = shard_at(document.shards, index)
    scene, _, _ = _scene_for(
        Path(document.scene), [Path(video) for video in chosen.videos], document.unit
    )
    receipt = run_shard(
        chosen,
        scene=scene,
        out=document.out,
        settings=settings_of(document.method),
        detector=open_detector(_path(document.detector)),
        embedder=open_embedder(_path(document.embedder)),
    )
    warn(receipt.warnings)
    print_text(f"Shard {index} of {receipt.count} is finished: {receipt.boxes} boxes.")


def join(out: Positional[Path]) -> None:
    """Join the finished shards of a recording into one table.

    Args:
        out: the folder that the plan named.
    """
    from catfree._run.sharded._join import join_shards

    _print_recording(join_shards(out))


def run_sites(
    sites: Positional[Path],
    out: Path,
    dask: str | None = None,
    workers: int | None = None,
) -> int:
    """Track the people of many sites: calibrate each once, run all shards, join them.

    Args:
        sites: TOML file with the recordings; see docs/long_recordings.md.
        out: folder for the results, with a folder `site=.../date=...` per recording.
        dask: address of a Dask scheduler whose workers run the shards.
        workers: processes on this machine; as many as processors and memory allow if not
            given.
    """
    from catfree._run.sharded._sites import read_sites, run_sites

    recordings, options = read_sites(sites)
    settings = settings_of(options.pop("method", "default"))
    detector = open_detector(_path(options.pop("detector", "")))
    embedder = open_embedder(_path(options.pop("embedder", "")))
    reasons: tuple[str, ...] = ()
    with _executor(dask, workers) as executor, progress_bars() as progress:
        try:
            finished = run_sites(
                recordings,
                out=out,
                settings=settings,
                detector=detector,
                embedder=embedder,
                executor=executor,
                progress=progress,
                **options,
            )
        except ShardError as error:
            finished, reasons = error.finished, error.reasons
    for recording in finished:
        _print_recording(recording)
    for reason in reasons:
        fail(reason)
    return int(bool(reasons))


def _holds_boxes(path: Path) -> bool:
    from catfree.adapters.datasets._detection_files import RESULT_BOXES

    if (path / RESULT_BOXES).is_file():  # lies beside tables of tracks
        return False
    held = path.rglob("*") if path.is_dir() else ()
    return path.suffix.lower() in BOXES or any(one.suffix.lower() == ".parquet" for one in held)


def _scene_for(
    path: Path, videos: Sequence[Path], unit: Any = "m"
) -> tuple[Any, tuple[str, ...] | None, tuple[str, ...]]:
    """Read a scene, with its cameras in the order of the videos, if there are any.

    Returns:
        The scene, the names of its cameras if boxes do not name them, and warnings.
    """
    from catfree._run._input_checks import order_like
    from catfree.adapters.files._camera_names import names_of_files

    scene, names = open_scene(path, unit)
    if not videos:
        return scene, names, ()
    ordered, warnings = order_like(scene, names, names_of_files(videos))
    return ordered, None, warnings


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def _print_recording(recording: Any) -> None:
    warned = [part for part in recording.parts if part.warnings]
    if warned:
        warn(
            [
                f"{recording.folder}: {len(warned)} of {len(recording.parts)} shards have warnings "
                f"(`warnings` in manifest.json), first {warned[0].path.name}: "
                f"{warned[0].warnings[0]}"
            ]
        )
    print_text(f"{recording.folder}: {recording.people} people, {len(recording)} positions.")


def _executor(dask: str | None, workers: int | None) -> AbstractContextManager[Any]:
    """Return the client of a Dask scheduler, or an executor of processes on this machine.

    Raises:
        MissingDependencyError: if Dask is not installed.
        InvalidInputError: if no scheduler answers, or both arguments are given.
    """
    from catfree._run.sharded._executors import spawned_workers

    if dask is None:
        return spawned_workers(workers)
    if workers is not None:
        raise InvalidInputError("--workers is for this machine alone. Leave it out with --dask.")
    with needing("--dask needs dask.distributed: pip install 'catfree[distributed]'."):
        from distributed import Client
    try:
        return Client(dask)
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"No Dask scheduler answers at {dask} ({quoted(error)}). Check the address."
        ) from error
