"""What all detectors that run a network from an ONNX file have in common."""

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
    """Detector by a network of one input size; a subclass says how the network is read."""

    def __init__(
        self,
        graph: OnnxGraph,
        target: tuple[int, int],
        *,
        placement: Literal["centre", "top_left"],
        confidence: float | int,
        iou: float | int,
        tiles: Tiles,
        tile_overlap: float,
        suppresses: bool = False,
    ) -> None:
        """Keep what every call needs.

        Args:
            graph: the network.
            target: (width, height) of its input.
            placement: where a picture lies in the input's padding.
            confidence: weaker detections are dropped.
            iou: largest overlap of two detections that both stay.
            tiles: see `tile_windows`.
            tile_overlap: see `tile_windows`.
            suppresses: whether the network suppresses overlapping boxes by itself.
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
        """The people in one (H, W, 3) uint8 RGB picture, best first."""
        return self._detection([image])[0]

    def detect_batch(self, images: Sequence[Image]) -> list[FrameDetections]:
        """The people in each picture; one network pass for several where the graph allows it."""
        return self._detection(images)

    @abstractmethod
    def _infer(self, pictures: Sequence[Image]) -> list[DecodedBoxes]:
        """What the network says about pictures of its input size."""


def require_thresholds(confidence: float | int, iou: float | int) -> None:
    """Check both before a file is loaded.

    Raises:
        InvalidInputError: if one of them is impossible.
    """
    if not (0 <= confidence <= 1 and 0 < iou <= 1):
        raise InvalidInputError(
            f"confidence and iou must lie in [0, 1], got {confidence} and {iou}."
        )
