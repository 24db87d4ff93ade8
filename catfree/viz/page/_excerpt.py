"""The part of a run that the report page plays, and its pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from catfree.adapters.files._documents import write_bytes_atomically
from catfree.adapters.video import SynchronizedVideos
from catfree.types import Detections, Localization, Scene
from catfree.viz._person_height import person_height as estimate_person_height
from catfree.viz.footage._blur import blur_people

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


@dataclass(frozen=True)
class Board:
    """Where each camera's picture is in the pictures of the page.

    Attributes:
        size: width and height of a picture of all cameras in pixels.
        tiles: x, y, width and height of each camera's part.
    """

    size: tuple[int, int]
    tiles: tuple[tuple[int, int, int, int], ...]


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
        cameras: their number.
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
    """Arrange the cameras' pictures in rows, one tile each."""
    count = len(image_size)
    columns = 1 + int(np.sqrt(max(count - 1, 0)))
    width = min(BOARD_WIDTH // columns, LARGEST_TILE)
    height = max(round(width * float((image_size[:, 1] / image_size[:, 0]).max())), 1)
    tiles = []
    for camera, (w, h) in enumerate(image_size):
        row, column = divmod(camera, columns)
        scale = min(width / w, height / h)
        size = max(round(float(w * scale)), 1), max(round(float(h * scale)), 1)
        tiles.append((column * width, row * height, *size))
    return Board((columns * width, -(-count // columns) * height), tuple(tiles))


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
        scene: the scene it was made with.
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
        path = folder / f"{frame:06d}.jpg"
        files.append(write_bytes_atomically(path, _encode(board, images)))
    return files


def earlier_pictures(folder: Path) -> list[Path]:
    """The files in a folder, if it exists, whose names `write_pictures` gives."""
    return [path for path in folder.glob("*.jpg") if path.stem.removeprefix("-").isdecimal()]


def _encode(board: Board, images: Sequence[np.ndarray]) -> bytes:
    import cv2

    sheet = np.zeros((board.size[1], board.size[0], 3), np.uint8)
    for (x, y, width, height), image in zip(board.tiles, images, strict=True):
        # Close to the tile's size, plain interpolation is as good as an average, and much faster.
        step = max(int(image.shape[1] / width / 2), 1)
        small = cv2.resize(image[::step, ::step], (width, height), interpolation=cv2.INTER_LINEAR)
        sheet[y : y + height, x : x + width] = small
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    return cv2.imencode(".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), options)[1].tobytes()
