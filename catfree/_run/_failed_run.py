"""Output of a failed run: the boxes, a picture of them, and a report with the error."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from catfree._run._report import describe_footage, describe_warnings
from catfree._run._result_folder import (
    earlier_results,
    earlier_views,
    numbers_of_files,
    remove_unless_written,
    write_boxes,
)
from catfree._run._run import Unfinished
from catfree.adapters.datasets._detection_files import RESULT_OFFSETS, RESULT_SILENT
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import CatFreeError, shortened
from catfree.geometry._person import cut_by_border
from catfree.settings import EvidenceSettings
from catfree.types import Detections
from catfree.viz.footage._blur import blur_regions
from catfree.viz.footage._contact_sheet import draw_boxes, write_sheet
from catfree.viz.page._blocks import Block, Heading, Notice, Picture, Table, write_blocks

MOSTLY_HIDDEN = 0.5  # share of boxes with visible feet below which the report says so


def write_failure(
    root: Path,
    error: CatFreeError,
    unfinished: Unfinished,
    *,
    embeddings: bool = False,
    blur: bool = False,
    pictures: bool = True,
) -> list[Path]:
    """Write the partial results of a failed run.

    Args:
        root: the result folder, created if it does not exist; pictures and boxes of an earlier run
            are removed; its tracks and cameras are kept and listed in the report.
        error: why it failed.
        unfinished: the partial results; boxes are written only for videos, after detection has
            finished.
        embeddings: write the boxes' appearance vectors, too.
        blur: make the people in the picture unrecognizable.
        pictures: write the picture.

    Returns:
        The files: `boxes/CAMERA.txt`, `detections.npz`, with `pictures` also `pictures/boxes.jpg`,
        `report.md` and `report.html`.

    Raises:
        CatFreeError: if a file cannot be written, or the footage cannot be read again.
        OSError: if the disk is full or not writable.
    """
    videos, detections = unfinished.recording, unfinished.detections
    if not isinstance(videos, SynchronizedVideos) or detections is None:
        return []
    numbers = numbers_of_files(videos.frames)
    files = write_boxes(root, detections, videos.camera_names, numbers, embeddings=embeddings)
    shown: list[Block] = []
    if pictures:
        sheet = root / "pictures" / "boxes.jpg"
        sheet.parent.mkdir(exist_ok=True)
        write_sheet(sheet, _fullest_instant(videos, detections, blur))
        files.append(sheet)
        shown.append(Picture("pictures/boxes.jpg", "the instant with the most boxes"))
    of_boxes = [root / name for name in (RESULT_SILENT, RESULT_OFFSETS)]
    remove_unless_written([*earlier_views(root), *of_boxes], files)
    leftover = [
        path.relative_to(root).as_posix() for path in earlier_results(root) if path not in files
    ]
    earlier = f"Left in this folder by an earlier run: {', '.join(leftover)}."
    cameras = range(len(videos.camera_names))
    per_camera = [detections[detections.camera == camera] for camera in cameras]
    feet = [share_of_feet(per_camera[camera], videos.image_size[camera]) for camera in cameras]
    blocks: list[Block] = [
        Heading("catfree report", 1),
        Notice("Why this run failed", (str(error), *hidden_feet(videos.camera_names, feet))),
        *([Notice("Files of an earlier run", (earlier,))] if leftover else []),
        *describe_warnings(unfinished.warnings),
        Heading("What the detector saw"),
        *shown,
        box_table(videos.camera_names, per_camera, feet),
        *describe_footage(videos),
    ]
    return [*files, *write_blocks(root, blocks)]


def box_table(
    names: Sequence[str], per_camera: Sequence[Detections], feet: Sequence[float | None]
) -> Table:
    """Tabulate number, median height, median score and visible feet of the boxes, by camera."""
    rows = []
    for name, boxes, share in zip(names, per_camera, feet, strict=True):
        height = f"{np.median(boxes.height):.0f}" if len(boxes) else ""
        sure = "" if boxes.score is None or not len(boxes) else f"{np.median(boxes.score):.2f}"
        rows.append((name, str(len(boxes)), height, sure, "" if share is None else f"{share:.0%}"))
    header = ("camera", "boxes", "median height (px)", "median score", "feet seen")
    return Table(header, tuple(rows))


def share_of_feet(boxes: Detections, image_size: Int[np.ndarray, " axis"]) -> float | None:
    """Compute the share of one camera's boxes with visible feet; None if there are no boxes.

    Feet are hidden where the detector found no ankles, or where the image border cuts the box.
    """
    if not len(boxes):
        return None
    visible = ~cut_by_border(boxes.box, image_size, EvidenceSettings().border_margin)[:, 2]
    if boxes.ankles_confirmed is not None:
        visible = visible & boxes.ankles_confirmed
    return float(visible.mean())


def hidden_feet(names: Sequence[str], feet: Sequence[float | None]) -> tuple[str, ...]:
    """Name the cameras that see the feet of fewer than half of the people, in one sentence."""
    few = [
        f"{shortened(name)} ({share:.0%} of the boxes)"
        for name, share in zip(names, feet, strict=True)
        if share is not None and share < MOSTLY_HIDDEN
    ]
    if not few:
        return ()
    return (
        f"Feet are mostly hidden, by objects or by the lower image border, in {', '.join(few)}. "
        "Cameras and people are placed by feet on the ground: turn or raise such a camera until "
        "it sees open floor, or record for longer.",
    )


def _fullest_instant(
    videos: SynchronizedVideos, detections: Detections, blur: bool
) -> list[np.ndarray]:
    """Draw the boxes on the images of the instant with the most boxes."""
    instant = np.searchsorted(videos.frames, detections.frame)
    count = np.bincount(instant, minlength=len(videos.frames))
    frame, images = next(videos.instants_from(int(count.argmax())))
    boxes = detections[detections.frame == frame]
    drawn = []
    for camera, image in enumerate(images):
        camera_boxes = boxes[boxes.camera == camera]
        drawn.append(
            draw_boxes(blur_regions(image, camera_boxes.box) if blur else image, camera_boxes)
        )
    return drawn
