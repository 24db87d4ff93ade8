"""Output of a failed run: the boxes, a picture of them, and a report with the error."""

import os
from pathlib import Path

import numpy as np

from catfree._run._report import (
    Block,
    Heading,
    Paragraph,
    Picture,
    Table,
    describe_footage,
    describe_warnings,
    write_blocks,
)
from catfree._run._result_folder import write_boxes
from catfree._run._run import Unfinished
from catfree.adapters.video import SynchronizedVideos
from catfree.errors import CatFreeError
from catfree.types import Detections
from catfree.viz.footage._contact_sheet import draw_boxes, write_sheet


def write_failure(
    folder: str | os.PathLike[str], error: CatFreeError, unfinished: Unfinished
) -> list[Path]:
    """Write the partial results of a failed run.

    Args:
        folder: created if it does not exist.
        error: why it failed.
        unfinished: the partial results; nothing is written before detection has finished.

    Returns:
        The files: `boxes/CAMERA.txt`, `detections.npz`, `pictures/boxes.jpg`, `report.md` and
        `report.html`.

    Raises:
        CatFreeError: if a file cannot be written, or the footage cannot be read again.
        OSError: if the disk is full or not writable.
    """
    videos, detections = unfinished.videos, unfinished.detections
    if videos is None or detections is None:
        return []
    root = Path(folder)
    (root / "pictures").mkdir(parents=True, exist_ok=True)
    files = write_boxes(root / "boxes", detections, videos.camera_names, videos.frames)
    detections.save(root / "detections.npz")
    sheet = root / "pictures" / "boxes.jpg"
    write_sheet(sheet, _fullest_instant(videos, detections))
    blocks: list[Block] = [
        Heading("catfree report", 1),
        Heading("Why this run failed"),
        Paragraph(str(error)),
        *describe_warnings(unfinished.warnings),
        Heading("What the detector saw"),
        Picture("pictures/boxes.jpg", "the instant with the most boxes"),
        box_table(videos, detections),
        *describe_footage(videos),
    ]
    return [*files, root / "detections.npz", sheet, *write_blocks(root, blocks)]


def box_table(videos: SynchronizedVideos, detections: Detections) -> Table:
    """Number, median height and median score of the boxes, one row per camera."""
    rows = []
    for camera, name in enumerate(videos.camera_names):
        boxes = detections[detections.camera == camera]
        height = f"{np.median(boxes.height):.0f}" if len(boxes) else ""
        sure = "" if boxes.score is None or not len(boxes) else f"{np.median(boxes.score):.2f}"
        rows.append((name, str(len(boxes)), height, sure))
    header = ("camera", "boxes", "median height (px)", "median score")
    return Table(header, tuple(rows))


def _fullest_instant(videos: SynchronizedVideos, detections: Detections) -> list[np.ndarray]:
    """Images of the instant with the most boxes, with the boxes drawn."""
    instant = np.searchsorted(videos.frames, detections.frame)
    count = np.bincount(instant, minlength=len(videos.frames))
    frame, images = next(videos.instants_from(int(count.argmax())))
    boxes = detections[detections.frame == frame]
    return [draw_boxes(image, boxes[boxes.camera == camera]) for camera, image in enumerate(images)]
