"""Images of all cameras side by side in one file."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.files._documents import write_bytes_atomically
from catfree.adapters.protocols import Image
from catfree.types import Detections
from catfree.viz._palette import TRACK_COLORS
from catfree.viz.footage._drawing import default_stroke, draw_box

VIEW_WIDTH = 640  # pixels per camera


@dataclass(frozen=True)
class Board:
    """Pictures of all cameras in rows of equal tiles.

    Attributes:
        size: width and height in pixels.
        tile: width and height of a tile.
        tiles: (C, 4) x, y, width and height of each camera's picture, in the upper left corner of
            its tile.
        scale: (C,) size of that picture, as a share of the original.
    """

    size: tuple[int, int]
    tile: tuple[int, int]
    tiles: Int[np.ndarray, "cam 4"]
    scale: Float[np.ndarray, " cam"]

    @classmethod
    def of(
        cls, image_size: Int[np.ndarray, "cam 2"], columns: int, tile: tuple[int, int]
    ) -> "Board":
        """Arrange pictures (C, 2) of these widths and heights in tiles of one width and height."""
        scale = (np.array(tile) / image_size).min(1)
        sizes = np.maximum(np.round(image_size * scale[:, None]), 1).astype(int)
        row, column = np.divmod(np.arange(len(sizes)), columns)
        tiles = np.column_stack([column * tile[0], row * tile[1], sizes])
        size = columns * tile[0], -(-len(sizes) // columns) * tile[1]
        return cls(size, tile, tiles, scale)

    def assemble(
        self, images: Sequence[Image], *, background: int = 0, quick: bool = False
    ) -> Image:
        """Put one picture (H, W, 3) per camera together.

        Args:
            images: uint8 RGB of the sizes that the board was made for.
            background: gray level of the empty parts.
            quick: shrink them by plain interpolation, which is as good as averaging for pictures
                close to the size of a tile.
        """
        import cv2

        board = np.full((self.size[1], self.size[0], 3), background, np.uint8)
        how = cv2.INTER_LINEAR if quick else cv2.INTER_AREA
        for (x, y, width, height), image in zip(self.tiles.tolist(), images, strict=True):
            step = max(int(image.shape[1] / width / 2), 1) if quick else 1
            small = cv2.resize(image[::step, ::step], (width, height), interpolation=how)
            board[y : y + height, x : x + width] = small
        return board


def write_jpeg(path: str | os.PathLike[str], image: Image, quality: int = 95) -> Path:
    """Write an RGB image as a JPEG file and return its path."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1]
    return write_bytes_atomically(Path(path), encoded.tobytes())


def write_sheet(path: str | os.PathLike[str], images: Sequence[Image]) -> Path:
    """Write images side by side as one JPEG file.

    Args:
        path: the JPEG file.
        images: (H, W, 3) uint8 RGB, one per camera, of any sizes.

    Returns:
        The path.
    """
    sizes = np.array([image.shape[1::-1] for image in images])
    tile = VIEW_WIDTH, round(VIEW_WIDTH * images[0].shape[0] / images[0].shape[1])
    board = Board.of(sizes, math.ceil(math.sqrt(len(images))), tile)
    return write_jpeg(path, board.assemble(images, background=255))


def draw_boxes(image: Image, boxes: Detections) -> Image:
    """Draw boxes on a copy of an image.

    Args:
        image: (H, W, 3) uint8 RGB.
        boxes: the boxes of this image.
    """
    canvas = image.copy()
    for box in boxes.box:
        draw_box(canvas, box, TRACK_COLORS[1], default_stroke(image))
    return canvas
