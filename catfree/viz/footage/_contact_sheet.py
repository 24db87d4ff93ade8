"""Images of all cameras side by side in one file."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from catfree.adapters.files._documents import write_bytes_atomically
from catfree.types import Detections
from catfree.viz._palette import TRACK_COLORS
from catfree.viz.footage._drawing import Image, default_stroke, draw_box

VIEW_WIDTH = 640  # pixels per camera


def write_sheet(path: str | os.PathLike[str], images: Sequence[Image]) -> Path:
    """Write images side by side as one JPEG file.

    Args:
        path: of the JPEG file.
        images: (H, W, 3) uint8 RGB, one per camera, of any sizes.

    Returns:
        The path.
    """
    import cv2

    columns = math.ceil(math.sqrt(len(images)))
    height = round(VIEW_WIDTH * images[0].shape[0] / images[0].shape[1])
    rows = math.ceil(len(images) / columns)
    sheet = np.full((rows * height, columns * VIEW_WIDTH, 3), 255, np.uint8)
    for camera, image in enumerate(images):
        scale = min(VIEW_WIDTH / image.shape[1], height / image.shape[0])
        size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        top, left = height * (camera // columns), VIEW_WIDTH * (camera % columns)
        sheet[top : top + size[1], left : left + size[0]] = small
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    return write_bytes_atomically(Path(path), encoded.tobytes())


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
