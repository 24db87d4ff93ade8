"""The part of a run that the report page plays, and its pictures."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.types import Detections, Localization, Scene
from catfree.viz._person_height import person_height as estimate_person_height
from catfree.viz.footage._blur import blur_people
from catfree.viz.footage._contact_sheet import Board, write_jpeg

RATE = 5.0  # instants per second of the page; footage of a higher rate is thinned out
MOST_PICTURES = 600  # of all cameras together
MOST_INSTANTS, MOST_POSITIONS = 2000, 20_000  # of a page without pictures
BOARD_WIDTH, LARGEST_TILE = 1280, 480  # pixels
QUALITY = 70  # of the JPEG files


@dataclass(frozen=True)
class Excerpt:
    """Successive instants of a run.

    Attributes:
        frames: (T,) their frame numbers.
        rate: instants per second.
        total: number of instants of the run.
    """

    frames: Int[np.ndarray, " t"]
    rate: float
    total: int


def choose_excerpt(
    frames: Int[np.ndarray, " t"],
    tracked: Int[np.ndarray, " m"],
    cameras: int,
    frame_rate: float | None,
    *,
    pictured: bool,
) -> Excerpt:
    """Choose the successive instants with the most positions that a page can show.

    Args:
        frames: (T,) sorted frame numbers of the run.
        tracked: (M,) frame number of each position.
        cameras: number of cameras.
        frame_rate: instants of the run per second, or None if unknown.
        pictured: whether the page has pictures, whose number is limited.
    """
    rate = RATE if frame_rate is None else frame_rate
    stride = max(round(rate / RATE), 1) if pictured else 1
    count = np.bincount(np.searchsorted(frames, tracked), minlength=len(frames))[: len(frames)]
    length = max(MOST_PICTURES // cameras, 2) if pictured else MOST_INSTANTS
    length *= stride
    until = np.concatenate([[0], np.cumsum(count)])
    starts = np.arange(max(len(frames) - length, 0) + 1)
    first = int(np.argmax(until[np.minimum(starts + length, len(frames))] - until[starts]))
    chosen = np.arange(first, min(first + length, len(frames)), stride)
    if not pictured and len(chosen):
        within = until[chosen + 1] - until[first] <= MOST_POSITIONS
        chosen = chosen[: max(int(within.sum()), 1)]
    return Excerpt(frames[chosen], rate / stride, len(frames))


def arrange(image_size: Int[np.ndarray, "cam 2"]) -> Board:
    """Lay out the cameras' pictures in the pictures of the page."""
    columns = math.ceil(math.sqrt(len(image_size)))
    width = min(BOARD_WIDTH // columns, LARGEST_TILE)
    height = max(round(width * float((image_size[:, 1] / image_size[:, 0]).max())), 1)
    return Board.of(image_size, columns, (width, height))


def write_pictures(
    folder: Path,
    videos: SynchronizedVideos,
    excerpt: Excerpt,
    detections: Detections,
    localization: Localization,
    scene: Scene,
    *,
    blur: bool = False,
) -> list[Path]:
    """Write the pictures of an excerpt, one file of all cameras for each instant.

    Args:
        folder: created if it does not exist; pictures of an earlier run are removed.
        videos: the footage.
        excerpt: which instants.
        detections: person boxes, for `blur`.
        localization: positions, for `blur`.
        scene: the scene used for it.
        blur: make people unrecognizable.

    Returns:
        `FRAME.jpg` for each instant that can be decoded, with six digits or more.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in earlier_pictures(folder):
        old.unlink()
    if not len(excerpt.frames):
        return []
    board, wanted = arrange(videos.image_size), set(excerpt.frames.tolist())
    part = videos.between(int(excerpt.frames[0]), int(excerpt.frames[-1]) + 1)
    height = estimate_person_height(detections, localization, scene) if blur else 0.0
    files = []
    for frame, images in part:
        if frame not in wanted:
            continue
        if blur:
            images = blur_people(images, frame, detections, localization, scene, height)
        picture = board.assemble(images, quick=True)
        files.append(write_jpeg(folder / f"{frame:06d}.jpg", picture, QUALITY))
    return files


def earlier_pictures(folder: Path) -> list[Path]:
    """List the files in a folder, if it exists, that are named as by `write_pictures`."""
    return [path for path in folder.glob("*.jpg") if path.stem.removeprefix("-").isdecimal()]
