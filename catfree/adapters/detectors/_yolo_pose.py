"""People and their poses by a YOLO pose network in ONNX form (YOLOv8, YOLO11, YOLO26)."""

import ast
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.detectors._onnx_detector import DecodedBoxes, OnnxDetector
from catfree.adapters.detectors._tiling import Tiles
from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.adapters.protocols import Image
from catfree.errors import FileFormatError, quoted

_KEYPOINT_CHANNELS = 17 * 3
_END_TO_END_CHANNELS = 6 + _KEYPOINT_CHANNELS  # x1, y1, x2, y2, confidence, class, keypoints
_NEEDED = (
    "a YOLO pose export (input [batch, 3, H, W]; output [batch, 4 + classes + 51, anchors] or "
    "[batch, rows, 57])"
)


class YoloPoseOnnx(OnnxDetector):
    """Detector with 17 COCO keypoints from an Ultralytics pose export.

    Reads the raw head [batch, 4 + classes + 51, anchors] and the end-to-end head [batch, rows, 57],
    of any input size, with or without metadata, in float32 or float16, with fixed or open axes.

    People should be at least 130 pixels tall in the network's input: YOLO11n-pose finds four in
    five of the unoccluded people of that height, half of those 80 pixels tall, and one in five at
    40 (MultiviewX, at confidence 0.3 and an overlap with the true box of 0.5). `tiles` and
    `image_size` raise that height: n x n tiles multiply it by n - (n - 1) * tile_overlap.

    Weights: `yolo export model=yolo11x-pose.pt format=onnx` of the `ultralytics` package makes the
    file (`dynamic=True` for open axes, `imgsz=1088,1920` for small people). Ultralytics publishes
    code and weights under AGPL-3.0; catfree ships neither.
    """

    _needed = _NEEDED
    _stride = 32
    _placement = "center"

    def __init__(
        self,
        path: str | os.PathLike[str],
        confidence: float | int = 0.30,
        tiles: Tiles = None,
        image_size: int | tuple[int, int] | None = None,
        providers: Sequence[Any] | None = None,
        iou: float | int = 0.7,
        *,
        tile_overlap: float = 0.2,
    ) -> None:
        """Load the file and check that it is a YOLO pose network.

        Args:
            path: the ONNX file.
            confidence: weaker detections are dropped.
            tiles: also look at n x n, or (columns, rows), overlapping tiles of each picture, to
                find people who are small in the whole picture, at the cost of one network pass per
                tile. 2 x 2 tiles make people 1.8 times as tall in the network's input, 3 x 3 tiles
                2.6 times.
            image_size: side or (height, width) of the network's input in pixels, for graphs that
                leave it open; None takes the exporter's size, or else 640.
            providers: ONNX Runtime execution providers in order of preference.
            iou: largest overlap of two kept detections.
            tile_overlap: share of a tile that overlaps its neighbor; people larger than that may
                be whole in no tile.

        Raises:
            InvalidInputError: if there is no such file or a parameter is out of range.
            FileFormatError: if the file is not a YOLO pose network.
        """
        super().__init__(path, confidence, tiles, image_size, providers, iou, tile_overlap)

    def _read_head(self) -> tuple[str, bool]:
        graph = self._graph
        task = graph.metadata.get("task", "pose")
        if task != "pose":
            raise graph.mismatch(f"its metadata say that its task is {quoted(task)}")
        names = _names(graph)
        self._person = next((i for i, name in names.items() if name.lower() == "person"), 0)
        shapes = graph.output_shapes
        if any(shape[1:] == (None, None) or not shape for shape in shapes.values()):
            width, height = self._target
            blank = np.zeros((graph.input_shape[0] or 1, 3, height, width), np.float32)
            shapes = {name: value.shape for name, value in graph.run(blank).items()}
        for name, shape in shapes.items():
            if len(shape) != 3:
                continue
            self._end_to_end = shape[2] == _END_TO_END_CHANNELS
            classes = 0 if shape[1] is None else shape[1] - 4 - _KEYPOINT_CHANNELS
            # Without class names 84 channels are a detection head of 80 classes without keypoints.
            if self._end_to_end or classes == 1 or (classes > 1 and len(names) == classes):
                return name, self._end_to_end
        raise graph.mismatch(graph.describe_outputs())

    def _input_of(self, picture: Image) -> Float[np.ndarray, "3 h w"]:
        return picture.transpose(2, 0, 1).astype(np.float32) / 255

    def _decode(self, output: np.ndarray) -> DecodedBoxes:
        decode = _decode_end_to_end if self._end_to_end else _decode_raw
        return decode(output, self._person, self._confidence)


def _decode_raw(channels: Float[np.ndarray, "c a"], person: int, confidence: float) -> DecodedBoxes:
    """Decode the raw head: center, size, class confidences, keypoints, one column per anchor."""
    score = channels[4 + person]
    rows = channels[:, score >= confidence].T
    half = rows[:, 2:4] / 2
    box = np.concatenate([rows[:, :2] - half, rows[:, :2] + half], axis=1)
    keypoints = rows[:, -_KEYPOINT_CHANNELS:].reshape(-1, 17, 3)
    return DecodedBoxes(box, rows[:, 4 + person], keypoints)


def _decode_end_to_end(
    rows: Float[np.ndarray, "r 57"], person: int, confidence: float
) -> DecodedBoxes:
    """Decode the end-to-end head, whose unused rows have confidence 0."""
    chosen = rows[(rows[:, 4] >= max(confidence, 1e-6)) & (np.round(rows[:, 5]) == person)]
    return DecodedBoxes(chosen[:, :4], chosen[:, 4], chosen[:, 6:].reshape(-1, 17, 3))


def _names(graph: OnnxGraph) -> dict[int, str]:
    try:
        names = ast.literal_eval(graph.metadata.get("names", "{}"))
        return {int(index): str(name) for index, name in names.items()}
    except (ValueError, SyntaxError, AttributeError, TypeError) as error:
        raise FileFormatError(
            f"{graph.path} has class names that cannot be read ({error}). Export it again."
        ) from error
