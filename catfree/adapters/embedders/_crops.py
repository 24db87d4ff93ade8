"""Crops of people and normalization of their embeddings."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.protocols import Image
from catfree.types._validation import as_rows, require_finite


def clip_boxes(box: Any, width: int, height: int) -> Int[np.ndarray, "n 4"]:
    """Clip boxes to whole pixels inside the picture.

    Args:
        box: (n, 4) xyxy in pixels, possibly partly or wholly outside the picture.
        width: width of the picture in pixels.
        height: height of the picture in pixels.

    Returns:
        (n, 4) x1, y1, x2, y2 with 0 <= x1 < x2 <= width and 0 <= y1 < y2 <= height: at least the
        border pixel nearest to the box.

    Raises:
        InvalidInputError: if the boxes do not have this shape or are not finite.
    """
    boxes = as_rows(box, 4, "box")
    require_finite(boxes, "box")
    last = np.array([width, height]) - 1
    low = np.clip(np.floor(boxes[:, :2]), 0, last[None, :]).astype(np.int64)
    high = np.clip(np.ceil(boxes[:, 2:]), low + 1, last[None, :] + 1).astype(np.int64)
    return np.concatenate([low, high], axis=1)


def clipped_crops(image: Image, box: Any, size: tuple[int, int]) -> list[Image]:
    """Crop the picture to each box and resize the crops to (width, height)."""
    import cv2

    corners = clip_boxes(box, image.shape[1], image.shape[0])
    return [cv2.resize(image[y1:y2, x1:x2], size) for x1, y1, x2, y2 in corners.tolist()]


def unit_rows(vectors: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Scale rows to unit length; a zero row becomes the first unit vector."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    first = np.zeros_like(vectors)
    first[:, :1] = 1
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), first)
