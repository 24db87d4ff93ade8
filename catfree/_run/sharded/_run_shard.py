"""`run_shard`: localize one shard and write its positions, once."""

import dataclasses
import hashlib
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from catfree._run._cache import content_key, save_value
from catfree._run._run import run_stages
from catfree._run._stages import everywhere, localize_people
from catfree._run._stitch import learn_fragments
from catfree._run.sharded._identities import ShardSummary
from catfree._run.sharded._receipt import (
    SCENE_FILE,
    SCHEMA,
    WORK_FOLDER,
    Receipt,
    ShardFiles,
    files_of,
    finished_receipt,
    recording_folder,
    write_receipt,
)
from catfree._run.sharded._shard import (
    Shard,
    boxes_of_shard,
    open_shard_videos,
    silent_pictures,
)
from catfree.adapters.calibration_files._rig_json import scene_text
from catfree.adapters.files._camera_names import names_of_files
from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.files._fingerprint import hash_file
from catfree.adapters.protocols import Detector, Embedder, FittedToCamera
from catfree.adapters.tables._parquet import write_parquet
from catfree.calibration import Verdict, check
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene, Tracks
from catfree.types._processes import require_own_process
from catfree.types._scene import require_scene
from catfree.types._validation import require_instance, shown_camera
from catfree.types._writing import make_folder
from catfree.types.results._arrow_table import require_pyarrow

if TYPE_CHECKING:
    import pyarrow

PLACES = ("design_sigma", "whole_views")  # columns that the joined table lacks


def run_shard(
    shard: Shard,
    *,
    scene: Scene,
    out: StrPath,
    settings: Settings | None = None,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
) -> Receipt:
    """Localize the people of one shard, unless it is already finished.

    Shards may run in any order, concurrently and repeatedly. The receipt is written last, so a
    killed shard has none and runs again.

    Args:
        shard: one of those that `shards` returned.
        scene: cameras and ground, the same for all shards of a recording.
        out: folder of the results; the shard writes to `_shards` in it, or in
            `site=.../date=...` if it has a site and a date.
        settings: of the localization.
        detector: as `run`, for shards of videos.
        embedder: as `run`, for shards of videos.

    Returns:
        The receipt.

    Raises:
        InvalidInputError: if the recording changed since the plan was made, boxes name a camera
            that the scene does not have, or `out` holds shards of another scene.
        FileFormatError: if an input file is damaged.
        WriteError: if the disk is full or not writable.
        ForkedProcessError: in a process forked after JAX was used.
        MissingDependencyError: if pyarrow is not installed.
    """
    require_own_process()
    require_pyarrow()  # fail before the long computation
    require_instance(shard, Shard, "shard")
    require_scene(scene)
    settings = Settings() if settings is None else settings
    require_instance(settings, Settings, "settings")
    if not shard.videos and (detector is not None or embedder is not None):
        raise InvalidInputError(
            f"The {shard.name} consists of boxes, so detector and embedder would not be used."
        )
    run = run_fingerprint(scene, settings, detector, embedder)
    folder = recording_folder(out, shard.site, shard.date)
    files = files_of(folder, shard.index)
    finished = finished_receipt(files, shard, run)
    if finished is not None:
        return finished
    names = names_of_files(list(map(Path, shard.videos))) or shard.camera_names or None
    scene_file = _write_scene(folder, scene, names)
    begin = time.perf_counter()
    # The working area is relative to all positions of the recording, so joining decides on it.
    wide = everywhere(settings)
    if shard.videos:
        detections, localization = _from_videos(shard, scene, wide, detector, embedder)
    else:
        detections = boxes_of_shard(shard)
        localization = localize_people(
            detections, scene, wide, silent_pictures(shard), camera_names=names
        )
    verdicts, warnings = _verdicts(detections, localization, scene, settings, names)
    localization = dataclasses.replace(localization, warnings=(*localization.warnings, *warnings))
    seconds = time.perf_counter() - begin
    return write_shard(
        files, shard, detections, localization, settings, run=run, scene_file=scene_file,
        seconds=seconds, verdicts=verdicts,
    )  # fmt: skip


def write_shard(
    files: ShardFiles,
    shard: Shard,
    detections: Detections,
    localization: Localization,
    settings: Settings,
    *,
    run: str,
    scene_file: str,
    seconds: float,
    verdicts: tuple[str, ...] = (),
) -> Receipt:
    """Write positions, summary and, last, the receipt of a shard.

    Args:
        files: paths of the files.
        shard: the shard.
        detections: all boxes that the shard uses.
        localization: result for the boxes.
        settings: settings of the localization.
        run: the result of `run_fingerprint`.
        scene_file: SHA-256 of the scene's file.
        seconds: duration of the localization.
        verdicts: verdict on each camera.

    Raises:
        WriteError: if the disk is full or not writable.
    """
    files.receipt.unlink(missing_ok=True)  # of an earlier run, whose files are about to be replaced
    tracks, reliability = localization.tracks, localization.reliability
    write_parquet(files.part, with_places(tracks))
    reported = tracks[(tracks.frame >= shard.first) & (tracks.frame < shard.stop)]
    is_reported = (detections.frame >= shard.first) & (detections.frame < shard.stop)
    shown = np.where(is_reported, localization.identity, -1)
    save_value(files.fragments, ShardSummary(*learn_fragments(reported, detections, shown)))
    receipt = Receipt(
        schema=SCHEMA,
        index=shard.index,
        count=shard.count,
        first=shard.first,
        stop=shard.stop,
        first_seen=shard.first_seen,
        stop_seen=shard.stop_seen,
        shard=shard.fingerprint,
        source=shard.source,
        run=run,
        settings=dataclasses.asdict(settings),
        clock=dataclasses.asdict(shard.clock),
        scene_file=scene_file,
        part=hash_file(files.part),
        fragments=hash_file(files.fragments),
        boxes=len(detections),
        cameras=tuple(np.unique(detections.camera).tolist()),
        boxes_used=_or_none(reliability.detections_used),
        expected_moda=_or_none(reliability.expected_moda),
        median_sigma=_or_none(reliability.median_sigma),
        person_height=_person_height(localization, settings),
        seconds=round(seconds, 3),
        warnings=localization.warnings,
        verdicts=verdicts,
    )
    write_receipt(files.receipt, receipt)
    return receipt


def with_places(tracks: Tracks) -> "pyarrow.Table":
    """Make a table of tracks that includes how well the rig sees people there (`PLACES`)."""
    arrow = require_pyarrow()
    table = tracks.to_arrow()
    for name in PLACES:
        values = getattr(tracks, name)
        unknown = arrow.nulls(len(tracks), arrow.float64())
        table = table.append_column(
            name, unknown if values is None else arrow.array(values.astype(np.float64))
        )
    return table


def run_fingerprint(
    scene: Scene,
    settings: Settings,
    detector: Any = None,
    embedder: Any = None,
) -> str:
    """Hash everything that all shards share: scene, settings, networks and code."""
    return content_key("run", scene=scene, settings=settings, detector=detector, embedder=embedder)


def _verdicts(
    detections: Detections,
    localization: Localization,
    scene: Scene,
    settings: Settings,
    camera_names: Sequence[str] | None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return verdicts on the cameras, and sentences on those that are moved, late or dead."""
    try:
        checked = check(
            scene, detections, settings=settings, localization=localization,
            camera_names=camera_names,
        )  # fmt: skip
    except InsufficientDataError:
        return (), ()
    fine = (Verdict.FITS, Verdict.DOUBTFUL)
    warnings = [
        f"Camera {shown_camera(one.camera, camera_names)} is {one.verdict.value}. {one.advice}"
        for one in checked.cameras
        if one.verdict not in fine
    ]
    return tuple(one.verdict.value for one in checked.cameras), tuple(warnings)


def _from_videos(
    shard: Shard,
    scene: Scene,
    settings: Settings,
    detector: Detector | FittedToCamera | None,
    embedder: Embedder | None,
) -> tuple[Detections, Localization]:
    try:
        videos = open_shard_videos(shard)
        outcome = run_stages(videos, detector, embedder, scene=scene, settings=settings)
    except InsufficientDataError as error:  # for instance while a camera was down
        nobody = Detections([], [], np.zeros((0, 4)), clock=shard.clock)
        empty = localize_people(nobody, scene, settings)
        return nobody, dataclasses.replace(empty, warnings=(str(error),))
    return outcome.detections, outcome.localization


def _write_scene(folder: Path, scene: Scene, camera_names: Sequence[str] | None) -> str:
    """Write the scene and camera names beside the receipts; return the SHA-256 of the file.

    Raises:
        InvalidInputError: if the folder holds shards of another scene.
    """
    make_folder(folder / WORK_FOLDER)
    path = folder / SCENE_FILE
    existing = hash_file(path) if path.is_file() else None
    named = camera_names is not None and len(camera_names) == scene.rig.camera_count
    content = scene_text(scene, camera_names if named else None)
    written = hashlib.sha256(content.encode()).hexdigest()
    if existing not in (None, written):
        raise InvalidInputError(
            f"{folder} holds shards of another scene ({path}). Name another folder."
        )
    if existing is None:
        write_text_atomically(path, content)
    return written


def _person_height(localization: Localization, settings: Settings) -> float | None:
    """Return H0 of the evidence method, in scene units."""
    reliability = localization.reliability
    if localization.tracks.design_sigma is None or not reliability.sigma_over_radius > 0:
        return None
    return (
        reliability.median_sigma / reliability.sigma_over_radius / settings.evidence.report_radius
    )


def _or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
