"""The result folder: tracks, cameras and pictures in the formats that other tools read."""

import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from catfree._coverage import coverage
from catfree._run._cache import from_arrays, to_arrays
from catfree._run._report import write_report
from catfree._run._run import RunOutcome
from catfree.adapters.calibration_files._anipose_toml import write_anipose_toml
from catfree.adapters.calibration_files._rig_json import read_scene_json, write_scene_json
from catfree.adapters.calibration_files.colmap._colmap import write_colmap_text
from catfree.adapters.files._camera_names import distinct_names, file_names
from catfree.adapters.tables._motchallenge import write_mot_boxes, write_mot_ground
from catfree.adapters.tables._tracks_table import write_tracks_csv, write_tracks_parquet
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import FileFormatError
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress
from catfree.types._archive import load_arrays, naming_file, save_arrays
from catfree.types._writing import cannot_write, remove_abandoned, replacing
from catfree.types.results import MOST_CAMERAS
from catfree.viz.footage._contact_sheet import write_sheet

# TrackEval matches two squares at an IoU of 0.5. In a scene of unknown scale the matching distance
# is the longest step of a track between frames.
MATCHING_METERS = 1.0
FOLDERS = ("", "boxes", "pictures", "rig", "rig/colmap")  # with files, within the result folder
LOCALIZATION_FILE, SCENE_FILE = "localization.npz", "scene.json"


def write_results(
    folder: str | os.PathLike[str],
    outcome: RunOutcome,
    settings: Settings | None = None,
    *,
    videos: SynchronizedVideos | None = None,
    pictures: bool | None = None,
    area: Sequence[float | int] | None = None,
    ground_truth: Float[np.ndarray, "n 4"] | None = None,
) -> list[Path]:
    """Write all results of a run.

    Args:
        folder: created if it does not exist; files of an earlier run are replaced, and temporary
            files removed that a killed one left over.
        outcome: what `run_stages` returned.
        settings: the settings of the run, for the report.
        videos: the footage, to draw the result on one instant; None for no such picture.
        pictures: draw plots; None: if matplotlib is installed.
        area: x_min, x_max, y_min, y_max of an area to outline in the plots, in ground coordinates.
        ground_truth: (N, 4) rows [frame, id, x, y] in ground coordinates to draw, or None.

    Returns:
        The files: `tracks.csv`, `tracks.parquet` where pyarrow is installed and there are at most
        64 cameras, `tracks_mot.txt` for TrackEval, `boxes/CAMERA.txt` in MOTChallenge form with
        identities, `detections.npz`, `localization.npz`, the scene as `scene.json`,
        `rig/colmap` and `rig/calibration.toml`, `pictures/*.png`, `report.md` and `report.html`.

    Raises:
        InvalidInputError: if the localization was made from other detections.
        WriteError: if the disk is full or not writable; no partial file is left behind.
        MissingDependencyError: if `pictures` is True and matplotlib is not installed.
    """
    root = Path(folder)
    settings = settings or Settings()
    try:
        root.mkdir(parents=True, exist_ok=True)
        for part in FOLDERS:
            remove_abandoned(root / part)
        files = _write_tables(root, outcome, settings) + write_rig(
            root, outcome.scene, outcome.camera_names
        )
        drawn = []
        if pictures or (pictures is None and importlib.util.find_spec("matplotlib") is not None):
            drawn = draw_pictures(
                root / "pictures",
                outcome.localization,
                outcome.scene,
                camera_names=outcome.camera_names,
                area=area,
                ground_truth=ground_truth,
            )
        if videos is not None and pictures is not False:
            drawn.append(draw_views(root / "pictures", videos, outcome))
        files += drawn
        files += write_report(root, outcome, settings, files, drawn)
    except OSError as error:
        raise cannot_write(root, error) from error
    return files


def write_rig(
    folder: str | os.PathLike[str], scene: Scene, camera_names: Sequence[str]
) -> list[Path]:
    """Write cameras and ground as `scene.json` and in the formats of COLMAP and anipose.

    Args:
        folder: created if it does not exist.
        scene: cameras and ground; cameras that are not registered are only in `scene.json`.
        camera_names: (C,) names.

    Returns:
        The files.
    """
    root = Path(folder)
    (root / "rig").mkdir(parents=True, exist_ok=True)
    # COLMAP separates its columns by spaces.
    joined = distinct_names(["_".join(name.split()) for name in camera_names])
    colmap = write_colmap_text(root / "rig" / "colmap", scene.rig, joined)
    return [
        write_scene_json(root / SCENE_FILE, scene, camera_names),
        write_anipose_toml(root / "rig" / "calibration.toml", scene.rig, camera_names),
        *(colmap / f"{part}.txt" for part in ("cameras", "images", "points3D")),
    ]


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
    root = Path(folder)
    scene, names = read_scene_json(root / SCENE_FILE)
    arrays = load_arrays(root / LOCALIZATION_FILE, Localization.__name__, required=None)
    localization = naming_file(root / LOCALIZATION_FILE, lambda: from_arrays(Localization, arrays))
    cameras = localization.candidates.support.shape[-1]
    if cameras != scene.rig.camera_count:
        raise FileFormatError(
            f"{root / SCENE_FILE} has {scene.rig.camera_count} cameras, but "
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
) -> list[Path]:
    """Draw the bird's-eye view, the expected uncertainty and the gates, if there are any.

    Args:
        folder: created if it does not exist.
        localization: what `localize` returned.
        scene: the scene it was made with.
        camera_names: (C,) labels of the cameras.
        area: x_min, x_max, y_min, y_max of an area to outline.
        ground_truth: (N, 4) rows [frame, id, x, y] to draw, or None.

    Returns:
        The pictures.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    from catfree.viz.plots._axes import require_pyplot
    from catfree.viz.plots._bird_eye import plot_bird_eye
    from catfree.viz.plots._coverage_map import plot_coverage
    from catfree.viz.plots._threshold_plot import plot_gates

    pyplot = require_pyplot()
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    figures = {}
    view = plot_bird_eye(
        localization, scene, camera_names=camera_names, area=area, ground_truth=ground_truth
    )
    figures["bird_eye.png"] = view.figure
    if scene.rig.registered.sum() >= 2:
        expected = coverage(scene, area)
        coverage_view = plot_coverage(
            expected, scene, localization=localization, camera_names=camera_names
        )
        figures["coverage.png"] = coverage_view.figure
    if localization.thresholds.tau_sigma is not None:
        figures["gates.png"] = plot_gates(localization, scene)[0].figure
    written = []
    for name, figure in figures.items():
        try:
            with replacing(root / name) as stream:
                figure.savefig(stream, dpi=130, format="png")
        finally:
            pyplot.close(figure)
        written.append(root / name)
    return written


def draw_views(
    folder: str | os.PathLike[str], videos: SynchronizedVideos, outcome: RunOutcome
) -> Path:
    """Draw boxes and tracks on all cameras' images in the middle of the footage.

    Args:
        folder: created if it does not exist.
        videos: the footage.
        outcome: the result of the run.

    Returns:
        `views.jpg`: the cameras' pictures side by side.
    """
    from catfree.viz._person_height import person_height
    from catfree.viz.footage._overlay import draw_frame

    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    results = (outcome.detections, outcome.localization, outcome.scene)
    height = person_height(*results)
    middle = videos.frame_count // 2
    # Truncated footage may not reach its middle.
    instant = next(videos.instants_from(middle), None) or next(iter(videos))
    frame, images = instant
    drawn = [
        draw_frame(image, camera, frame, *results, person_height=height)
        for camera, image in enumerate(images)
    ]
    return write_sheet(root / "views.jpg", drawn)


def write_overlay(
    folder: str | os.PathLike[str],
    videos: SynchronizedVideos,
    outcome: RunOutcome,
    progress: Progress | None = None,
) -> Path:
    """Write `overlay.mp4`, the images of all cameras with the tracks, to a folder."""
    from catfree.viz.footage._overlay import write_overlay_video

    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    write_overlay_video(
        root / "overlay.mp4",
        videos,
        outcome.detections,
        outcome.localization,
        outcome.scene,
        camera_names=outcome.camera_names,
        progress=progress,
    )
    return root / "overlay.mp4"


def _write_tables(root: Path, outcome: RunOutcome, settings: Settings) -> list[Path]:
    tracks, scene = outcome.localization.tracks, outcome.scene
    extent = float(scene.extent)
    reach = MATCHING_METERS if scene.metric else settings.trajectories.link_radius * extent
    files = [
        write_tracks_csv(root / "tracks.csv", tracks),
        write_mot_ground(root / "tracks_mot.txt", tracks, outcome.frames, threshold=reach),
    ]
    fits = tracks.support.shape[1] <= MOST_CAMERAS
    if fits and importlib.util.find_spec("pyarrow") is not None:
        parquet = root / "tracks.parquet"
        files.append(write_tracks_parquet(parquet, tracks, outcome.camera_names))
    outcome.localization.require_detections(outcome.detections)
    files += write_boxes(
        root / "boxes",
        outcome.detections,
        outcome.camera_names,
        outcome.frames,
        outcome.localization.identity,
    )
    outcome.detections.save(root / "detections.npz")
    arrays = to_arrays(outcome.localization)
    save_arrays(root / LOCALIZATION_FILE, Localization.__name__, arrays)
    return [*files, root / "detections.npz", root / LOCALIZATION_FILE]


def write_boxes(
    folder: str | os.PathLike[str],
    detections: Detections,
    camera_names: Sequence[str],
    frames: Int[np.ndarray, " t"],
    identity: Int[np.ndarray, " n"] | None = None,
) -> list[Path]:
    """Write the boxes of each camera as `CAMERA.txt` in MOTChallenge form.

    Args:
        folder: created if it does not exist.
        detections: (N,) boxes of all cameras.
        camera_names: (C,) names.
        frames: (T,) all frame numbers; the first becomes 1.
        identity: (N,) track of each box or -1; None for no tracks.

    Returns:
        The files.
    """
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    files = []
    for camera, name in enumerate(file_names(camera_names)):
        rows = detections.camera == camera
        track_id = None if identity is None else identity[rows]
        files.append(write_mot_boxes(root / f"{name}.txt", detections[rows], frames, track_id))
    return files
