"""Detection in pictures of any size by a network of one input size."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from catfree.adapters.detectors._box_suppression import suppress_boxes
from catfree.adapters.detectors._tiling import Tiles, cut_by_window, tile_windows
from catfree.adapters.onnx._letterbox import Letterbox
from catfree.adapters.protocols import FrameDetections, Image, as_image

# Two windows show the same person with different input pixels, so that their boxes agree less well
# than two boxes of one pass; this is the usual criterion for the same object.
OVERLAP_ACROSS_WINDOWS = 0.5
# Boxes may end up to half the finest stride of these networks (8 px) away from the edge of a tile.
CUT_MARGIN = 4.0


class DecodedBoxes(NamedTuple):
    """Confident rows of a network's output for one input picture, in input pixels."""

    box: Float[np.ndarray, "n 4"]
    score: Float[np.ndarray, " n"]
    keypoints: Float[np.ndarray, "n 17 3"] | None


@dataclass(frozen=True)
class WindowDetection:
    """Detection that cuts pictures, fits the pieces into the input and merges their boxes.

    Attributes:
        infer: input pictures (target height, target width, 3) uint8 RGB -> decoded boxes of each.
        target: (width, height) of the network's input.
        placement: position of the picture in the input's padding.
        tiles: see `tile_windows`.
        tile_overlap: see `tile_windows`.
        maximum_overlap: largest IoU of two boxes of one window; 1 where the network suppresses.
    """

    infer: Callable[[Sequence[Image]], list[DecodedBoxes]]
    target: tuple[int, int]
    placement: Literal["center", "top_left"]
    tiles: Tiles
    tile_overlap: float
    maximum_overlap: float

    def __call__(self, images: Sequence[Image]) -> list[FrameDetections]:
        """Detect the people in each picture, in its pixels, best first."""
        pictures = [as_image(image) for image in images]
        sizes = [(picture.shape[1], picture.shape[0]) for picture in pictures]
        windows = [tile_windows(*size, self.tiles, self.tile_overlap) for size in sizes]
        crops = [
            picture[y1:y2, x1:x2]
            for picture, its_windows in zip(pictures, windows, strict=True)
            for x1, y1, x2, y2 in its_windows
        ]
        letterboxes = [
            Letterbox.fit((p.shape[1], p.shape[0]), self.target, placement=self.placement)
            for p in crops
        ]
        inputs = [fit.apply(p, self.target) for fit, p in zip(letterboxes, crops, strict=True)]
        decoded = iter(zip(letterboxes, self.infer(inputs), strict=True))
        return [
            self._merge([(window, *next(decoded)) for window in its_windows], size)
            for its_windows, size in zip(windows, sizes, strict=True)
        ]

    def _merge(
        self,
        decoded_windows: list[tuple[tuple[int, int, int, int], Letterbox, DecodedBoxes]],
        size: tuple[int, int],
    ) -> FrameDetections:
        boxes, scores, keypoints, sources = [], [], [], []
        for index, (window, letterbox, decoded) in enumerate(decoded_windows):
            corner = np.array(window[:2], np.float32)
            box = letterbox.boxes_to_original(decoded.box) + np.tile(corner, 2)[None, :]
            keep = ~cut_by_window(box, window, size, CUT_MARGIN / min(letterbox.gain))
            box = np.clip(box, 0, np.array([*size, *size], np.float32)[None, :])
            keep &= (box[:, 2] > box[:, 0]) & (box[:, 3] > box[:, 1])
            boxes.append(box[keep])
            scores.append(decoded.score[keep])
            sources.append(np.full(int(keep.sum()), index))
            if decoded.keypoints is not None:
                xy = letterbox.to_original(decoded.keypoints[..., :2]) + corner
                confidence = np.clip(decoded.keypoints[..., 2:], 0, 1)
                keypoints.append(np.concatenate([xy, confidence], axis=-1)[keep])
        box, score = np.concatenate(boxes), np.clip(np.concatenate(scores), 0, 1)
        kept = suppress_boxes(
            box,
            score,
            self.maximum_overlap,
            window=np.concatenate(sources),
            maximum_overlap_across=OVERLAP_ACROSS_WINDOWS,
        )
        pose = np.concatenate(keypoints)[kept] if keypoints else None
        return FrameDetections(box[kept], score[kept], pose)
