"""Loading, checking and running of ONNX graphs."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from catfree.adapters.files._fingerprint import hash_file
from catfree.errors import FileFormatError, InvalidInputError, MissingDependencyError, quoted
from catfree.types._validation import as_path

_ELEMENT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
Shape = tuple[int | None, ...]


class OnnxGraph:
    """One loaded graph with a single image input.

    Attributes:
        path: the file.
        input_shape: axes of the input, None where the graph leaves the length open.
        output_shapes: name to axes of each output, in the graph's order.
        metadata: the exporter's entries in the file, possibly none.
        producer: name of the exporter, possibly empty.
        content_hash: SHA-256 of the file.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        needed: str,
        providers: Sequence[str | tuple[str, dict[str, Any]]] | None = None,
    ) -> None:
        """Load the graph.

        Args:
            path: the ONNX file.
            needed: description of the expected network, for error messages.
            providers: ONNX Runtime execution providers in order of preference; None for all that
                the installed runtime has.

        Raises:
            InvalidInputError: if there is no such file or a provider is not installed.
            FileFormatError: if it is not an ONNX graph with one image input.
            MissingDependencyError: if onnxruntime is not installed, or does not load.
        """
        self.path, self.needed = as_path(path, "path"), needed
        if not self.path.is_file():
            raise InvalidInputError(f"There is no file {self.path}; {needed} is needed there.")
        self._session = _open(self.path, needed, providers)
        inputs = self._session.get_inputs()
        if len(inputs) != 1:
            raise self.mismatch(f"it has the inputs {quoted([value.name for value in inputs])}")
        self._input_name = inputs[0].name
        if inputs[0].type not in _ELEMENT_TYPES:
            raise self.mismatch(f"its input {quoted(self._input_name)} is {inputs[0].type}")
        self._input_type = _ELEMENT_TYPES[inputs[0].type]
        self.input_shape = _axes(inputs[0].shape)
        self.output_shapes = {o.name: _axes(o.shape) for o in self._session.get_outputs()}
        description = self._session.get_modelmeta()
        self.metadata: Mapping[str, str] = description.custom_metadata_map
        self.producer: str = description.producer_name or ""
        self.content_hash = hash_file(self.path)

    def mismatch(self, content: str) -> FileFormatError:
        """Make the error that compares the file's content with the expected network."""
        return FileFormatError(f"{self.path} does not fit: {content}, but {self.needed} is needed.")

    def require_image_input(self, *leading: int | None) -> None:
        """Raise unless the input is (..., 3, H, W) with these leading axes, None for any length."""
        shape = self.input_shape
        fits = len(shape) == len(leading) + 3 and shape[-3] in (3, None)
        fits = fits and all(
            want is None or got in (want, None) for got, want in zip(shape, leading, strict=False)
        )
        if not fits:
            raise self.mismatch(f"its input {quoted(self._input_name)} is {describe_shape(shape)}")

    def describe_outputs(self) -> str:
        """Format names and axes of all outputs for an error message."""
        listed = (f"{quoted(name)} {describe_shape(s)}" for name, s in self.output_shapes.items())
        return "its outputs are " + ", ".join(listed)

    def run(self, images: np.ndarray) -> dict[str, np.ndarray]:
        """Evaluate the graph.

        Args:
            images: values for the input; converted to its element type.

        Returns:
            Name to value of every output, float16 widened to float32.

        Raises:
            InvalidInputError: if the runtime refuses the input, or runs out of memory.
        """
        names = list(self.output_shapes)
        feed = {self._input_name: np.ascontiguousarray(images, self._input_type)}
        try:
            outputs = self._session.run(names, feed)
        except Exception as error:  # the runtime's own exceptions share no base class
            raise InvalidInputError(
                f"{self.path} could not be run on an input of shape {images.shape}: {error}"
            ) from error
        widened = (v.astype(np.float32) if v.dtype == np.float16 else v for v in outputs)
        return dict(zip(names, widened, strict=True))


def describe_shape(shape: Shape) -> str:
    """Format axes with `?` for an open length: `[1, 3, ?, ?]`."""
    return "[" + ", ".join("?" if axis is None else str(axis) for axis in shape) + "]"


def _axes(shape: Sequence[int | str | None]) -> Shape:
    return tuple(axis if isinstance(axis, int) and axis > 0 else None for axis in shape)


def _open(path: Path, needed: str, providers: Sequence[Any] | None) -> Any:
    try:
        import onnxruntime
    except (ImportError, OSError) as error:
        raise MissingDependencyError(
            f"Running ONNX files needs onnxruntime, which does not load: {error}. Install it (pip "
            "install onnxruntime), or a build of it that fits this machine and the other packages."
        ) from error
    available = onnxruntime.get_available_providers()
    # The Azure provider calls a web service, which is never wanted for a local file.
    chosen = [p for p in available if not p.startswith("Azure")] if providers is None else providers
    for provider in chosen:
        name = provider if isinstance(provider, str) else provider[0]
        if name not in available:
            raise InvalidInputError(
                f"ONNX Runtime has no execution provider {quoted(name)} here; it has {available}."
            )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=list(chosen))
    except Exception as error:  # the runtime's own exceptions share no base class
        reason = str(error).strip().splitlines()[0]
        raise FileFormatError(
            f"{path} cannot be loaded as an ONNX graph ({reason}); {needed} is needed."
        ) from error
