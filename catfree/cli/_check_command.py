"""The command that checks a rig against the people in its cameras."""

import contextlib
import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tyro.conf import Positional

import catfree
from catfree.cli._inputs import (
    Unit,
    folder_of_results,
    open_boxes,
    open_scene,
    open_videos,
    require_offset,
)
from catfree.cli._terminal import print_table, print_text, progress_bars, warn
from catfree.errors import quoted

PAPER = 90  # gray level of a camera without a picture
NAMED = "It agrees with the others. See the warning that names it."


def check(
    boxes: Positional[tuple[Path, ...]],
    scene: Path,
    out: Path | None = None,
    videos: tuple[Path, ...] = (),
    unit: Unit = "m",
    since: int | None = None,
    image_size: tuple[int, int] | None = None,
    frame_rate: float | None = None,
    silent: Path | None = None,
    offsets: tuple[int, ...] | None = None,
    max_offset: int = 20,
    cache: Path | None = None,
    blur: bool = False,
) -> None:
    """Check whether cameras moved, are late or dead, from the boxes of people.

    Args:
        boxes: MOTChallenge or COCO files, one per camera; a folder of these; one CSV, Parquet,
            uniform JSON or .npz file with the boxes of all cameras; or the results of a run.
        scene: the cameras and ground to check, as for `localize`.
        out: folder for a page with the verdicts; none is written if not given.
        videos: video files or image folders, one per camera of the scene, in its order: the
            page shows a grid of the ground on their last pictures. Without them it shows the
            grid on the last boxes. The frame numbers of boxes and videos must agree, counting from
            0 or from 1.
        unit: length of one unit of a scene whose file does not state it.
        since: frame number before which the cameras are known to fit.
        image_size: width and height of the images in pixels, if boxes do not state them.
        frame_rate: frames per second of the boxes.
        silent: CSV or Parquet table of missing pictures, with the columns frame and camera. If the
            boxes are the results of a run, these already contain it.
        offsets: the frame of each video that shows frame 0 of the boxes. If the boxes are the
            results of a run, these already contain them.
        max_offset: largest clock offset to search for, in frames.
        cache: folder for finished stages.
        blur: make people unrecognizable in the pictures of the videos.
    """
    from catfree._run._run import run_stages
    from catfree.adapters.files._camera_names import positions_of
    from catfree.calibration.watching._check import require_since
    from catfree.errors import InvalidInputError

    require_offset(max_offset)
    if out is None and (videos or blur):
        raise InvalidInputError(
            "--videos and --blur are for the page, which is written only with --out. Give --out, "
            "or leave them out."
        )
    if offsets is not None and not videos:
        raise InvalidInputError("--offsets apply to --videos. Give both, or neither.")
    known_scene, names = open_scene(scene, unit, image_size)
    camera_boxes = open_boxes(boxes, frame_rate, image_size, silent, names)
    require_since(since, camera_boxes.detections)  # report mistakes before the long computation
    footage = None
    if videos:
        count = known_scene.rig.camera_count
        if len(videos) != count:
            raise InvalidInputError(
                f"There are {len(videos)} videos for {count} cameras. Give one per camera, in the "
                "order of the scene."
            )
        if offsets is not None and len(offsets) != count:
            raise InvalidInputError(
                f"There are {len(offsets)} --offsets for {count} videos. Give one per video."
            )
        # Put the scene in the order of the boxes, without cameras that have no boxes.
        place = positions_of(camera_boxes.camera_names, names) if names else None
        place = range(count) if place is None else place
        clock = camera_boxes.detections.clock
        footage = open_videos(
            tuple(videos[camera] for camera in place),
            offsets=[offsets[c] for c in place] if offsets else camera_boxes.offsets or None,
            frame_rate=None if clock is None else clock.frame_rate,
        )
    folder = contextlib.nullcontext() if out is None else folder_of_results(out)
    with folder, progress_bars() as progress:
        outcome = run_stages(
            camera_boxes, scene=known_scene, cache_dir=cache, progress=progress, scene_names=names
        )
        result = catfree.check(
            outcome.scene,
            outcome.detections,
            since=since,
            maximum_offset=max_offset,
            localization=outcome.localization,
            camera_names=outcome.camera_names,
            progress=progress,
        )
    result = refer_to_warnings(result, outcome)
    warn(outcome.warnings)
    print_table(check_table(result, outcome.camera_names))
    for name, camera in zip(outcome.camera_names, result.cameras, strict=True):
        print_text(f"{name}: {camera.advice}")
    if out is not None:
        page = write_check_page(out, result, outcome, footage, blur=blur)
        print_text(f"The page is {page}.")


def refer_to_warnings(result: Any, outcome: Any) -> Any:
    """Refer to the warnings in the advice on cameras that fit but have a warning.

    Args:
        result: a `Check`.
        outcome: the `RunOutcome` of the same boxes, whose warnings quote camera names.
    """
    warnings = " ".join(outcome.warnings)
    cameras = tuple(
        replace(one, advice=NAMED)
        if one.verdict is catfree.Verdict.FITS and quoted(name) in warnings
        else one
        for name, one in zip(outcome.camera_names, result.cameras, strict=True)
    )
    return replace(result, cameras=cameras)


def check_table(result: Any, camera_names: tuple[str, ...]) -> Any:
    """Tabulate the verdicts of a `Check`, one row per camera."""
    from catfree.viz.page._blocks import Table

    rows = []
    for name, camera in zip(camera_names, result.cameras, strict=True):
        since = "" if camera.since is None else f"{camera.since}"
        if camera.since_sd is not None:
            since += f" +- {camera.since_sd:.0f}"
        numbers = (
            f"{camera.degrees:.2f} +- {camera.degrees_sd:.2f}",
            f"{camera.pixels:.0f}" if np.isfinite(camera.pixels) else "",
            f"{camera.ground:.2f}" if np.isfinite(camera.ground) else "",
            f"{camera.lag:.2f} +- {camera.lag_sd:.2f}",
            f"{100 * camera.matched:.0f}" if np.isfinite(camera.matched) else "",
        )
        rows.append((name, camera.verdict.value, since, *numbers))
    length = "m" if result.metric else "scene units"
    header = (
        "camera", "verdict", "since frame", "turned (degrees)", "pixels", f"ground ({length})",
        "late (frames)", "people matched (%)",
    )  # fmt: skip
    return Table(header, tuple(rows))


def write_check_page(out: Path, result: Any, outcome: Any, footage: Any, *, blur: bool) -> Path:
    """Write verdicts, a grid of the ground, coverage and expected accuracy as a page.

    Args:
        out: folder, created if it does not exist.
        result: a `Check`.
        outcome: the `RunOutcome` of the same boxes.
        footage: `SynchronizedVideos` of the cameras, or None.
        blur: make people unrecognizable.

    Returns:
        The HTML file `report.html`; `report.md` has the same content.

    Raises:
        InvalidInputError: if the footage does not fit the scene, or must be blurred but shares no
            frame with the boxes.
        WriteError: if the disk is full or not writable.
    """
    from catfree._run._report import describe_acceptance, describe_warnings
    from catfree.errors import CatFreeError
    from catfree.types._writing import make_folder
    from catfree.viz.page._blocks import (
        Block,
        Heading,
        Paragraph,
        Picture,
        Verdicts,
        write_blocks,
    )

    folder = make_folder(out)
    passed = {catfree.Verdict.FITS: True, catfree.Verdict.DOUBTFUL: None}
    verdicts = Verdicts(
        tuple(
            (f"{name} {one.verdict.value}", one.advice, passed.get(one.verdict, False))
            for name, one in zip(outcome.camera_names, result.cameras, strict=True)
        )
    )
    blocks: list[Block] = [
        Heading("catfree check", 1),
        *describe_warnings(outcome.warnings),
        Paragraph(
            f"Frames {result.first} to {result.last}, compared in windows of "
            f"{result.window:.3g} seconds."
        ),
        verdicts,
        check_table(result, outcome.camera_names),
    ]
    grid = _draw_grid(folder, outcome, footage, blur)
    blocks.append(Picture(grid.name, "the ground as the scene has it, in units of the scene"))
    try:
        covered = catfree.coverage(outcome.scene)
    except CatFreeError:  # for instance if the cameras see no common ground
        covered = None
    blocks += describe_acceptance(outcome, covered)
    if covered is not None and importlib.util.find_spec("matplotlib") is not None:
        from catfree._run._result_folder import save_plot
        from catfree.viz import plot_coverage

        ax = plot_coverage(covered, outcome.scene, camera_names=outcome.camera_names)
        save_plot(ax, folder / "coverage.png")
        blocks.append(Picture("coverage.png", "expected uncertainty over the ground"))
    return write_blocks(folder, blocks)[1]


def _draw_grid(folder: Path, outcome: Any, footage: Any, blur: bool) -> Path:
    """Draw the grid on the last pictures, or on the boxes of a full instant near the end.

    Pictures to blur are the last with boxes, whose frames may count from 0 or from 1.
    """
    from catfree.errors import InvalidInputError
    from catfree.viz._person_height import person_height
    from catfree.viz.footage._blur import blur_people
    from catfree.viz.footage._contact_sheet import draw_boxes, write_sheet
    from catfree.viz.footage._ground_grid import draw_ground_grids

    scene, boxes = outcome.scene, outcome.detections
    if footage is not None:
        last = footage.frame_count - 1
        if blur:
            with_boxes = np.flatnonzero(np.isin(footage.frames, boxes.frame))
            # Box files of a run number its instants, which may be every fifth frame.
            if not len(with_boxes) or with_boxes[-1] < footage.frame_count / 2:
                raise InvalidInputError(
                    "The frame numbers of the boxes are not those of the videos, so people cannot "
                    "be blurred: give the `detections.npz` of a run, which has them."
                )
            last = with_boxes[-1]
        frame, images = next(footage.instants_from(int(last)))
        if blur:
            results = (boxes, outcome.localization, scene)
            for number in (frame, frame + 1):
                images = blur_people(images, number, *results, person_height(*results))
    else:
        late = boxes[boxes.frame >= np.quantile(boxes.frame, 0.9)]
        frame, count = np.unique(late.frame, return_counts=True)
        fullest = late[late.frame == frame[count.argmax()]]
        images = [
            draw_boxes(
                np.full((height, width, 3), PAPER, np.uint8), fullest[fullest.camera == camera]
            )
            for camera, (width, height) in enumerate(np.asarray(scene.rig.image_size))
        ]
    return write_sheet(folder / "ground_grid.jpg", draw_ground_grids(images, scene))
