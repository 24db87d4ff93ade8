"""Appearance vectors by a person re-identification network in ONNX form."""

import os
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from catfree.adapters.embedders._crops import clipped_crops, unit_rows
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.onnx._onnx_batching import run_batched
from catfree.adapters.onnx._onnx_session import OnnxGraph, Shape
from catfree.adapters.protocols import Image, as_image
from catfree.errors import InvalidInputError, quoted

Preprocessing = Literal["rgb_imagenet", "bgr_raw"]

_NEEDED = (
    "a person re-identification export (input [batch, 3, H, W]; output [batch, D] or "
    "[batch, D, 1, 1])"
)
_IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)
_USUAL_HEIGHT, _USUAL_WIDTH = 256, 128
_LARGEST_BATCH = 32


class ReIdOnnx:
    """Embedder from a re-identification network that maps a person's crop to a vector.

    The input follows one of two conventions, which the graph does not state: "rgb_imagenet"
    (torchreid's OSNet: RGB in [0, 1], ImageNet mean and deviation) and "bgr_raw" (Intel's Open
    Model Zoo: BGR 0 to 255, normalized inside). None chooses "bgr_raw" for graphs that were
    converted from OpenVINO and "rgb_imagenet" for all others.

    Weights: `pretrained("youtu-reid")` (Apache-2.0); OSNet from
    github.com/KaiyangZhou/deep-person-reid (code MIT; the training data allow research only),
    exported with `torch.onnx.export`; `person-reidentification-retail-0287` from Intel's Open Model
    Zoo (Apache-2.0), converted with openvino2onnx.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        preprocessing: Preprocessing | None = None,
        providers: Sequence[Any] | None = None,
    ) -> None:
        """Load the file and check that it is a re-identification network.

        Args:
            path: the ONNX file.
            preprocessing: the network's input convention; None decides by the exporter.
            providers: ONNX Runtime execution providers in order of preference.

        Raises:
            InvalidInputError: if the file does not exist or the preprocessing is unknown.
            FileFormatError: if the file is not a re-identification network.
        """
        if preprocessing not in (None, "rgb_imagenet", "bgr_raw"):
            raise InvalidInputError(
                "preprocessing must be 'rgb_imagenet', 'bgr_raw' or None, got "
                f"{quoted(preprocessing)}."
            )
        self._graph = OnnxGraph(path, needed=_NEEDED, providers=providers)
        self._graph.require_image_input(None)
        vector_outputs = [
            name for name, shape in self._graph.output_shapes.items() if _is_vector(shape)
        ]
        if not vector_outputs:
            raise self._graph.mismatch(self._graph.describe_outputs())
        self._output = vector_outputs[0]
        converted = "openvino" in self._graph.producer.lower()
        self._preprocessing: Preprocessing = preprocessing or (
            "bgr_raw" if converted else "rgb_imagenet"
        )
        height, width = self._graph.input_shape[2:]
        self._crop_size = (width or _USUAL_WIDTH, height or _USUAL_HEIGHT)
        self._dimension = self._graph.output_shapes[self._output][1]
        self.fingerprint = hash_parameters(
            "ReIdOnnx", self._graph.content_hash, preprocessing=self._preprocessing
        )

    @property
    def preprocessing(self) -> Preprocessing:
        """The input convention in use."""
        return self._preprocessing

    def __call__(self, image: Image, box: Any) -> Float[np.ndarray, "n d"]:
        """Compute one unit vector per box (n, 4) xyxy in pixels of the picture."""
        crops = clipped_crops(as_image(image), box, self._crop_size)
        if not crops:
            return np.zeros((0, self._find_dimension()), np.float32)
        return unit_rows(np.stack(self._embed(crops)))

    def _embed(self, crops: Sequence[Image]) -> list[np.ndarray]:
        inputs = [self._normalize(crop).transpose(2, 0, 1) for crop in crops]
        outputs = run_batched(self._graph, inputs, self._output, _LARGEST_BATCH)
        if any(output.size != output.shape[0] for output in outputs):
            raise self._graph.mismatch(
                f"its output {quoted(self._output)} has maps instead of vectors"
            )
        return [output.ravel() for output in outputs]

    def _normalize(self, crop: Image) -> Float[np.ndarray, "h w 3"]:
        if self._preprocessing == "bgr_raw":
            return crop[:, :, ::-1].astype(np.float32)
        return (crop.astype(np.float32) / 255 - _IMAGENET_MEAN) / _IMAGENET_DEVIATION

    def _find_dimension(self) -> int:
        if self._dimension is None:  # the graph does not state it: run it on a blank crop
            width, height = self._crop_size
            self._dimension = self._embed([np.zeros((height, width, 3), np.uint8)])[0].shape[0]
        return self._dimension


def _is_vector(shape: Shape) -> bool:
    """Return whether an output has one vector per picture, with or without pooled axes."""
    return len(shape) in (2, 4) and all(axis in (1, None) for axis in shape[2:])
