"""The commands of the command line."""

import contextlib
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tyro.conf import Positional

from catfree.cli._check_command import check
from catfree.cli._inputs import (
    Method,
    Unit,
    are_boxes,
    folder_of_results,
    joined_recording,
    open_anchors,
    open_boxes,
    open_detector,
    open_embedder,
    open_reconstructor,
    open_scene,
    open_videos,
    require_files,
    require_offset,
    require_other_folder,
    settings_of,
)
from catfree.cli._shard_commands import join, plan, run_sites, shard
from catfree.cli._terminal import (
    print_result,
    print_table,
    print_text,
    progress_bars,
    warn,
)
from catfree.cli._watch_command import watch
from catfree.cli._weights_commands import weights
from catfree.errors import CatFreeError, InsufficientDataError, InvalidInputError

NO_TRUTH = (
    "have no true position: everybody found there counts as wrong. If the truth covers only some "
    "frames, give --frames truth."
)
# Share of matched positions. By chance, a crowd of 20 in a hall of 12 by 36 m matches 0.04.
HARDLY_ANY = 0.1
ELSEWHERE = (
    "meet: the two may be in different frames of reference or units. Cameras from people have a "
    "frame of their own: run with the --scene of the truth (and its --unit) or with --anchors, or "
    "align the cameras in Python by cf.evaluation.align_centres."
)
BLANK = (
    "No cell was visited by {} people or more, so all stay blank. A larger --cell has more; a "
    "smaller --k shows cells of fewer people, and with it more of each person."
)
STRIDED = (
    "are evenly spaced among those of the truth: whoever is in the others counts as missed. If the "
    "run had a --stride, give --frames tracks."
)


@contextlib.contextmanager
def _report_of_failure(
    out: Path, *, embeddings: bool = False, blur: bool, pictures: bool
) -> Iterator[Any]:
    """Yield the partial results of a run; if it fails, write them and name the report.

    The folder of the report is created before the run begins.
    """
    from catfree._run._failed_run import write_failure
    from catfree._run._run import Unfinished

    unfinished = Unfinished()
    try:
        with folder_of_results(out):
            yield unfinished
    except CatFreeError as error:
        try:
            files = write_failure(
                out, error, unfinished, embeddings=embeddings, blur=blur, pictures=pictures
            )
        except (CatFreeError, OSError):  # report the first error
            files = []
        if not files:
            raise
        message = f"{error} What the detector saw is in {out / 'report.html'}."
        raise type(error)(message) from error


def _box_table(boxes: Any) -> Any:
    """Tabulate number, frames and median height of the boxes, one row per camera."""
    from catfree.viz.page._blocks import Table

    rows = []
    for camera, name in enumerate(boxes.camera_names):
        camera_boxes = boxes.detections[boxes.detections.camera == camera]
        height = f"{np.median(camera_boxes.height):.0f}" if len(camera_boxes) else ""
        rows.append((name, str(len(camera_boxes)), str(len(np.unique(camera_boxes.frame))), height))
    return Table(("camera", "boxes", "frames with boxes", "median height (px)"), tuple(rows))


def _in_steps(frames: np.ndarray, tracked: np.ndarray) -> np.ndarray:
    """Mark frames (F,) in the even steps of sorted frames of tracks; all if there are none."""
    from catfree.types._sampling import common_step

    if not len(tracked):
        return np.ones(len(frames), bool)
    step = common_step(tracked)
    within = (frames >= tracked[0]) & (frames <= tracked[-1])
    return within & ((frames - tracked[0]) % step == 0)


def _are_strided(tracked: np.ndarray, truth_frames: np.ndarray, even: np.ndarray) -> bool:
    """Return whether tracks have mostly even steps, between which the truth has more frames."""
    if len(tracked) < 3 or not np.isin(tracked, truth_frames).all():
        return False
    within = (truth_frames >= tracked[0]) & (truth_frames <= tracked[-1])
    return bool(2 * len(tracked) > even.sum() and within.sum() >= 2 * even.sum() - 1)


def _better_numbering(
    truth: np.ndarray, predicted: np.ndarray, frames: np.ndarray, gate: float
) -> str | None:
    """State by how much true frame numbers are off, if most frames fit far better with a shift.

    Args:
        truth: (G, 4) rows [frame, id, x, y].
        predicted: (P, 4) the same columns.
        frames: (F,) common frame numbers, sorted.
        gate: largest distance of a match.
    """
    from catfree.evaluation import detection_metrics
    from catfree.types._sampling import common_step

    def shifted(by: int) -> Any:
        moved = np.add(truth, [by, 0, 0, 0])
        return detection_metrics(moved, predicted, frames + by, gate)

    def closeness(one: Any) -> float:
        return one.tp * one.modp

    step = common_step(np.concatenate([truth[:, 0], predicted[:, 0]]).astype(np.int64))
    given, shift = shifted(0), 0
    best = given
    for way in (-step, step):
        while closeness(near := shifted(shift + way)) > closeness(best):
            best, shift = near, shift + way
    wrong, left = (one.fp_per_frame + one.fn_per_frame for one in (given, best))
    if 2 * (2 * left < wrong).sum() <= len(frames):
        return None
    way = "higher" if shift > 0 else "lower"
    return (
        f"Were the frame numbers of the truth {abs(shift)} {way}, MODA would be {best.moda:.2f} "
        f"instead of {given.moda:.2f} in the frames that both have. Check the number from which "
        "each counts its frames."
    )


def run(
    videos: Positional[tuple[Path, ...]],
    out: Path = Path("catfree_results"),
    detector: Path | None = None,
    embedder: Path | None = None,
    reconstructor: Path | None = None,
    scene: Path | None = None,
    unit: Unit = "m",
    method: Method = "default",
    cache: Path | None = None,
    stride: int = 1,
    start: int | None = None,
    end: int | None = None,
    offsets: tuple[int, ...] | None = None,
    frame_rate: float | None = None,
    keep_before_damage: bool = False,
    max_offset: int = 0,
    anchors: Path | None = None,
    refine: bool = False,
    pictures: bool = True,
    overlay: bool = False,
    blur: bool = False,
    embeddings: bool = False,
    workers: int | None = None,
) -> None:
    """Track the people in the videos of several static cameras.

    Args:
        videos: one video file or image folder per camera.
        out: folder for the results.
        detector: ONNX file of a person detector (YOLO11-pose, YOLOv8-pose or YOLOX), or a name from
            `catfree weights list`; without it, people are found by background subtraction.
        embedder: ONNX file of a re-identification network, or a name from that list.
        reconstructor: ONNX file of VGGT, which finds the cameras from the images.
        scene: known cameras and ground: scene.json, a COLMAP model, anipose TOML, a folder of
            OpenCV files, ...; without it and without a reconstructor, they are found from the
            people.
        unit: length of one unit of a scene whose file does not state it.
        method: the localization method.
        cache: folder for finished stages; `cache` in the results folder if not given.
        stride: use every stride-th frame.
        start: first frame.
        end: frame to stop before.
        offsets: the frame of each camera that shows the first common instant.
        frame_rate: frames per second to use; the lowest of the cameras if not given.
        keep_before_damage: use the footage before a frame that cannot be decoded.
        max_offset: largest clock offset of a single camera, in frames, to search and correct
            when the cameras are found from people.
        anchors: JSON file of known lengths, cameras and points, when the cameras are found from
            people.
        refine: adjust the cameras of the scene to the people.
        pictures: draw plots, where matplotlib is installed, and write pictures of the cameras for
            the report.
        overlay: write a video of all cameras with the tracks drawn in.
        blur: make people unrecognizable in pictures and overlay.
        embeddings: write the appearance vectors, which can identify people, to detections.npz.
        workers: processes that find people by background subtraction; one per processor if not
            given.
    """
    require_files(
        videos,
        detector=detector,
        embedder=embedder,
        reconstructor=reconstructor,
        scene=scene,
    )
    require_offset(max_offset)
    from catfree._run._report import footage_table
    from catfree._run._result_folder import OVERLAY_FILE, write_results
    from catfree._run._run import run_stages
    from catfree.types._processes import processor_count
    from catfree.viz.footage._overlay import write_overlay_video

    settings, known_anchors = settings_of(method), open_anchors(anchors)
    footage = open_videos(
        videos,
        stride=stride,
        start=start,
        end=end,
        offsets=offsets,
        frame_rate=frame_rate,
        on_error="keep" if keep_before_damage else "raise",
    )
    known_scene, names = open_scene(scene, unit)
    networks = open_detector(detector), open_embedder(embedder)
    finder = open_reconstructor(reconstructor)
    print_table(footage_table(footage), aside=True)
    on_failure = _report_of_failure(out, embeddings=embeddings, blur=blur, pictures=pictures)
    with on_failure as unfinished, progress_bars() as progress:
        outcome = run_stages(
            footage,
            *networks,
            finder,
            known_scene,
            settings,
            cache_dir=out / "cache" if cache is None else cache,
            progress=progress,
            scene_names=names,
            maximum_offset=max_offset,
            anchors=known_anchors,
            refine=refine,
            workers=processor_count() if workers is None else workers,
            unfinished=unfinished,
        )
    assert outcome.videos is not None
    write_results(
        out,
        outcome,
        settings,
        videos=outcome.videos,
        pictures=None if pictures else False,
        embeddings=embeddings,
        blur=blur,
        overlay=overlay,
    )
    if overlay:
        with progress_bars() as progress:
            write_overlay_video(
                out / OVERLAY_FILE,
                outcome.videos,
                outcome.detections,
                outcome.localization,
                outcome.scene,
                camera_names=outcome.camera_names,
                progress=progress,
                blur=blur,
            )
    print_result(outcome, out)


def localize(
    boxes: Positional[tuple[Path, ...]],
    out: Path = Path("catfree_results"),
    scene: Path | None = None,
    unit: Unit = "m",
    method: Method = "default",
    image_size: tuple[int, int] | None = None,
    frame_rate: float | None = None,
    silent: Path | None = None,
    cache: Path | None = None,
    max_offset: int = 0,
    anchors: Path | None = None,
    refine: bool = False,
    pictures: bool = True,
) -> None:
    """Track people from their boxes in several static cameras.

    Args:
        boxes: MOTChallenge or COCO files, one per camera; a folder of these; or one CSV,
            Parquet, uniform JSON or .npz file with the boxes of all cameras.
        out: folder for the results.
        scene: known cameras and ground: scene.json, a COLMAP model, anipose TOML, a folder of
            OpenCV files, ...; without it, they are found from the people.
        unit: length of one unit of a scene whose file does not state it.
        method: the localization method.
        image_size: width and height of the images in pixels, if neither boxes nor scene state them.
        frame_rate: frames per second, for times and velocities in the results.
        silent: CSV or Parquet table of missing pictures, with the columns frame and camera. If the
            boxes are the results of a run, these already contain it.
        cache: folder for finished stages; `cache` in the results folder if not given.
        max_offset: largest clock offset of a single camera, in frames, to search and correct
            when the cameras are found from people.
        anchors: JSON file of known lengths, cameras and points, when the cameras are found from
            people.
        refine: adjust the cameras of the scene to the people.
        pictures: draw plots, where matplotlib is installed.
    """
    from catfree._run._result_folder import write_results
    from catfree._run._run import run_stages

    require_offset(max_offset)
    settings, known_anchors = settings_of(method), open_anchors(anchors)
    require_other_folder(out, boxes)
    known_scene, names = open_scene(scene, unit, image_size)
    camera_boxes = open_boxes(boxes, frame_rate, image_size, silent, names)
    print_table(_box_table(camera_boxes), aside=True)
    with folder_of_results(out), progress_bars() as progress:
        outcome = run_stages(
            camera_boxes,
            scene=known_scene,
            settings=settings,
            cache_dir=out / "cache" if cache is None else cache,
            progress=progress,
            scene_names=names,
            maximum_offset=max_offset,
            anchors=known_anchors,
            refine=refine,
        )
    write_results(out, outcome, settings, pictures=None if pictures else False)
    print_result(outcome, out)


def demo(
    out: Path = Path("catfree_demo"),
    seed: int = 0,
    cameras: int = 6,
    people: int = 14,
    frames: int = 200,
    size: tuple[int, int] = (1280, 720),
    method: Method = "default",
    workers: int | None = None,
    pictures: bool = True,
    blur: bool = False,
) -> None:
    """Render a synthetic world, track its people from the videos alone, and score the tracks.

    Args:
        out: folder for videos and results.
        seed: seed of the random world.
        cameras: cameras around the square.
        people: people on the square at a time.
        frames: number of frames, 5 per second.
        size: width and height of the videos in pixels.
        method: the localization method.
        workers: processes that render and detect; one per processor if not given.
        pictures: draw plots, where matplotlib is installed, and write pictures of the cameras for
            the report.
        blur: make people unrecognizable in the pictures of the results.
    """
    from catfree.cli._demo import EASY, run_demo, score_table

    with progress_bars() as progress:
        outcome, scores = run_demo(
            out,
            seed,
            cameras=cameras,
            people=people,
            frames=frames,
            image_size=size,
            settings=None if method == "default" else settings_of(method),
            workers=workers,
            pictures=None if pictures else False,
            blur=blur,
            progress=progress,
        )
    print_table(score_table(scores))
    print_result(outcome, out)
    print_text(EASY)


def calibrate(
    videos: Positional[tuple[Path, ...]],
    out: Path = Path("catfree_rig"),
    detector: Path | None = None,
    cache: Path | None = None,
    stride: int = 1,
    offsets: tuple[int, ...] | None = None,
    keep_before_damage: bool = False,
    max_offset: int = 0,
    anchors: Path | None = None,
    image_size: tuple[int, int] | None = None,
    silent: Path | None = None,
    pictures: bool = True,
    blur: bool = False,
) -> None:
    """Find cameras and ground in meters from the people in videos, or from their boxes.

    Args:
        videos: one video file or image folder per camera, or files of boxes as for `localize`.
        out: folder for scene.json and the rig in other formats.
        detector: ONNX file of a person detector, or a name from `catfree weights list`; without it,
            people are found by background subtraction.
        cache: folder for finished stages; `cache` in the output folder if not given.
        stride: use every stride-th frame.
        offsets: the frame of each camera that shows the first common instant.
        keep_before_damage: use the footage before a frame that cannot be decoded.
        max_offset: largest clock offset of a single camera, in frames, to search and correct.
        anchors: JSON file of known lengths, cameras and points.
        image_size: width and height of the images in pixels, if boxes do not state them.
        silent: CSV or Parquet table of missing pictures, with the columns frame and camera, for
            boxes. If the boxes are the results of a run, these already contain it.
        pictures: if no cameras are found, write a picture of the boxes.
        blur: make people unrecognizable in it.
    """
    known_anchors, of_boxes = open_anchors(anchors), are_boxes(videos)
    if not of_boxes:
        require_files(videos, detector=detector)
        if silent is not None or image_size is not None:
            raise InvalidInputError(
                f"{videos[0]} is read as a video, which makes --image-size and --silent "
                "unnecessary. Leave them out."
            )
    elif detector is not None or stride != 1 or offsets is not None or keep_before_damage:
        raise InvalidInputError(
            f"{videos[0]} is read as boxes, so --detector, --stride, --offsets and "
            "--keep-before-damage would not be used. Leave them out."
        )
    require_offset(max_offset)
    from catfree._run._cache import StageCache
    from catfree._run._input_checks import (
        before_damage,
        calibration_warnings,
        footage_warnings,
        require_distinct_videos,
    )
    from catfree._run._report import camera_table, footage_table
    from catfree._run._result_folder import write_rig
    from catfree._run._stages import calibrate_cameras
    from catfree._run.detection._cached_detection import detect_with_cache
    from catfree._run.detection._camera_detectors import CameraDetectors
    from catfree.adapters.background._background_detector import BackgroundDetector
    from catfree.calibration.people import resolve_anchors
    from catfree.settings import Settings
    from catfree.types._processes import processor_count

    source: Any
    finder: Any
    if of_boxes:
        require_other_folder(out, videos)
        source, finder = open_boxes(videos, None, image_size, silent), None
        print_table(_box_table(source), aside=True)
    else:
        on_error = "keep" if keep_before_damage else "raise"
        source = open_videos(videos, stride=stride, offsets=offsets, on_error=on_error)
        finder = open_detector(detector) or BackgroundDetector()
        print_table(footage_table(source), aside=True)
        require_distinct_videos(source)
    if source.image_size is not None:  # before anything is written
        resolve_anchors(known_anchors, source.image_size, source.camera_names)
    stages, settings = StageCache(out / "cache" if cache is None else cache), Settings()
    on_failure = _report_of_failure(out, blur=blur, pictures=pictures)
    with on_failure as unfinished, progress_bars() as progress:
        if of_boxes:
            boxes = source.detections
        else:
            unfinished.recording, unfinished.warnings = source, footage_warnings(source)
            workers = processor_count()
            with CameraDetectors(source, finder, stages, progress, workers=workers) as cameras:
                boxes = detect_with_cache(cameras, None)
            unfinished.detections = boxes
            unfinished.recording, damage = before_damage(source)
            unfinished.warnings += damage
        calibration = calibrate_cameras(
            source,
            finder,
            boxes,
            settings,
            maximum_offset=max_offset,
            anchors=known_anchors,
            cache=stages,
            progress=progress,
        )
        warnings = unfinished.warnings + calibration_warnings(calibration, boxes, source, settings)
    write_rig(out, calibration.scene, source.camera_names)
    warn(warnings)
    print_table(camera_table(calibration.scene, source.camera_names, calibration))
    print_text(f"The rig is in {out}.")


def evaluate(
    tracks: Positional[Path],
    ground_truth: Positional[Path],
    split: Literal["test", "train", "all"] = "test",
    area: tuple[float, float, float, float] | None = None,
    threshold: float | None = None,
    track_threshold: float | None = None,
    frames: Literal["all", "truth", "tracks"] = "all",
) -> None:
    """Score tracks against true positions in the same coordinates.

    Args:
        tracks: results folder of a run or of joined shards, or its tracks.csv or
            tracks.parquet.
        ground_truth: CSV with a header and the columns frame, id (-1 if unknown), x, y; uniform
            JSON; or the folder of WildTrack or MultiviewX, scored by their protocol.
        split: frames of WildTrack and MultiviewX to score.
        area: x_min x_max y_min y_max; positions outside are ignored.
        threshold: largest distance of a match for MODA, in meters; 0.5 if not given.
        track_threshold: the same for MOTA and IDF1; 1 if not given.
        frames: score all frames of tracks and truth, or only those of the truth, if it covers, say,
            every tenth frame; WildTrack, MultiviewX and uniform JSON state theirs. With "tracks",
            score only the truth in the even steps of the tracks, as after a run with a stride.
    """
    from catfree.adapters.datasets._ground_truth import read_ground_truth
    from catfree.adapters.tables._track_files import read_tracks
    from catfree.evaluation import crop, detection_metrics, hota, tracking_metrics
    from catfree.viz.page._blocks import Table

    true, recording = read_ground_truth(ground_truth, split), joined_recording(tracks)
    tracked_people = read_tracks(tracks) if recording is None else recording.read()
    predicted = tracked_people.to_rows()
    truth, within = true.rows, true.area if area is None else area
    detection_gate = true.detection_gate if threshold is None else threshold
    tracking_gate = true.tracking_gate if track_threshold is None else track_threshold
    truth_frames = np.unique(truth[:, 0]).astype(np.int64) if true.frames is None else true.frames
    tracked = np.unique(predicted[:, 0]).astype(np.int64)
    if len(tracked) and not np.isin(tracked, truth_frames).any():
        raise InsufficientDataError(
            f"{tracks} and {ground_truth} have no frame in common: {tracked[0]} to {tracked[-1]} "
            f"and {truth_frames[0]} to {truth_frames[-1]}. Use the same frame numbers in both."
        )
    scored, alone = truth_frames, 0
    if true.frames is None and frames == "all":
        alone = len(np.setdiff1d(tracked, truth_frames))
        scored = np.union1d(truth_frames, tracked)
    if not len(tracked):
        warn([f"{tracks} holds no positions: everybody counts as missed."])
    even = _in_steps(truth_frames, tracked)
    if frames == "tracks":
        scored = truth_frames[even]
    elif _are_strided(tracked, truth_frames, even):
        warn([f"The {len(tracked)} frames of {tracks} {STRIDED}"])
    every = predicted
    predicted = predicted[np.isin(predicted[:, 0], scored)]
    people = anywhere = detection_metrics(truth, predicted, scored, detection_gate)
    if within is not None:
        truth, predicted, every = (crop(rows, within) for rows in (truth, predicted, every))
        people = detection_metrics(truth, predicted, scored, detection_gate)
    if not len(truth):
        raise InsufficientDataError(
            f"No position of {ground_truth} lies in the area {within}, so nothing can be "
            "scored. Check that area and positions use the same coordinates."
        )
    if 2 * alone > len(tracked):
        warn([f"{alone} of the {len(tracked)} frames of {tracks} {NO_TRUTH}"])
    common = np.intersect1d(truth_frames, tracked)
    if numbering := _better_numbering(truth, every, common, detection_gate):
        warn([numbering])
    elif anywhere.tp < HARDLY_ANY * min(anywhere.tp + anywhere.fp, anywhere.tp + anywhere.fn):
        warn([f"Hardly any positions of {tracks} and {ground_truth} {ELSEWHERE}"])
    rows = [
        (f"MODA ({detection_gate:g} m)", f"{people.moda:.2f}"),
        ("MODP", f"{people.modp:.2f}"),
        ("precision", f"{people.precision:.2f}"),
        ("recall", f"{people.recall:.2f}"),
    ]
    if (truth[:, 1] >= 0).all() and (predicted[:, 1] >= 0).all():  # identities are known
        paths = tracking_metrics(truth, predicted, scored, tracking_gate)
        rows += [
            (f"MOTA ({tracking_gate:g} m)", f"{paths.mota:.2f}"),
            (f"IDF1 ({tracking_gate:g} m)", f"{paths.idf1:.2f}"),
            ("identity switches", str(paths.id_switches)),
            ("HOTA", f"{hota(truth, predicted, scored).hota:.2f}"),
        ]
    if true.protocol:
        differs = {
            "another area": area is not None,
            "fewer frames": len(scored) < len(truth_frames),
            "other distances": (detection_gate, tracking_gate) != true.gates,
        }
        changed = " and ".join(what for what, is_other in differs.items() if is_other)
        also = f" (but with {changed})" if changed else ""
        print_text(f"Protocol: {true.protocol}{also}.")
    print_table(Table(("measure", "value"), tuple(rows)))


def plot(
    results: Positional[Path],
    out: Path | None = None,
) -> None:
    """Redraw the pictures of a finished run.

    Args:
        results: folder that `catfree run`, `catfree localize` or `catfree demo` wrote.
        out: folder for the pictures; `pictures` in the results folder if not given.
    """
    from catfree._run._result_folder import draw_pictures, read_results

    if joined_recording(results) is not None:
        command = ["catfree", "heat-map", str(results), "--out", "map.csv"]
        raise InvalidInputError(
            f"{results} holds a joined recording, whose tracks are too many for one picture. "
            f"Draw where people were with `{shlex.join(command)}`."
        )
    localization, scene, names = read_results(results)
    folder = results / "pictures" if out is None else out
    for path in draw_pictures(folder, localization, scene, camera_names=names):
        print_text(str(path))


def heat_map(
    results: Positional[Path],
    out: Path | None = None,
    cell: float = 0.5,
    k: int = 5,
) -> None:
    """Count positions per cell of the ground, omitting cells that few people visited.

    Args:
        results: folder that `catfree run`, `catfree localize` or `catfree demo` wrote, or of
            joined shards.
        out: CSV file; `heat_map.csv` in the results folder of a run if not given. With
            matplotlib, a picture is written beside it.
        cell: side of a cell in meters, or in scene units if the scale is unknown.
        k: least number of people in a cell that is shown.
    """
    import importlib.util

    from catfree._run._result_folder import read_results, save_plot
    from catfree.viz import heat_map as count, plot_heat_map, write_heat_map
    from catfree.viz._plan_view import length_unit

    recording = joined_recording(results)
    if recording is None:
        localization, scene, _ = read_results(results)
        tracks = localization.tracks
    elif out is None:
        raise InvalidInputError(
            f"Name a file for the map with --out: {results} holds only the tables of a joined "
            "recording, which other programs read as one."
        )
    else:
        tracks, scene = recording.read(), recording.scene
    heat = count(tracks, cell, k)
    path = write_heat_map(results / "heat_map.csv" if out is None else out, heat)
    shown = int(np.isfinite(heat.positions).sum())
    print_text(f"{path}: {shown} cells" if shown else f"{path}: 0 cells. {BLANK.format(heat.k)}")
    if importlib.util.find_spec("matplotlib") is not None:
        ax = plot_heat_map(heat, unit=length_unit(scene))
        print_text(str(save_plot(ax, path.with_suffix(".png"))))


# By name of the sub-command, in the order of the help.
COMMANDS: dict[str, Callable[..., int | None]] = {
    "run": run,
    "demo": demo,
    "localize": localize,
    "calibrate": calibrate,
    "check": check,
    "evaluate": evaluate,
    "plot": plot,
    "heat-map": heat_map,
    "plan": plan,
    "shard": shard,
    "join": join,
    "run-sites": run_sites,
    "watch": watch,
    "weights": weights,
}
