"""Protocols of detectors, embedders and reconstructors.

The protocols are structural: any object with the right `__call__` and `fingerprint` conforms,
without a base class. Images are (H, W, 3) uint8 RGB arrays; pixels follow the project's convention,
the center of the top-left pixel at (0, 0).
"""

from collections.abc import Iterable, Sequence
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, UInt8

from catfree.errors import InvalidInputError
from catfree.types import Scene
from catfree.types._validation import as_float, as_number, as_rows, require_boxes, require_shape
from catfree.types.results._reconstruction import Reconstruction as Reconstruction

Image = UInt8[np.ndarray, "_ _ 3"]

# COCO's order of the 17 keypoints ends with the left and the right ankle.
LEFT_ANKLE, RIGHT_ANKLE = 15, 16


class FrameDetections(eqx.Module):
    """The people that a detector found in one picture.

    Attributes:
        box: (n, 4) x1, y1, x2, y2 in pixels of the original picture.
        score: (n,) confidence in [0, 1].
        keypoints: (n, 17, 3) COCO keypoints as x, y in pixels of the original picture and
            confidence, or None if the detector does not estimate poses.
    """

    box: Float[np.ndarray, "n 4"]
    score: Float[np.ndarray, " n"]
    keypoints: Float[np.ndarray, "n 17 3"] | None

    def __init__(self, box: Any, score: Any, keypoints: Any = None) -> None:
        """Validate and store.

        Raises:
            InvalidInputError: naming the first entry that has a wrong shape, is not finite, is a
                box without area or a score outside [0, 1].
        """
        self.box = as_rows(box, 4, "box")
        self.score = np.asarray(as_float(score, "score"))
        self.keypoints = None if keypoints is None else np.asarray(as_float(keypoints, "keypoints"))
        require_boxes(len(self.box), self.box, self.score, self.keypoints)

    def __len__(self) -> int:
        return len(self.box)


@runtime_checkable
class Detector(Protocol):
    """A detector of people in one picture: `detector(image) -> FrameDetections`.

    The picture is (H, W, 3) uint8 RGB of any size. The detector returns one row per person, in any
    order, after non-maximum suppression, with boxes and keypoints in pixels of that picture. A
    picture without people gives zero rows, not an error. Equal pictures give equal rows.

    `fingerprint` identifies weights and parameters by content: detectors with equal fingerprints
    give equal rows for equal pictures, so it can be used as a cache key.

    A detector may have an attribute `box_slack`, the share of its height by which a box is taller
    than the person; without it, calibration from people assumes the slack of learned detectors.
    """

    @property
    def fingerprint(self) -> str:
        """Content hash of weights and parameters."""
        ...

    def __call__(self, image: Image) -> FrameDetections:
        """Detect the people in one picture."""
        ...


@runtime_checkable
class BatchDetector(Detector, Protocol):
    """A detector that is faster on several pictures at once, for instance all cameras' frames."""

    def detect_batch(self, images: Sequence[Image]) -> list[FrameDetections]:
        """Return the same rows as one call per picture; the pictures may differ in size."""
        ...


@runtime_checkable
class GuidedDetector(Detector, Protocol):
    """A detector that can use the expected positions of people in the picture."""

    def look_again(self, image: Image, expected: Float[np.ndarray, "n 3"]) -> FrameDetections:
        """Detect the people in one picture with hints; without hints the same as a call.

        `expected` is (n, 3): foot column, foot row and height of people in pixels of the picture.
        Hints may be wrong: only people that the picture shows may be reported.
        """
        ...


@runtime_checkable
class FittedToCamera(Protocol):
    """A detector that must be fitted to the footage of a static camera before use.

    The caller fits it once per camera with `detector.fit(images)` and calls the returned detector
    on that camera's pictures only.
    """

    @property
    def fingerprint(self) -> str:
        """Content hash of the parameters, before any fit."""
        ...

    def fit(self, images: Iterable[Image]) -> Detector:
        """Return a detector for the camera that took these pictures, reading them once, in order.

        May be called from several threads at once, one per camera.
        """
        ...


@runtime_checkable
class Embedder(Protocol):
    """An embedder of people's appearance: `embedder(image, box) -> (n, D)`.

    Boxes are (n, 4) x1, y1, x2, y2 in pixels of the picture and may cross its border. Each row has
    unit length, so `1 - a · b` is a cosine distance in [0, 2]; zero boxes give (0, D).
    `fingerprint` is as in `Detector`.
    """

    @property
    def fingerprint(self) -> str:
        """Content hash of weights and parameters."""
        ...

    def __call__(self, image: Image, box: Any) -> Float[np.ndarray, "n d"]:
        """Compute one unit vector per box."""
        ...


@runtime_checkable
class Reconstructor(Protocol):
    """A reconstructor of cameras and points from one instant: `reconstructor(images)`.

    `images` holds one picture per camera, in the order of the cameras; sizes may differ. The result
    has its own frame and scale, which may differ between calls. `fingerprint` is as in `Detector`.
    """

    @property
    def fingerprint(self) -> str:
        """Content hash of weights and parameters."""
        ...

    def __call__(self, images: Sequence[Image]) -> Reconstruction:
        """Reconstruct cameras and scene points in one frame."""
        ...


@runtime_checkable
class RaySource(Protocol):
    """Cameras with any lens: `source(camera, pixels)` gives the rays of a camera's pixels.

    `pixels` is (n, 2) in original image pixels; the result is (n, 3) unit vectors in camera axes (x
    right, y down, z forward). Neighboring pixels have neighboring rays. `catfree.rig_from_rays`
    turns it into a rig.
    """

    def __call__(self, camera: int, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Compute one unit vector per pixel."""
        ...


@runtime_checkable
class SceneSource(Protocol):
    """Anything with a scene, such as the results of `cf.calibrate`, `cf.refine`, `cf.run_stages`.

    Readers of calibration files give one too, a `NamedRig`, whose scene has the ground z = 0.
    `cf.run` takes it in place of a `Scene`, and likewise a data set (`MultiViewSequence`).
    """

    @property
    def scene(self) -> Scene:
        """Cameras and ground."""
        ...


def ankles_confirmed(
    keypoints: Float[np.ndarray, "n 17 3"], minimum_confidence: float = 0.5
) -> Bool[np.ndarray, " n"]:
    """Return whether both ankles of each person were detected with confidence.

    Args:
        keypoints: (n, 17, 3) COCO keypoints as x, y in pixels and confidence.
        minimum_confidence: least confidence of both ankles.

    Returns:
        (n,) true where the left and the right ankle are both confident.

    Raises:
        InvalidInputError: if keypoints have another shape.
    """
    points = np.asarray(as_float(keypoints, "keypoints"))
    require_shape(points, (None, 17, 3), "keypoints")
    confidence = points[:, [LEFT_ANKLE, RIGHT_ANKLE], 2].min(axis=-1)
    return np.asarray(confidence >= as_number(minimum_confidence, "minimum_confidence"))


def as_image(image: Any) -> Image:
    """Return a picture as an array after checking its shape and type.

    Raises:
        InvalidInputError: if it is not a (H, W, 3) uint8 array with at least one pixel.
    """
    picture = np.asarray(image)
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or not picture.size:
        raise InvalidInputError(
            f"An image must be a non-empty (H, W, 3) uint8 RGB array, got {picture.dtype} of shape "
            f"{picture.shape}."
        )
    return picture
