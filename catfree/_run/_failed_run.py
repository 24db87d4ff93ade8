"""Output of a failed run: the boxes, a picture of them, and a report with the error."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from catfree._run._report import describe_footage, describe_warnings
from catfree._run._result_folder import write_boxes
from catfree._run._run import Unfinished
from catfree.adapters.video import SynchronizedVideos
from catfree.errors import CatFreeError
from catfree.types import Detections
from catfree.viz.footage._blur import blur_regions
from catfree.viz.footage._contact_sheet import draw_boxes, write_sheet
from catfree.viz.page._blocks import Block, Heading, Notice, Picture, Table, write_blocks


def write_failure(
    folder: str | os.PathLike[str],
    error: CatFreeError,
    unfinished: Unfinished,
    *,
    embeddings: bool = False,
    blur: bool = False,
) -> list[Path]:
    """Write the partial results of a failed run.

    Args:
        folder: created if it does not exist.
        error: why it failed.
        unfinished: the partial results; nothing is written before detection has finished.
        embeddings: write the boxes' appearance vectors, too.
        blur: make the people in the picture unrecognizable.

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
    stored = detections if embeddings else replace(detections, embedding=None)
    stored.save(root / "detections.npz")
    sheet = root / "pictures" / "boxes.jpg"
    write_sheet(sheet, _fullest_instant(videos, detections, blur))
    blocks: list[Block] = [
        Heading("catfree report", 1),
        Notice("Why this run failed", (str(error),)),
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


def _fullest_instant(
    videos: SynchronizedVideos, detections: Detections, blur: bool
) -> list[np.ndarray]:
    """Images of the instant with the most boxes, with the boxes drawn."""
    instant = np.searchsorted(videos.frames, detections.frame)
    count = np.bincount(instant, minlength=len(videos.frames))
    frame, images = next(videos.instants_from(int(count.argmax())))
    boxes = detections[detections.frame == frame]
    drawn = []
    for camera, image in enumerate(images):
        own = boxes[boxes.camera == camera]
        drawn.append(draw_boxes(blur_regions(image, own.box) if blur else image, own))
    return drawn
