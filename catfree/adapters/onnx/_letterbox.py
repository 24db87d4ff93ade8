"""Fitting a picture into a network's input, and mapping back to original pixels.

Networks and their exporters use the linear map `input = gain * original + pad` for coordinates,
without half-pixel terms; so does this module. The gain of each axis is computed after rounding to
whole pixels, so mapping back is exact even at odd sizes.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from catfree.adapters.protocols import Image

GRAY = 114  # the padding that YOLO networks were trained with


@dataclass(frozen=True)
class Letterbox:
    """The placement of a picture in a network's input.

    Attributes:
        gain: (x, y) input pixels per original pixel.
        pad: (x, y) input pixels before the picture's left and top edge; negative where the picture
            is cropped.
        size: (width, height) of the picture after resizing, in input pixels.
    """

    gain: tuple[float, float]
    pad: tuple[int, int]
    size: tuple[int, int]

    @classmethod
    def fit(
        cls,
        picture: tuple[int, int],
        target: tuple[int, int],
        *,
        placement: Literal["center", "top_left"] = "center",
    ) -> "Letterbox":
        """Make the largest placement that keeps the aspect ratio.

        Args:
            picture: (width, height) of the picture.
            target: (width, height) of the network's input.
            placement: position of the picture in the padding.
        """
        scale = min(target[0] / picture[0], target[1] / picture[1])
        width = min(target[0], max(1, round(picture[0] * scale)))
        height = min(target[1], max(1, round(picture[1] * scale)))
        return cls.place(picture, (width, height), target, placement=placement)

    @classmethod
    def place(
        cls,
        picture: tuple[int, int],
        resized: tuple[int, int],
        target: tuple[int, int],
        *,
        placement: Literal["center", "top_left"] = "center",
    ) -> "Letterbox":
        """Place a picture resized to `resized` (width, height), padded or cropped."""
        free = (target[0] - resized[0], target[1] - resized[1])
        pad = (free[0] // 2, free[1] // 2) if placement == "center" else (0, 0)
        return cls((resized[0] / picture[0], resized[1] / picture[1]), pad, resized)

    def apply(self, image: Image, target: tuple[int, int], fill: int = GRAY) -> Image:
        """Make the (height, width, 3) input for a target (width, height), padded with one value."""
        import cv2

        resized = image
        if (image.shape[1], image.shape[0]) != self.size:
            resized = cv2.resize(image, self.size, interpolation=cv2.INTER_LINEAR)
        out = np.full((target[1], target[0], 3), fill, np.uint8)
        (from_x, to_x), (from_y, to_y) = (
            _overlap(self.pad[axis], self.size[axis], target[axis]) for axis in (0, 1)
        )
        out[to_y, to_x] = resized[from_y, from_x]
        return out

    def to_original(self, xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Map points from input pixels to original pixels."""
        return (xy - np.asarray(self.pad, xy.dtype)) / np.asarray(self.gain, xy.dtype)

    def boxes_to_original(self, box: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
        """Map boxes xyxy from input pixels to original pixels."""
        return self.to_original(box.reshape(-1, 2)).reshape(-1, 4)

    def intrinsics_to_original(self, K: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Map intrinsics from input pixels to original pixels."""
        original = K.copy()
        original[:2] = (K[:2] - np.outer(self.pad, K[2])) / np.array(self.gain)[:, None]
        return original

    def inside(self, target: tuple[int, int]) -> tuple[slice, slice]:
        """Return rows and columns of a target (width, height) that show the picture."""
        _, columns = _overlap(self.pad[0], self.size[0], target[0])
        _, rows = _overlap(self.pad[1], self.size[1], target[1])
        return rows, columns


def _overlap(pad: int, size: int, target: int) -> tuple[slice, slice]:
    start, stop = max(pad, 0), min(pad + size, target)
    return slice(start - pad, stop - pad), slice(start, stop)
