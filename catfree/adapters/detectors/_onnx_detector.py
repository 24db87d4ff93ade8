"""Base class of detectors that run a network from an ONNX file."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal

from catfree.adapters.detectors._tiling import Tiles
from catfree.adapters.detectors._window_detection import DecodedBoxes, WindowDetection
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.adapters.protocols import FrameDetections, Image
from catfree.errors import InvalidInputError


class OnnxDetector(ABC):
    """Detector by a network of one input size; subclasses decode the network's output."""

    def __init__(
        self,
        graph: OnnxGraph,
        target: tuple[int, int],
        *,
        placement: Literal["center", "top_left"],
        confidence: float | int,
        iou: float | int,
        tiles: Tiles,
        tile_overlap: float,
        suppresses: bool = False,
    ) -> None:
        """Store the network and the parameters.

        Args:
            graph: the network.
            target: (width, height) of its input.
            placement: position of a picture in the input's padding.
            confidence: weaker detections are dropped.
            iou: largest overlap of two kept detections.
            tiles: see `tile_windows`.
            tile_overlap: see `tile_windows`.
            suppresses: whether the network itself suppresses overlapping boxes.
        """
        self._graph = graph
        self._confidence = float(confidence)
        self._detection = WindowDetection(
            infer=self._infer,
            target=target,
            placement=placement,
            tiles=tiles,
            tile_overlap=tile_overlap,
            maximum_overlap=1.0 if suppresses else iou,
        )
        self._fingerprint = hash_parameters(
            type(self).__name__,
            graph.content_hash,
            confidence=float(confidence),
            tiles=tiles,
            target=target,
            iou=iou,
            tile_overlap=tile_overlap,
        )

    @property
    def fingerprint(self) -> str:
        """Content hash of weights and parameters."""
        return self._fingerprint

    def __call__(self, image: Image) -> FrameDetections:
        """Detect the people in one (H, W, 3) uint8 RGB picture, best first."""
        return self._detection([image])[0]

    def detect_batch(self, images: Sequence[Image]) -> list[FrameDetections]:
        """Detect the people in each picture, in one network pass if the graph allows it."""
        return self._detection(images)

    @abstractmethod
    def _infer(self, pictures: Sequence[Image]) -> list[DecodedBoxes]:
        """Run the network on pictures of its input size and decode its output."""


def require_thresholds(confidence: float | int, iou: float | int) -> None:
    """Check both thresholds before a file is loaded.

    Raises:
        InvalidInputError: if one of them is out of range.
    """
    if not (0 <= confidence <= 1 and 0 < iou <= 1):
        raise InvalidInputError(
            f"confidence and iou must lie in [0, 1], got {confidence} and {iou}."
        )
