"""The commands of the command line."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

import catfree
from catfree.cli._inputs import (
    open_detector,
    open_embedder,
    open_reconstructor,
    open_scene,
    open_videos,
    read_truth,
    require_files,
    settings_of,
)
from catfree.cli._shard_commands import shard_commands
from catfree.cli._terminal import (
    INTERRUPTED,
    fail,
    print_result,
    print_table,
    print_text,
    progress_bars,
    require_tyro,
    warn,
)
from catfree.cli._weights_commands import weights_commands
from catfree.errors import CatFreeError, InsufficientDataError


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the arguments after `catfree`; None for those of the process. `--version` alone
            prints the version.

    Returns:
        The exit code: 0, or 1 after an error, which is one sentence on standard error. Invalid
        arguments exit with 2.
    """
    if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        print_text(f"catfree {catfree.__version__}")
        return 0
    try:
        tyro = require_tyro()
        code = tyro.extras.subcommand_cli_from_dict(
            _commands(tyro) | shard_commands(tyro) | weights_commands(tyro),
            prog="catfree",
            description="Track people on the ground from videos of static cameras. "
            "`--version` prints the version.",
            args=arguments,
        )
    except CatFreeError as error:
        return fail(str(error))
    except OSError as error:
        return fail(f"{error.filename or 'A file'}: {error.strerror or error}.")
    except KeyboardInterrupt:
        fail("Interrupted. Run the command again to resume from the finished stages.")
        return INTERRUPTED
    return code or 0


@contextlib.contextmanager
def _report_of_failure(out: Path, *, embeddings: bool = False, blur: bool = False) -> Iterator[Any]:
    """Yield the partial results of a run; if it fails, write them and name the report."""
    from catfree._run._failed_run import write_failure
    from catfree._run._run import Unfinished

    unfinished = Unfinished()
    try:
        yield unfinished
    except CatFreeError as error:
        try:
            files = write_failure(out, error, unfinished, embeddings=embeddings, blur=blur)
        except (CatFreeError, OSError):  # report the first error
            files = []
        if not files:
            raise
        message = f"{error} A picture of the detected boxes is in {out / 'report.html'}."
        raise type(error)(message) from error


def _commands(tyro: Any) -> dict[str, Callable[..., None]]:
    """Sub-commands by name, built here because their annotations need tyro."""
    positional = tyro.conf.Positional

    def run(
        videos: Annotated[tuple[Path, ...], positional],
        out: Path = Path("catfree_results"),
        detector: Path | None = None,
        embedder: Path | None = None,
        reconstructor: Path | None = None,
        scene: Path | None = None,
        method: Literal["default", "paper", "evidence"] = "default",
        cache: Path | None = None,
        stride: int = 1,
        start: int | None = None,
        end: int | None = None,
        offsets: tuple[int, ...] | None = None,
        frame_rate: float | None = None,
        keep_before_damage: bool = False,
        max_offset: int = 0,
        pictures: bool = True,
        overlay: bool = False,
        blur: bool = False,
        embeddings: bool = False,
    ) -> None:
        """Track the people in the videos of several static cameras.

        Args:
            videos: one video file or image folder per camera.
            out: folder for the results.
            detector: ONNX file of a person detector (YOLO11-pose, YOLOv8-pose or YOLOX), or a name
                of `catfree weights list`; without it people are found by background subtraction.
            embedder: ONNX file of a re-identification network, or a name of that list.
            reconstructor: ONNX file of VGGT, which finds the cameras from the images.
            scene: known cameras and ground (scene.json); without it and without a reconstructor
                they are found from the people.
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
            pictures: draw plots, and write pictures of the cameras for the report.
            overlay: write a video of all cameras with the tracks drawn in.
            blur: make people unrecognizable in pictures and overlay.
            embeddings: write the appearance vectors, which recognize people, to detections.npz.
        """
        require_files(
            videos,
            detector=detector,
            embedder=embedder,
            reconstructor=reconstructor,
            scene=scene,
        )
        from catfree._run._report import footage_table
        from catfree._run._result_folder import write_folder, write_overlay
        from catfree._run._run import run_stages

        settings = settings_of(method)
        footage = open_videos(
            videos,
            stride=stride,
            start=start,
            end=end,
            offsets=offsets,
            frame_rate=frame_rate,
            on_error="keep" if keep_before_damage else "raise",
        )
        known, names = open_scene(scene)
        networks = open_detector(detector), open_embedder(embedder)
        finder = open_reconstructor(reconstructor)
        print_table(footage_table(footage), aside=True)
        on_failure = _report_of_failure(out, embeddings=embeddings, blur=blur)
        with on_failure as unfinished, progress_bars() as progress:
            outcome = run_stages(
                footage,
                *networks,
                finder,
                known,
                settings,
                cache_dir=out / "cache" if cache is None else cache,
                progress=progress,
                scene_names=names,
                maximum_offset=max_offset,
                unfinished=unfinished,
            )
        footage = outcome.videos or footage
        if footage.interruption is not None:
            fail(f"Used only the footage before the damage: {footage.interruption}")
        drawn = None if pictures else False
        write_folder(
            out,
            outcome,
            settings,
            videos=footage,
            pictures=drawn,
            embeddings=embeddings,
            blur=blur,
            overlay=overlay,
        )
        if overlay:
            with progress_bars() as progress:
                write_overlay(out, footage, outcome, progress, blur=blur)
        warn(outcome.warnings)
        print_result(outcome, out)

    def demo(
        out: Path = Path("catfree_demo"),
        seed: int = 0,
        cameras: int = 6,
        people: int = 14,
        frames: int = 200,
        size: tuple[int, int] = (1280, 720),
        method: Literal["default", "paper", "evidence"] = "default",
        workers: int | None = None,
        pictures: bool = True,
        blur: bool = False,
    ) -> None:
        """Render a synthetic world, track its people from the videos alone, and score the tracks.

        Args:
            out: folder for videos and results.
            seed: of the random world.
            cameras: cameras around the square.
            people: people on the square at a time.
            frames: number of frames, 5 per second.
            size: width and height of the videos in pixels.
            method: the localization method.
            workers: rendering processes; one per processor if not given.
            pictures: draw plots, and write pictures of the cameras for the report.
            blur: make people unrecognizable in the pictures of the results.
        """
        from catfree.cli._demo import EASY, run_demo, score_table

        with progress_bars() as progress:
            done = run_demo(
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
        print_table(score_table(done.scores))
        warn(done.outcome.warnings)
        print_result(done.outcome, out)
        print_text(EASY)

    def calibrate(
        videos: Annotated[tuple[Path, ...], positional],
        out: Path = Path("catfree_rig"),
        detector: Path | None = None,
        cache: Path | None = None,
        stride: int = 1,
        offsets: tuple[int, ...] | None = None,
        keep_before_damage: bool = False,
        max_offset: int = 0,
    ) -> None:
        """Find cameras and ground in meters from the people in the videos.

        Args:
            videos: one video file or image folder per camera.
            out: folder for scene.json and the rig in other formats.
            detector: ONNX file of a person detector, or a name of `catfree weights list`; without
                it people are found by background subtraction.
            cache: folder for finished stages; `cache` in the output folder if not given.
            stride: use every stride-th frame.
            offsets: the frame of each camera that shows the first common instant.
            keep_before_damage: use the footage before a frame that cannot be decoded.
            max_offset: largest clock offset of a single camera, in frames, to search and correct.
        """
        require_files(videos, detector=detector)
        from catfree._run._cache import StageCache
        from catfree._run._input_checks import (
            calibration_warnings,
            footage_warnings,
            require_distinct_videos,
        )
        from catfree._run._report import camera_table, footage_table
        from catfree._run._result_folder import write_rig
        from catfree._run._stages import calibrate_cameras, detect
        from catfree.adapters.background._background_detector import BackgroundDetector
        from catfree.settings import Settings

        on_error = "keep" if keep_before_damage else "raise"
        footage = open_videos(videos, stride=stride, offsets=offsets, on_error=on_error)
        finder = open_detector(detector) or BackgroundDetector()
        print_table(footage_table(footage), aside=True)
        require_distinct_videos(footage)
        stages = StageCache(out / "cache" if cache is None else cache)
        with _report_of_failure(out) as unfinished, progress_bars() as progress:
            unfinished.videos, unfinished.warnings = footage, footage_warnings(footage)
            boxes = detect(footage, finder, cache=stages, progress=progress)
            unfinished.detections = boxes
            calibration = calibrate_cameras(
                footage,
                finder,
                boxes,
                maximum_offset=max_offset,
                cache=stages,
                progress=progress,
            )
            warnings = unfinished.warnings + calibration_warnings(
                calibration, boxes, footage, Settings()
            )
        if footage.interruption is not None:
            fail(f"Used only the footage before the damage: {footage.interruption}")
        write_rig(out, calibration.scene, footage.camera_names)
        warn(warnings)
        print_table(camera_table(calibration.scene, footage.camera_names, calibration))
        print_text(f"The rig is in {out}.")

    def evaluate(
        tracks: Annotated[Path, positional],
        ground_truth: Annotated[Path, positional],
        area: tuple[float, float, float, float] | None = None,
        threshold: float = 0.5,
        track_threshold: float = 1.0,
    ) -> None:
        """Score tracks against true positions in the same coordinates.

        Args:
            tracks: tracks.csv of a run.
            ground_truth: CSV with a header and the columns frame, id, x, y.
            area: x_min x_max y_min y_max; positions outside are ignored.
            threshold: largest distance of a match for MODA, in meters.
            track_threshold: the same for MOTA and IDF1.
        """
        from catfree.adapters.tables._tracks_table import read_tracks_csv
        from catfree.evaluation import crop, detection_metrics, hota, tracking_metrics
        from catfree.viz.page._blocks import Table

        truth, found = read_truth(ground_truth), read_tracks_csv(tracks).to_rows()
        frames = np.unique(np.concatenate([truth[:, 0], found[:, 0]]))
        if area is not None:
            truth, found = crop(truth, area), crop(found, area)
        if not len(truth):
            raise InsufficientDataError(
                f"No position of {ground_truth} lies in the area {area}, so nothing can be scored. "
                "Check that area and positions use the same coordinates."
            )
        people = detection_metrics(truth, found, frames, threshold)
        paths = tracking_metrics(truth, found, frames, track_threshold)
        rows = (
            (f"MODA ({threshold:g} m)", f"{people.moda:.2f}"),
            ("MODP", f"{people.modp:.2f}"),
            ("precision", f"{people.precision:.2f}"),
            ("recall", f"{people.recall:.2f}"),
            (f"MOTA ({track_threshold:g} m)", f"{paths.mota:.2f}"),
            (f"IDF1 ({track_threshold:g} m)", f"{paths.idf1:.2f}"),
            ("identity switches", str(paths.id_switches)),
            ("HOTA", f"{hota(truth, found, frames).hota:.2f}"),
        )
        print_table(Table(("measure", "value"), rows))

    def plot(
        results: Annotated[Path, positional],
        out: Path | None = None,
    ) -> None:
        """Draw the pictures of a finished run again.

        Args:
            results: folder that `catfree run` or `catfree demo` wrote.
            out: folder for the pictures; `pictures` in the results folder if not given.
        """
        from catfree._run._result_folder import draw_pictures, read_results

        localization, scene, names = read_results(results)
        folder = results / "pictures" if out is None else out
        for path in draw_pictures(folder, localization, scene, camera_names=names):
            print_text(str(path))

    def heat_map(
        results: Annotated[Path, positional],
        out: Path | None = None,
        cell: float = 0.5,
        k: int = 5,
    ) -> None:
        """Count positions per cell of the ground, without cells that few people visited.

        Args:
            results: folder that `catfree run` or `catfree demo` wrote.
            out: CSV file; `heat_map.csv` in the results folder if not given. With matplotlib, a
                picture is written beside it.
            cell: side of a cell in meters, or in scene units if the scale is unknown.
            k: fewest people of a cell that is shown.
        """
        import importlib.util

        from catfree._run._result_folder import draw_heat_map, read_results
        from catfree.viz._heat_map import heat_map as count, write_heat_map

        localization, scene, _ = read_results(results)
        heat = count(localization.tracks, cell, k)
        path = write_heat_map(results / "heat_map.csv" if out is None else out, heat)
        print_text(f"{path}: {int(np.isfinite(heat.positions).sum())} cells")
        if importlib.util.find_spec("matplotlib") is not None:
            print_text(str(draw_heat_map(path.with_suffix(".png"), heat, scene)))

    return {
        "run": run,
        "demo": demo,
        "calibrate": calibrate,
        "evaluate": evaluate,
        "plot": plot,
        "heat-map": heat_map,
    }
