"""The result folder: tracks, cameras and pictures in formats that other tools read."""

import dataclasses
import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from catfree._coverage import Coverage, coverage
from catfree._run._cache import load_value, save_value
from catfree._run._report import write_report
from catfree._run._run import RunOutcome
from catfree.adapters.calibration_files._anipose_toml import write_anipose_toml
from catfree.adapters.calibration_files._rig_json import read_scene_json, write_scene_json
from catfree.adapters.calibration_files.colmap._colmap import write_colmap_text
from catfree.adapters.datasets._detection_files import (
    RESULT_BOXES,
    RESULT_OFFSETS,
    RESULT_SCENE,
    RESULT_SILENT,
    write_missing_pictures,
    write_offsets,
)
from catfree.adapters.files._camera_names import distinct_names, file_names
from catfree.adapters.tables._motchallenge import write_mot_boxes, write_mot_ground
from catfree.adapters.tables._tracks_table import write_tracks_csv, write_tracks_parquet
from catfree.adapters.tables.tracks._geojson import write_geojson
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import CatFreeError, FileFormatError
from catfree.settings import SelectionSettings, Settings
from catfree.types import Detections, Lens, Localization, Scene
from catfree.types._sampling import common_step
from catfree.types._validation import as_flag, as_path, require_instance
from catfree.types._writing import cannot_write, make_folder, remove_abandoned, replacing
from catfree.types.results._arrow_table import CAMERA_BITS
from catfree.viz.footage._contact_sheet import write_sheet
from catfree.viz.page._blocks import Block
from catfree.viz.page._excerpt import choose_excerpt, earlier_pictures, write_pictures
from catfree.viz.page._player import Player, make_player

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# TrackEval matches two squares at an IoU of 0.5. If the scale is unknown, the matching distance is
# the longest step of a track between frames.
MATCHING_METERS = 1.0
INSTANTS, OVERLAY_FILE = "pictures/instants", "overlay.webm"
# Folders within the result folder that contain files.
FOLDERS = ("", "boxes", "pictures", INSTANTS, "rig", "rig/colmap")
LOCALIZATION_FILE = "localization.npz"
TABLE_FILE, MOT_FILE = "tracks.csv", "tracks_mot.txt"
PICTURES = (
    "bird_eye.png",
    "coverage.png",
    "gates.png",
    "views.jpg",
    "ground_grid.jpg",
    "boxes.jpg",
)
RIG_FILES = (
    "rig/calibration.toml",
    *(f"rig/colmap/{part}.txt" for part in ("cameras", "images", "points3D")),
)
# Only some runs write these.
SOMETIMES = ("tracks.parquet", "tracks.geojson", RESULT_SILENT, RESULT_OFFSETS, *RIG_FILES)


def write_results(
    folder: str | os.PathLike[str],
    outcome: RunOutcome,
    settings: Settings | None = None,
    *,
    videos: SynchronizedVideos | None = None,
    pictures: bool | None = None,
    area: Sequence[float | int] | None = None,
    ground_truth: Float[np.ndarray, "n 4"] | None = None,
    embeddings: bool = False,
    blur: bool = False,
    overlay: bool = False,
    extra: Sequence[Block] = (),
) -> list[Path]:
    """Write all results of a run.

    Args:
        folder: created if it does not exist; files of an earlier run are replaced or removed, as
            are temporary files of a killed run.
        outcome: what `run_stages` returned.
        settings: the settings of the run, for the report.
        videos: the footage, for pictures in the report; None for a report without pictures.
        pictures: draw plots; None: if matplotlib is installed.
        area: x_min, x_max, y_min, y_max of an area to outline in the plots, in ground coordinates.
        ground_truth: (N, 4) rows [frame, id, x, y] in ground coordinates to draw, or None.
        embeddings: write the boxes' appearance vectors to `detections.npz`. They are personal data,
            as they can identify a person in other footage.
        blur: make people unrecognizable in all pictures.
        overlay: show `overlay.webm` of the same folder, which the caller writes.
        extra: blocks for the report, after the checks.

    Returns:
        The files: `tracks.csv`, `tracks.parquet` where pyarrow is installed and there are at most
        64 cameras, `tracks_mot.txt` for TrackEval, `boxes/CAMERA.txt` in MOTChallenge form with
        identities, `detections.npz`, `localization.npz`, the scene as `scene.json`,
        `rig/colmap` and `rig/calibration.toml`, `pictures/`, `report.md` and `report.html`; also
        `missing_pictures.csv` if pictures are missing, and `offsets.csv` if videos began at
        different times. `tracks_mot.txt` and `boxes/` number all frames consecutively from 1,
        including empty ones: the first frame of videos becomes 1; frame numbers of boxes that count
        from 1 are kept.

    Raises:
        InvalidInputError: if the localization was made from other detections.
        WriteError: if the disk is full or not writable; no partial file is left behind.
        MissingDependencyError: if `pictures` is True and matplotlib is not installed.
    """
    root = as_path(folder, "folder")
    require_instance(outcome, RunOutcome, "outcome")
    settings = Settings() if settings is None else settings
    require_instance(settings, Settings, "settings")
    pictures = None if pictures is None else as_flag(pictures, "pictures")
    embeddings, blur = as_flag(embeddings, "embeddings"), as_flag(blur, "blur")
    overlay = as_flag(overlay, "overlay")
    localization, scene = outcome.localization, outcome.scene
    localization.require_detections(outcome.detections)
    result = root / LOCALIZATION_FILE
    try:
        make_folder(root)
        for part in FOLDERS:
            remove_abandoned(root / part)
        earlier = earlier_results(root)
        # An interrupted write must not look like a result: this file is required, and written last.
        result.unlink(missing_ok=True)
        files = _write_tables(root, outcome, settings, embeddings=embeddings) + write_rig(
            root, scene, outcome.camera_names
        )
        files.append(result)
        covered = coverage(scene, area) if scene.rig.registered.sum() >= 2 else None
        drawn = []
        if pictures or (pictures is None and importlib.util.find_spec("matplotlib") is not None):
            drawn = draw_pictures(
                root / "pictures",
                localization,
                scene,
                camera_names=outcome.camera_names,
                area=area,
                ground_truth=ground_truth,
                covered=covered,
                suppression_radius=settings.selection.suppression_radius,
            )
        shown = videos if pictures is not False else None
        if shown is not None:
            drawn += draw_views(root / "pictures", shown, outcome, blur=blur)
        player, instants = _write_player(root, outcome, shown, covered, blur=blur)
        files += drawn
        listed = [*files, root / INSTANTS] if instants else files
        files += instants
        video = root / OVERLAY_FILE if overlay else None
        remove_unless_written([*earlier, *earlier_views(root)], [*files, video])
        files += write_report(
            root,
            outcome,
            settings,
            listed,
            drawn,
            player=player,
            covered=covered,
            video=video,
            extra=extra,
        )
        save_value(result, localization)
    except OSError as error:
        raise cannot_write(root, error) from error
    return files


def remove_unless_written(earlier: Sequence[Path], written: Sequence[Path | None]) -> None:
    """Remove files of an earlier run that this run did not write."""
    for path in set(earlier) - set(written):
        if path.is_file():
            path.unlink()


def earlier_results(root: Path) -> list[Path]:
    """List the tracks, cameras and boxes that an earlier run left in a result folder."""
    names = (TABLE_FILE, MOT_FILE, LOCALIZATION_FILE, RESULT_SCENE, *SOMETIMES)
    earlier = [*(root / name for name in names), *_earlier_boxes(root)]
    return [path for path in earlier if path.is_file()]


def earlier_views(root: Path) -> list[Path]:
    """List where an earlier run may have left pictures or the overlay video."""
    drawn = (root / "pictures" / name for name in PICTURES)
    return [*drawn, *earlier_pictures(root / INSTANTS), root / OVERLAY_FILE]


def _earlier_boxes(root: Path) -> list[Path]:
    """List the boxes' files of an earlier run, named after its cameras."""
    if not (root / LOCALIZATION_FILE).is_file():
        return []  # `write_rig` also writes a scene but no boxes, so such boxes are not ours
    try:
        names = read_scene_json(root / RESULT_SCENE)[1]
    except CatFreeError:
        return []
    return [root / "boxes" / f"{name}.txt" for name in file_names(names)]


def _write_player(
    root: Path,
    outcome: RunOutcome,
    videos: SynchronizedVideos | None,
    covered: Coverage | None,
    *,
    blur: bool,
) -> tuple[Player | None, list[Path]]:
    """Write the pictures of the report's player; return it (None without instants) and them."""
    results = (outcome.detections, outcome.localization, outcome.scene)
    # Footage may continue beyond its last decodable frame.
    frames = outcome.frames if videos is None else np.intersect1d(outcome.frames, videos.frames)
    clock = outcome.detections.clock
    gap = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    excerpt = choose_excerpt(
        frames,
        outcome.localization.tracks.frame,
        outcome.scene.rig.camera_count,
        None if clock is None else clock.frame_rate / gap,
        pictured=videos is not None,
    )
    instants = []
    if videos is not None:
        instants = write_pictures(root / INSTANTS, videos, excerpt, *results, blur=blur)
    if not len(excerpt.frames):
        return None, instants
    player = make_player(
        excerpt,
        *results,
        outcome.camera_names,
        pictures=INSTANTS if instants else None,
        coverage=covered,
    )
    return player, instants


def write_rig(root: Path, scene: Scene, camera_names: Sequence[str]) -> list[Path]:
    """Write cameras and ground as `scene.json` and in the formats of COLMAP and anipose.

    Only `scene.json` can describe cameras that are grids of rays.

    Args:
        root: the result folder, created if it does not exist.
        scene: cameras and ground; unregistered cameras are only in `scene.json`.
        camera_names: (C,) names.

    Returns:
        The files.
    """
    make_folder(root / "rig")
    written = [write_scene_json(root / RESULT_SCENE, scene, camera_names)]
    if (scene.rig.lenses == Lens.RAYS).any():
        return written
    # COLMAP separates columns by spaces.
    joined = distinct_names(["_".join(name.split()) for name in camera_names])
    write_colmap_text(root / "rig" / "colmap", scene.rig, joined)
    write_anipose_toml(root / "rig" / "calibration.toml", scene.rig, camera_names)
    return [*written, *(root / name for name in RIG_FILES)]


def read_results(folder: str | os.PathLike[str]) -> tuple[Localization, Scene, tuple[str, ...]]:
    """Read localization, scene and camera names from a folder that `write_results` wrote.

    Args:
        folder: the result folder.

    Returns:
        The localization, its scene, and the names of the cameras.

    Raises:
        InvalidInputError: if a file is missing, or a value in it is out of range.
        FileFormatError: if a file has another format, or the files are from different runs.
    """
    root = as_path(folder, "folder")
    scene, names = read_scene_json(root / RESULT_SCENE)
    localization = load_value(root / LOCALIZATION_FILE, Localization)
    cameras = localization.candidates.support.shape[-1]
    if cameras != scene.rig.camera_count:
        raise FileFormatError(
            f"{root / RESULT_SCENE} has {scene.rig.camera_count} cameras, but "
            f"{root / LOCALIZATION_FILE} was made with {cameras}. Take both from one run."
        )
    return localization, scene, names


def draw_pictures(
    folder: str | os.PathLike[str],
    localization: Localization,
    scene: Scene,
    *,
    camera_names: Sequence[str] | None = None,
    area: Sequence[float | int] | None = None,
    ground_truth: Float[np.ndarray, "n 4"] | None = None,
    covered: Coverage | None = None,
    suppression_radius: float = SelectionSettings().suppression_radius,
) -> list[Path]:
    """Draw the bird's-eye view, the expected uncertainty and the gates, where they exist.

    Args:
        folder: created if it does not exist.
        localization: what `localize` returned.
        scene: the scene of the localization.
        camera_names: (C,) labels of the cameras.
        area: x_min, x_max, y_min, y_max of an area to outline.
        ground_truth: (N, 4) rows [frame, id, x, y] to draw, or None.
        covered: the result of `coverage` for the scene and the area; None to compute it.
        suppression_radius: suppression radius of the run as a fraction of E, the unit of the gates.

    Returns:
        The pictures.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    from catfree.viz.plots._bird_eye import plot_bird_eye
    from catfree.viz.plots._coverage_map import plot_coverage
    from catfree.viz.plots._threshold_plot import plot_gates

    root = make_folder(folder)
    plots = {
        "bird_eye.png": plot_bird_eye(
            localization, scene, camera_names=camera_names, area=area, ground_truth=ground_truth
        )
    }
    if scene.rig.registered.sum() >= 2:
        plots["coverage.png"] = plot_coverage(
            coverage(scene, area) if covered is None else covered,
            scene,
            localization=localization,
            camera_names=camera_names,
        )
    if localization.thresholds.tau_sigma is not None:
        gates = plot_gates(localization, scene, suppression_radius=suppression_radius)
        plots["gates.png"] = gates[0]
    return [save_plot(ax, root / name) for name, ax in plots.items()]


def save_plot(ax: "Axes", path: Path) -> Path:
    """Write the figure of a plot as PNG, and close it."""
    from catfree.viz.plots._axes import figure_of, require_pyplot

    figure = figure_of(ax)
    try:
        with replacing(path) as stream:
            figure.savefig(stream, dpi=130, format="png")
    finally:
        require_pyplot().close(figure)
    return path


def draw_views(
    folder: str | os.PathLike[str],
    videos: SynchronizedVideos,
    outcome: RunOutcome,
    *,
    blur: bool,
) -> list[Path]:
    """Draw tracks and a ground grid on the images of all cameras near the middle of the footage.

    Args:
        folder: created if it does not exist.
        videos: the footage.
        outcome: the result of the run.
        blur: make people unrecognizable.

    Returns:
        `views.jpg` and, for two or more cameras, `ground_grid.jpg`: the pictures of the cameras
        side by side.
    """
    from catfree.viz._person_height import person_height
    from catfree.viz.footage._blur import blur_people
    from catfree.viz.footage._ground_grid import draw_ground_grids
    from catfree.viz.footage._overlay import draw_frame

    root = make_folder(folder)
    results = (outcome.detections, outcome.localization, outcome.scene)
    height = person_height(*results)
    middle = videos.frame_count // 2
    # Truncated footage may end before its middle.
    frame, images = next(videos.instants_from(middle), None) or next(iter(videos))
    drawn = [
        draw_frame(image, camera, frame, *results, person_height=height, blur=blur)
        for camera, image in enumerate(images)
    ]
    files = [write_sheet(root / "views.jpg", drawn)]
    if outcome.scene.rig.registered.sum() < 2:
        return files
    if blur:
        images = blur_people(images, frame, *results, height)
    grids = draw_ground_grids(images, outcome.scene)
    return [*files, write_sheet(root / "ground_grid.jpg", grids)]


def _write_tables(
    root: Path, outcome: RunOutcome, settings: Settings, *, embeddings: bool
) -> list[Path]:
    tracks, scene = outcome.localization.tracks, outcome.scene
    extent = float(scene.extent)
    reach = MATCHING_METERS if scene.metric else settings.trajectories.link_radius * extent
    numbers = numbers_of_files(outcome.frames, from_one=outcome.videos is None)
    files = [
        write_tracks_csv(root / TABLE_FILE, tracks),
        write_mot_ground(root / MOT_FILE, tracks, numbers, threshold=reach),
    ]
    fits = tracks.support.shape[1] <= CAMERA_BITS
    if fits and importlib.util.find_spec("pyarrow") is not None:
        parquet = root / "tracks.parquet"
        files.append(write_tracks_parquet(parquet, tracks, outcome.camera_names))
    if scene.georeference is not None:
        files.append(write_geojson(root / "tracks.geojson", tracks, scene))
    if len(outcome.silent):
        silent = root / RESULT_SILENT
        files.append(write_missing_pictures(silent, outcome.silent, outcome.camera_names))
    if any(outcome.offsets):
        began = root / RESULT_OFFSETS
        files.append(write_offsets(began, outcome.offsets, outcome.camera_names))
    files += write_boxes(
        root,
        outcome.detections,
        outcome.camera_names,
        numbers,
        outcome.localization.identity,
        embeddings=embeddings,
    )
    return files


def numbers_of_files(frames: Int[np.ndarray, " t"], *, from_one: bool = False) -> range:
    """Return evenly spaced frame numbers, with empty instants, for files that count frames from 1.

    Args:
        frames: (T,) sorted frame numbers, without empty instants.
        from_one: begin with the smallest positive number, which keeps numbers that count from 1.
    """
    if not len(frames):
        return range(0)
    step = common_step(frames)
    first, last = int(frames[0]), int(frames[-1])
    if from_one:
        first = min(first, (first - 1) % step + 1)
    return range(first, last + 1, step)


def write_boxes(
    root: Path,
    detections: Detections,
    camera_names: Sequence[str],
    frames: range,
    identity: Int[np.ndarray, " n"] | None = None,
    *,
    embeddings: bool,
) -> list[Path]:
    """Write all boxes as `detections.npz` and each camera's boxes as MOTChallenge files.

    Args:
        root: the result folder, created if it does not exist.
        detections: (N,) boxes of all cameras.
        camera_names: (C,) names.
        frames: all frame numbers; the first becomes 1.
        identity: (N,) track of each box or -1; None without tracks.
        embeddings: keep the boxes' appearance vectors in `detections.npz`.

    Returns:
        The files.
    """
    folder = make_folder(root / "boxes")
    files = []
    for camera, name in enumerate(file_names(camera_names)):
        rows = detections.camera == camera
        track_id = None if identity is None else identity[rows]
        files.append(write_mot_boxes(folder / f"{name}.txt", detections[rows], frames, track_id))
    kept = detections if embeddings else dataclasses.replace(detections, embedding=None)
    kept.save(root / RESULT_BOXES)
    return [*files, root / RESULT_BOXES]
