"""Base class of detectors that run a network of one input size on pictures of any size."""

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from catfree.adapters.detectors._box_suppression import suppress_boxes
from catfree.adapters.detectors._tiling import Tiles, Window, cut_by_window, tile_windows
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.onnx._input_size import choose_input_size
from catfree.adapters.onnx._letterbox import Letterbox
from catfree.adapters.onnx._onnx_batching import run_batched
from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.adapters.protocols import FrameDetections, Image, as_image
from catfree.errors import InvalidInputError
from catfree.types._validation import as_number

# Two windows show the same person with different input pixels, so their boxes agree less well than
# two boxes of one pass; this is the usual criterion for the same object.
OVERLAP_ACROSS_WINDOWS = 0.5
# Boxes may end up to half the finest stride of these networks (8 px) away from the edge of a tile.
CUT_MARGIN = 4.0
_LARGEST_BATCH = 8


class DecodedBoxes(NamedTuple):
    """Confident rows of a network's output for one input picture, in input pixels."""

    box: Float[np.ndarray, "n 4"]
    score: Float[np.ndarray, " n"]
    keypoints: Float[np.ndarray, "n 17 3"] | None


class OnnxDetector(ABC):
    """Detector that cuts pictures, fits the pieces into a network's input and merges their boxes.

    Subclasses define which networks they accept, and convert their input and output.
    """

    _needed: str  # description of the required file, for messages
    _stride: int  # pixels; the sides of an open input are multiples of it
    _placement: Literal["center", "top_left"]  # position of a picture in the padding

    def __init__(
        self,
        path: str | os.PathLike[str],
        confidence: float | int,
        tiles: Tiles,
        image_size: int | tuple[int, int] | None,
        providers: Sequence[Any] | None,
        iou: float | int,
        tile_overlap: float,
    ) -> None:
        """Load the network and store the parameters; see the subclasses."""
        confidence, iou = as_number(confidence, "confidence"), as_number(iou, "iou")
        if not (0 <= confidence <= 1 and 0 < iou <= 1):
            raise InvalidInputError(
                f"confidence and iou must lie in [0, 1], got {confidence} and {iou}."
            )
        graph = self._graph = OnnxGraph(path, needed=self._needed, providers=providers)
        graph.require_image_input(None)
        self._target = choose_input_size(graph, image_size, self._stride)
        self._output, suppresses = self._read_head()
        self._confidence = confidence
        self._maximum_overlap = 1.0 if suppresses else iou
        self._tiles, self._tile_overlap = tiles, tile_overlap
        self.fingerprint = hash_parameters(
            type(self).__name__,
            graph.content_hash,
            confidence=confidence,
            tiles=tiles,
            target=self._target,
            iou=iou,
            tile_overlap=tile_overlap,
        )

    def __call__(self, image: Image) -> FrameDetections:
        """Detect the people in one (H, W, 3) uint8 RGB picture, best first."""
        return self.detect_batch([image])[0]

    def detect_batch(self, images: Sequence[Image]) -> list[FrameDetections]:
        """Detect the people in each picture, in one network pass if the graph allows it."""
        pictures = [as_image(image) for image in images]
        sizes = [(picture.shape[1], picture.shape[0]) for picture in pictures]
        windows = [tile_windows(*size, self._tiles, self._tile_overlap) for size in sizes]
        crops = [
            picture[y1:y2, x1:x2]
            for picture, its_windows in zip(pictures, windows, strict=True)
            for x1, y1, x2, y2 in its_windows
        ]
        letterboxes = [
            Letterbox.fit((p.shape[1], p.shape[0]), self._target, placement=self._placement)
            for p in crops
        ]
        inputs = [fit.apply(p, self._target) for fit, p in zip(letterboxes, crops, strict=True)]
        outputs = run_batched(
            self._graph, [self._input_of(p) for p in inputs], self._output, _LARGEST_BATCH
        )
        decoded = iter(zip(letterboxes, map(self._decode, outputs), strict=True))
        return [
            self._merge([(window, *next(decoded)) for window in its_windows], size)
            for its_windows, size in zip(windows, sizes, strict=True)
        ]

    @abstractmethod
    def _read_head(self) -> tuple[str, bool]:
        """Find the output to decode, and whether the network itself suppresses boxes.

        Raises:
            FileFormatError: if the network is not one that the class decodes.
        """

    @abstractmethod
    def _input_of(self, picture: Image) -> Float[np.ndarray, "3 h w"]:
        """Convert a picture of the network's input size to its input."""

    @abstractmethod
    def _decode(self, output: np.ndarray) -> DecodedBoxes:
        """Decode the output for one picture."""

    def _merge(
        self,
        decoded_windows: list[tuple[Window, Letterbox, DecodedBoxes]],
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
        source, limit = np.concatenate(sources), self._maximum_overlap
        kept = suppress_boxes(box, score, limit, source, OVERLAP_ACROSS_WINDOWS)
        pose = np.concatenate(keypoints)[kept] if keypoints else None
        return FrameDetections(box[kept], score[kept], pose)
