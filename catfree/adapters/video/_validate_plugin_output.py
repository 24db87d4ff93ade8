"""Checks of users' detectors and embedders, and of their results, picture by picture.

An invalid result is reported at the first bad picture, with its camera and frame, not at the end of
the footage.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.protocols import Embedder, FrameDetections, Image
from catfree.errors import InvalidInputError, quoted
from catfree.types._validation import as_float


def require_part(part: Any, name: str) -> None:
    """Raise unless a detector, an embedder or a reconstructor can be called or fitted.

    Raises:
        InvalidInputError: naming it; a class, although callable, must first be instantiated.
    """
    if isinstance(part, type):
        raise InvalidInputError(
            f"{name} is the class {part.__name__}. Pass an instance of it: {part.__name__}(...)."
        )
    if not (callable(part) or hasattr(part, "fit")):
        raise InvalidInputError(
            f"{name} must be a callable such as those of catfree.adapters, got {quoted(part)}."
        )


def ask_for_people(
    detector: Any,
    image: Image,
    camera: int,
    frame: int,
    expected: Float[np.ndarray, "n 3"] | None = None,
) -> FrameDetections:
    """Run a detector on one picture and check its result.

    Args:
        detector: the detector.
        image: the picture.
        camera: index of the camera that took it.
        frame: its frame.
        expected: hints for a second look, as in `GuidedDetector`; None for the first look.

    Raises:
        InvalidInputError: naming camera and frame, if the detector returns anything but
            `FrameDetections`, or invalid boxes.
    """
    try:
        people = detector(image) if expected is None else detector.look_again(image, expected)
    except InvalidInputError as error:
        raise InvalidInputError(f"{_place(detector, camera, frame)} failed: {error}") from error
    return require_people(people, detector, camera, frame)


def require_people(people: Any, detector: Any, camera: int, frame: int) -> FrameDetections:
    """Return a detector's result if it is valid; see `ask_for_people`."""
    if not isinstance(people, FrameDetections):
        raise InvalidInputError(
            f"{_place(detector, camera, frame)} returned {_kind(people)}; it must return "
            "FrameDetections(box, score)."
        )
    return people


class Describer:
    """An embedder whose results are checked: one row per box, all of one length."""

    def __init__(self, embedder: Embedder, width: int | None = None) -> None:
        """Wrap an embedder; `width` is the length that its rows must have, if known."""
        self.embedder, self.width = embedder, width

    def __call__(self, image: Image, box: Any, camera: int, frame: int) -> Float[np.ndarray, "n d"]:
        """Embed the people in the boxes of one picture.

        Raises:
            InvalidInputError: naming camera and frame, if the result is not an (n, D) array of
                finite numbers, or D differs from that of earlier pictures.
        """
        where = _place(self.embedder, camera, frame)
        try:
            answer = self.embedder(image, box.copy())  # a copy, which it may change
            vectors = np.asarray(np.nan if answer is None else as_float(answer))
        except InvalidInputError as error:
            raise InvalidInputError(f"{where} failed: {error}") from error
        width = vectors.shape[1] if self.width is None and vectors.ndim == 2 else self.width
        if not len(box):
            return np.zeros((0, width or 0), vectors.dtype)
        if vectors.shape != (len(box), width) or not width:
            raise InvalidInputError(
                f"{where} returned {_kind(answer)} for {len(box)} boxes; it must return an array "
                f"of shape ({len(box)}, {self.width or 'D'}), one row per box."
            )
        if not np.isfinite(vectors).all():
            raise InvalidInputError(f"{where} returned NaN or infinity; return finite numbers.")
        self.width = vectors.shape[1]
        return vectors


def join_descriptions(parts: list[np.ndarray]) -> Float[np.ndarray, "n d"]:
    """Concatenate the rows, skipping pictures without people, whose row length is unknown.

    Raises:
        InvalidInputError: if their lengths differ, as between cameras of different processes.
    """
    known = [part for part in parts if len(part)] or parts[:1]
    widths = sorted({part.shape[1] for part in known})
    if len(widths) > 1:
        raise InvalidInputError(
            f"The embedder returned rows of {widths[0]} and of {widths[-1]} numbers; all must have "
            "the same length."
        )
    return np.concatenate(known)


def _place(part: Any, camera: int, frame: int) -> str:
    name = getattr(part, "__name__", type(part).__name__)
    return f"{name}, called for camera {camera} at frame {frame},"


def _kind(answer: Any) -> str:
    shape = getattr(answer, "shape", None)
    if shape is not None:
        return f"an array of shape {tuple(shape)}"
    return "nothing" if answer is None else f"a value of type {type(answer).__name__}"
