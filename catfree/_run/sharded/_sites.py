"""`run_sites`: calibrate each site once, then run the shards of all of them."""

import dataclasses
import os
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree._run._input_checks import Recording, open_recording, order_like
from catfree._run._stages import calibrate_cameras
from catfree._run.sharded._executors import error_of, executor_for, run_shards, submitted
from catfree._run.sharded._plan_file import METHODS
from catfree._run.sharded._receipt import recording_folder
from catfree._run.sharded._shard import (
    Shard,
    boxes_of_shard,
    open_shard_videos,
    recording_name,
    require_folder_name,
    require_recording,
    shards,
    silent_pictures,
)
from catfree._run.sharded._stored_tracks import StoredTracks
from catfree.adapters.background._background_detector import BackgroundDetector
from catfree.adapters.calibration_files._rig_json import (
    read_scene_json,
    write_scene_json,
)
from catfree.adapters.datasets._detection_files import CameraBoxes, read_missing_pictures
from catfree.adapters.datasets._scene_files import METERS, Unit, read_scene
from catfree.adapters.files._camera_names import names_of_files, numbered_names, plain_numbers
from catfree.adapters.files._documents import StrPath
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.files._toml import read_toml
from catfree.adapters.protocols import Detector, Embedder, FittedToCamera
from catfree.adapters.video._detect_videos import detect_videos
from catfree.calibration import read_anchors
from catfree.calibration.people import Anchor
from catfree.calibration.people._register import camera_sizes
from catfree.errors import (
    CalibrationError,
    CatFreeError,
    FileFormatError,
    InsufficientDataError,
    InvalidInputError,
    ShardError,
    quoted,
)
from catfree.settings import Settings
from catfree.types import Detections, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._validation import as_instances, as_number, as_path, as_pictures
from catfree.types._writing import make_folder

MOST_TRIES = 4  # stretches of a recording to try for calibration
CALIBRATION_SECONDS = 300.0
_LARGEST_LIST = 2**20  # characters; one recording needs a few hundred
_MOST_DOTS = 16  # per line: one recording needs one, in the frame rate

# For each key, converts a TOML value, given its name for messages.
Readers = dict[str, Callable[[Any, str], Any]]


@dataclass(frozen=True)
class Site:
    """A recording of one site.

    Attributes:
        name: name of the site, for the folder `site=NAME`.
        recording: one video file or image folder per camera, or the path of saved boxes.
        date: of the recording, for the folder `date=DATE`; empty for none.
        scene: known cameras and ground, or their file; None to find them from the people.
        image_size: (C, 2) width and height of each camera's images in pixels; needed to find the
            cameras from saved boxes.
        frame_rate: frames per second of saved boxes, or of images without times.
        anchors: independent measurements of the site if its cameras are found from the people, as
            for `calibrate`, or a JSON file for `read_anchors`.
        silent: for saved boxes, frame and camera number of missing pictures, or a CSV or Parquet
            table with these columns, in which cameras may be named as in the scene.
        unit: length of one unit of a scene whose file does not state it, as for `read_scene`; None
            for meters.
    """

    name: str
    recording: tuple[str, ...] | str
    date: str = ""
    scene: Scene | str | None = None
    image_size: tuple[tuple[int, int], ...] | None = None
    frame_rate: float | int | None = None
    anchors: tuple[Anchor, ...] | str = ()
    silent: tuple[tuple[int, int], ...] | str = ()
    unit: Unit | None = None


def run_sites(
    sites: Sequence[Site],
    *,
    out: StrPath,
    every: float | int = 600.0,
    overlap: float | int = 20.0,
    settings: Settings | None = None,
    detector: Detector | FittedToCamera | None = None,
    embedder: Embedder | None = None,
    executor: Any = None,
    progress: Progress | None = None,
) -> tuple[StoredTracks, ...]:
    """Track the people of many sites: calibrate each once, run all shards, join each recording.

    A site that fails does not stop the others. Finished calibrations and shards are not repeated.

    Args:
        sites: the recordings; recordings of one site, distinguished by their dates, share its
            cameras, in one call or in several with the same `out`.
        out: folder of the results, with a folder `site=.../date=...` per recording, which readers
            of Parquet folders interpret as columns.
        every: seconds per shard.
        overlap: seconds that neighboring shards share.
        settings: of calibration and localization.
        detector: as `run`, for videos.
        embedder: as `run`, for videos.
        executor: as `run_shards`.
        progress: called as `progress("calibration", done, total)`, then with "shards".

    Returns:
        The joined table of each recording, in the order of `sites`.

    Raises:
        ShardError: after everything else has finished, naming each failed site and the reason; its
            attribute `finished` holds the other tables.
        InvalidInputError: if a recording is neither videos nor boxes, two have the same name and
            date, one site has two scenes, units or lists of anchors, or as `run_shards`.
    """
    sites = as_instances(sites, Site, "sites")
    names = [(site.name, site.date) for site in sites]
    for name in names:
        if not name[0] or names.count(name) > 1:
            raise InvalidInputError(
                f"Each recording needs its own name and date; {name} is empty or used twice."
            )
        require_folder_name(name[0], "name")
        require_folder_name(name[1], "date")
    for site in sites:
        require_recording(site.recording, f"The recording of site {quoted(site.name)}")
    if not sites:
        raise InvalidInputError("There are no sites to run.")
    for field, kind in (("scene", "scenes"), ("anchors", "lists of anchors"), ("unit", "units")):
        sites = _shared(sites, field, kind)
    # Workers may run in another folder.
    sites = [
        dataclasses.replace(
            site,
            recording=_absolute(site.recording),
            anchors=_absolute(site.anchors),
            silent=_absolute(site.silent),
        )
        for site in sites
    ]
    with executor_for(executor) as pool:
        scenes, camera_names, failed = _scenes(
            sites, out, settings, detector, pool, as_progress(progress)
        )
        reasons = [f"{name}: {error}" for name, error in failed.items()]
        cause: CatFreeError | None = next(iter(failed.values()), None)
        plan: list[Shard] = []
        for site in sites:
            if site.name in failed:
                continue
            try:
                names = camera_names.get(site.name)
                silent = _silent(site, names or plain_numbers(scenes[site.name].rig.camera_count))
                plan += shards(
                    site.recording, every, overlap, site.frame_rate, silent=silent,
                    site=site.name, date=site.date, camera_names=names,
                )  # fmt: skip
            except CatFreeError as error:
                reasons.append(f"{recording_name(site.name, site.date)}: {error}")
                cause = error
        finished: tuple[StoredTracks, ...] = ()
        if plan:
            try:
                finished = run_shards(
                    plan,
                    scene=scenes,
                    out=out,
                    settings=settings,
                    detector=detector,
                    embedder=embedder,
                    executor=pool,
                    progress=progress,
                )
            except ShardError as error:
                finished, cause = error.finished, error
                reasons += error.reasons
    if reasons:
        raise ShardError(
            f"{len(finished)} of {len(sites)} recordings are complete. " + " ".join(reasons),
            finished,
            tuple(reasons),
        ) from cause
    return finished


def _shared(sites: Sequence[Site], field: str, kind: str) -> list[Site]:
    """Give all dates of a site the value of a field that is set for some."""
    by_site: dict[str, Any] = {}
    for site in sites:
        value = getattr(site, field)
        if value is None or value == ():
            continue
        first = by_site.setdefault(site.name, value)
        same = first is value if isinstance(value, Scene) else first == value
        if not same:
            raise InvalidInputError(
                f"Site {quoted(site.name)} has two {kind}. Give all its dates the same one, or its "
                "cameras another name after they were moved."
            )
    return [
        dataclasses.replace(site, **{field: by_site[site.name]}) if site.name in by_site else site
        for site in sites
    ]


def _absolute(value: Any) -> Any:
    """Make a path, or each path of a list, absolute; return anything else unchanged."""
    if isinstance(value, list | tuple):
        return tuple(map(_absolute, value))
    is_path = isinstance(value, str | os.PathLike)
    return os.path.abspath(os.path.expanduser(value)) if is_path else value


def _silent(site: Site, camera_names: Sequence[str]) -> Int[np.ndarray, "k 2"] | None:
    """Return (K, 2) frame and camera of a site's missing pictures; None if it states none."""
    if isinstance(site.silent, str):
        return read_missing_pictures(site.silent, camera_names)
    return as_pictures(site.silent) if site.silent else None


def read_sites(path: StrPath) -> tuple[tuple[Site, ...], dict[str, Any]]:
    """Read a list of sites from a TOML file.

        every = 600
        method = "default"
        [[site]]
        name = "north"
        date = "2026-11-20"
        videos = ["north/a.mp4", "north/b.mp4"]
        scene = "north/scene.json"

    Args:
        path: the file. Each `[[site]]` has a `name`, either `videos` or `detections` (a file of
            saved boxes) and optionally `date`, `scene`, `image_size`, `frame_rate`, `anchors`,
            `silent` (files) and `unit` as in `Site`; paths are relative to the file. The options
            `every`, `overlap`, `method`, `detector` and `embedder` (ONNX files) apply to all sites.

    Returns:
        The sites, and the options in the file.

    Raises:
        InvalidInputError: if the file does not exist.
        FileFormatError: if the file is not such a list, naming the key.
    """
    source = as_path(path, "path")
    document = read_toml(source, "list of sites", largest=_LARGEST_LIST, dots=_MOST_DOTS)

    def place(value: Any, name: str) -> str:
        return str(source.parent / os.path.expanduser(_text(value, name)))

    def places(value: Any, name: str) -> tuple[str, ...]:
        return tuple(place(one, name) for one in _list(value, name))

    of_file: Readers = {
        "every": as_number, "overlap": as_number, "method": _one_of(METHODS), "detector": place,
        "embedder": place, "site": _list,
    }  # fmt: skip
    of_site: Readers = {
        "name": _text, "date": _date, "videos": places, "detections": place, "scene": place,
        "image_size": _sizes, "frame_rate": as_number, "anchors": place, "silent": place,
        "unit": _one_of(METERS),
    }  # fmt: skip
    options = _values(document, of_file, source, "the file")
    sites = []
    for index, row in enumerate(options.pop("site", [])):
        values = _values(row, of_site, source, f"site {index}")
        recordings = [values.pop(key) for key in ("videos", "detections") if key in values]
        if "name" not in values or len(recordings) != 1:
            raise FileFormatError(
                f"{source}: site {index} needs a name and either videos or detections."
            )
        sites.append(Site(recording=recordings[0], **values))
    if not sites:
        raise FileFormatError(f"{source} has no [[site]].")
    return tuple(sites), options


def _values(row: Any, readers: Readers, source: Path, where: str) -> dict[str, Any]:
    """Read the values of one table of the file, each with the reader of its key."""
    if not isinstance(row, dict):
        raise FileFormatError(f"{source}: {where} must be a table, got {quoted(row)}.")
    for key in row:
        if key not in readers:
            known = ", ".join(readers)
            raise FileFormatError(f"{source}: {where} has no key {quoted(key)}; it has {known}.")
    try:
        return {key: readers[key](value, f"{key} of {where}") for key, value in row.items()}
    except InvalidInputError as error:
        raise FileFormatError(f"{source}: {error}") from error


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise InvalidInputError(f"{name} is {quoted(value)}; it must be text.")
    return value


def _date(value: Any, name: str) -> str:
    return str(value) if isinstance(value, date) else _text(value, name)


def _list(value: Any, name: str) -> list[Any]:
    if not isinstance(value, list):
        raise InvalidInputError(f"{name} is {quoted(value)}; it must be a list.")
    return value


def _sizes(value: Any, name: str) -> tuple[tuple[int, int], ...]:
    pairs = _list(value, name)
    if not all(isinstance(pair, list) and list(map(type, pair)) == [int, int] for pair in pairs):
        raise InvalidInputError(f"{name} must list width and height of each camera.")
    return tuple((width, height) for width, height in pairs)


def _one_of(known: Collection[str]) -> Callable[[Any, str], str]:
    def read(value: Any, name: str) -> str:
        if _text(value, name) not in known:
            raise InvalidInputError(f"{name} is {quoted(value)}, not of {', '.join(known)}.")
        return value

    return read


def _scenes(
    sites: Sequence[Site],
    out: StrPath,
    settings: Settings | None,
    detector: Detector | FittedToCamera | None,
    pool: Executor,
    progress: Progress,
) -> tuple[dict[str, Scene], dict[str, Sequence[str] | None], dict[str, CatFreeError]]:
    """Read or find the scene of each site, in parallel.

    Returns:
        The scenes, the camera names that their files give for boxes, and why sites failed.
    """
    failed: dict[str, CatFreeError] = {}
    scenes: dict[str, Scene] = {}
    names: dict[str, Sequence[str] | None] = {}
    tasks: dict[Any, str] = {}
    for site in sites:
        if site.name in failed or site.name in tasks.values():
            continue
        try:
            if site.scene is None:
                folder = os.path.abspath(as_path(out, "out"))
                task = submitted(pool, calibrate_site, site, folder, settings, detector)
                tasks[task] = site.name
            elif isinstance(site.scene, Scene):
                scenes[site.name] = site.scene
            else:
                scene, names[site.name] = _read_scene(site.scene, site)
                first = scenes.setdefault(site.name, scene)
                if not np.array_equal(first.rig.centers, scene.rig.centers, equal_nan=True):
                    raise InvalidInputError(
                        f"The videos of {recording_name(site.name, site.date)} do not show the "
                        "same cameras in the same order as those of its other dates. List them in "
                        "the same order."
                    )
        except CatFreeError as error:
            failed[site.name] = error
    if tasks:
        progress("calibration", 0, len(tasks))
    for done, task in enumerate(as_completed(list(tasks)), start=1):
        error = error_of(task, "calibration")
        if error is not None:
            failed[tasks[task]] = error
        else:
            scenes[tasks[task]] = task.result()
        progress("calibration", done, len(tasks))
    return scenes, names, failed


def _read_scene(path: str, site: Site) -> tuple[Scene, Sequence[str] | None]:
    """Read the scene of a site, with cameras in the order of the videos, and their names.

    Raises:
        InvalidInputError: if cameras and videos cannot be matched by name.
    """
    scene, names = read_scene(path, unit=site.unit or "m")
    if names is None or isinstance(site.recording, str):
        return scene, names
    ordered, warnings = order_like(scene, names, names_of_files([Path(p) for p in site.recording]))
    if warnings and ordered is scene:
        raise InvalidInputError(
            f"{path} names its cameras {', '.join(names)}, but the videos of {quoted(site.name)} "
            "have other names. Name the files after the cameras, so that none is mistaken for "
            "another."
        )
    return ordered, None


def calibrate_site(
    site: Site,
    out: StrPath,
    settings: Settings | None = None,
    detector: Detector | FittedToCamera | None = None,
) -> Scene:
    """Find the cameras of a site from the people in a stretch of its recording, once.

    All dates share the scene, and hence the axes of their positions. It is found again only if the
    settings, the anchors, or the number or image sizes of the cameras differ. Stretches of five
    minutes, spread over the recording, are tried until one suffices: at night there may be no
    people.

    Args:
        site: the recording.
        out: the scene is stored in `site=NAME/_calibration`.
        settings: settings of the calibration.
        detector: as `run`, for videos.

    Raises:
        CalibrationError: if no stretch suffices, with the reason for the last one.
        CatFreeError: if the recording cannot be read.
    """
    settings = Settings() if settings is None else settings
    anchors = read_anchors(site.anchors) if isinstance(site.anchors, str) else site.anchors
    if isinstance(site.recording, str) and site.image_size is None:
        raise InvalidInputError(
            f"The cameras of {quoted(site.name)} are to be found from saved boxes: give "
            "image_size, or a scene."
        )
    finder, size = None, site.image_size
    if not isinstance(site.recording, str):
        finder = BackgroundDetector() if detector is None else detector
        size = open_recording(site.recording, site.frame_rate).image_size.tolist()
    key = hash_parameters(
        "calibration", settings=dataclasses.asdict(settings), image_size=size,
        anchors=[(type(one).__name__, dataclasses.asdict(one)) for one in anchors],
    )  # fmt: skip
    folder = make_folder(recording_folder(out, site.name, "") / "_calibration")
    path = folder / f"{key[:40]}.json"
    if path.is_file():
        return read_scene_json(path)[0]
    silent = _silent(site, plain_numbers(len(site.image_size or ())))
    plan = shards(site.recording, CALIBRATION_SECONDS, 0.0, site.frame_rate, silent=silent)
    reason: CatFreeError | None = None
    for shard in _spread(plan)[:MOST_TRIES]:
        try:
            recording, boxes = _footage(shard, site, finder)
            calibration = calibrate_cameras(recording, finder, boxes, settings, anchors=anchors)
        except (CalibrationError, InsufficientDataError) as error:
            reason = error
            continue
        return read_scene_json(write_scene_json(path, calibration.scene))[0]
    raise CalibrationError(
        f"No stretch of the recording of {quoted(site.name)} yields its cameras; the last one "
        f"tried: {reason}"
    )


def _footage(
    shard: Shard, site: Site, finder: Detector | FittedToCamera | None
) -> tuple[Recording, Detections]:
    """Open a shard's videos or boxes for `calibrate_cameras`, and return them with the boxes."""
    if finder is not None:
        videos = open_shard_videos(shard)
        return videos, detect_videos(videos, finder)
    boxes = boxes_of_shard(shard)
    size = camera_sizes(boxes, np.array(site.image_size))
    return CameraBoxes(boxes, numbered_names(len(size)), size, silent_pictures(shard)), boxes


def _spread(plan: Sequence[Shard]) -> list[Shard]:
    """Order items: the middle first, then the middles of the halves, then of the quarters."""
    indices = [
        numerator * len(plan) // parts for parts in (2, 4, 8) for numerator in range(1, parts, 2)
    ]
    return [plan[index] for index in dict.fromkeys(indices)]
