"""People by a YOLOX network in ONNX form."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.detectors._onnx_detector import DecodedBoxes, OnnxDetector
from catfree.adapters.detectors._tiling import Tiles
from catfree.adapters.protocols import Image

_NEEDED = "a YOLOX export (input [batch, 3, H, W]; output [batch, anchors, 5 + classes])"
_STRIDES = (8, 16, 32)
_PERSON = 0  # COCO's first class
# Weights with untrained or foreign classes can give large logarithms of sizes; a box of e^12 input
# pixels is larger than any picture, and the exponential stays finite.
_LARGEST_LOGARITHM = 12.0


class YoloxOnnx(OnnxDetector):
    """Detector without keypoints from the export script of the YOLOX project.

    Takes BGR values 0 to 255 in a top-left letterbox and the undecoded head (the script's default,
    `decode_in_inference` off): offsets to a grid of strides 8, 16 and 32, logarithms of sizes,
    confidence of an object times confidence of each class. Only COCO's class "person" is kept.

    People should be at least 50 pixels tall in the network's input: YOLOX-nano finds four in five
    of the unoccluded people of that height, three in five of those 32 pixels tall, and a quarter at
    24 (MultiviewX, at confidence 0.3 and an overlap with the true box of 0.5). `tiles` and
    `image_size` raise that height: n x n tiles multiply it by n - (n - 1) * tile_overlap.

    Weights: `pretrained("yolox-s")`; the releases of github.com/Megvii-BaseDetection/YOLOX hold
    ONNX files of all sizes (Apache-2.0).
    """

    _needed = _NEEDED
    _stride = max(_STRIDES)
    _placement = "top_left"

    def __init__(
        self,
        path: str | os.PathLike[str],
        confidence: float | int = 0.30,
        tiles: Tiles = None,
        image_size: int | tuple[int, int] | None = None,
        providers: Sequence[Any] | None = None,
        iou: float | int = 0.65,
        *,
        tile_overlap: float = 0.2,
    ) -> None:
        """Load the file and check that it is a YOLOX network.

        Args:
            path: the ONNX file.
            confidence: weaker detections are dropped.
            tiles: also look at n x n, or (columns, rows), overlapping tiles of each picture. 2 x 2
                tiles make people 1.8 times as tall in the network's input, 3 x 3 tiles 2.6 times.
            image_size: side or (height, width) of the network's input in pixels, for graphs that
                leave it open; None takes 640.
            providers: ONNX Runtime execution providers in order of preference.
            iou: largest overlap of two kept detections (YOLOX's own default).
            tile_overlap: share of a tile that overlaps its neighbor; people larger than that may
                be whole in no tile.

        Raises:
            InvalidInputError: if there is no such file or a parameter is out of range.
            FileFormatError: if the file is not a YOLOX network.
        """
        super().__init__(path, confidence, tiles, image_size, providers, iou, tile_overlap)

    def _read_head(self) -> tuple[str, bool]:
        self._grid, self._scale = _anchor_grid(*self._target)
        anchors = len(self._scale)
        for name, shape in self._graph.output_shapes.items():
            has_classes = len(shape) == 3 and (shape[2] is None or shape[2] > 5)
            if has_classes and shape[1] in (anchors, None):
                return name, False
        raise self._graph.mismatch(
            f"{self._graph.describe_outputs()} where {anchors} anchors were expected"
        )

    def _input_of(self, picture: Image) -> Float[np.ndarray, "3 h w"]:
        return picture[:, :, ::-1].transpose(2, 0, 1).astype(np.float32)

    def _decode(self, output: Float[np.ndarray, "a c"]) -> DecodedBoxes:
        score = output[:, 4] * output[:, 5 + _PERSON]
        keep = score >= self._confidence
        scale = self._scale[keep][:, None]
        center = (output[keep, :2] + self._grid[keep]) * scale
        half = np.exp(np.minimum(output[keep, 2:4], _LARGEST_LOGARITHM)) * scale / 2
        return DecodedBoxes(np.concatenate([center - half, center + half], 1), score[keep], None)


def _anchor_grid(
    width: int, height: int
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, " a"]]:
    """Compute column and row of each anchor in its grid, and its stride, finest grid first."""
    grids, strides = [], []
    for stride in _STRIDES:
        rows, columns = np.mgrid[: height // stride, : width // stride]
        grids.append(np.stack([columns.ravel(), rows.ravel()], axis=-1))
        strides.append(np.full(rows.size, stride))
    return np.concatenate(grids).astype(np.float32), np.concatenate(strides).astype(np.float32)
