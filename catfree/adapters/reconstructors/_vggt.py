"""Cameras and scene points by a VGGT network in ONNX form."""

import os
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.onnx._letterbox import Letterbox
from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.adapters.protocols import Image, as_image
from catfree.errors import InvalidInputError, quoted
from catfree.types._sampling import evenly_spread
from catfree.types._validation import as_count
from catfree.types.results._reconstruction import Reconstruction

_NEEDED = (
    "a VGGT export (input [1, views, 3, H, W]; outputs pose_enc [1, views, 9], world_points "
    "[1, views, H, W, 3] and world_points_conf [1, views, H, W])"
)
_PATCH = 14
_USUAL_SIDE = 518
_WHITE = 255
# No lens that shows a scene has a field of view outside these limits. The network clips it at 0, so
# an exact 0 means undetermined.
_FIELD_OF_VIEW = (0.01, np.pi - 0.01)
_SMALLEST_QUATERNION = 1e-6


class VggtOnnx:
    """Reconstructor from a VGGT export: cameras and a point cloud from one picture per camera.

    The scale is arbitrary in each call. A camera whose field of view or rotation the network leaves
    undetermined comes back with `registered` false.

    Weights: VGGT-1B from github.com/facebookresearch/vggt; the original weights allow
    non-commercial use only, "VGGT-1B-Commercial" has its own license. Export the model with
    `torch.onnx.export` with the pictures as the only input and the prediction dictionary's
    `pose_enc`, `depth`, `depth_conf`, `world_points` and `world_points_conf` as outputs.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        mode: Literal["crop", "pad"] = "crop",
        providers: Sequence[Any] | None = None,
        *,
        maximum_points: int = 200_000,
    ) -> None:
        """Load the file and check that it is a VGGT network.

        Args:
            path: the ONNX file.
            mode: "crop" fills the input's width and cuts off excess height; "pad" shows the whole
                picture between white bars.
            providers: ONNX Runtime execution providers in order of preference.
            maximum_points: the cloud is thinned evenly to at most this many points.

        Raises:
            InvalidInputError: if there is no such file or a parameter is impossible.
            FileFormatError: if the file is not a VGGT network.
        """
        if not isinstance(mode, str) or mode not in ("crop", "pad"):
            raise InvalidInputError(f"mode must be 'crop' or 'pad', got {quoted(mode)}.")
        maximum_points = as_count(maximum_points, "maximum_points", least=1)
        self._graph = OnnxGraph(path, needed=_NEEDED, providers=providers)
        self._graph.require_image_input(1, None)
        wanted = {"pose_enc": 3, "world_points": 5, "world_points_conf": 4}
        shapes = self._graph.output_shapes
        if any(name not in shapes or len(shapes[name]) != axes for name, axes in wanted.items()):
            raise self._graph.mismatch(self._graph.describe_outputs())
        self._mode: Literal["crop", "pad"] = mode
        self._maximum_points = maximum_points
        self.fingerprint = hash_parameters(
            "VggtOnnx", self._graph.content_hash, mode=mode, maximum_points=maximum_points
        )

    def __call__(self, images: Sequence[Image]) -> Reconstruction:
        """Reconstruct cameras and points from the pictures of one instant, one per camera.

        Raises:
            InvalidInputError: if there is no picture or the graph needs a different number.
        """
        pictures = [as_image(image) for image in images]
        views = self._graph.input_shape[1]
        if not pictures or (views is not None and len(pictures) != views):
            raise InvalidInputError(
                f"{self._graph.path} needs {views or 'at least 1'} pictures at once, got "
                f"{len(pictures)}."
            )
        placements, target = self.preprocess([(p.shape[1], p.shape[0]) for p in pictures])
        inputs = [
            place.apply(picture, target, _WHITE)
            for place, picture in zip(placements, pictures, strict=True)
        ]
        batch = np.stack(inputs).transpose(0, 3, 1, 2).astype(np.float32) / 255
        outputs = {name: value[0] for name, value in self._graph.run(batch[None]).items()}
        encoding = outputs["pose_enc"].astype(np.float64)
        K_input, R, t, determined = decode_pose(encoding, target)
        K = [
            p.intrinsics_to_original(matrix) for p, matrix in zip(placements, K_input, strict=True)
        ]
        points, confidence = self._cloud(outputs, placements, target)
        return Reconstruction(
            np.stack(K),
            R,
            t,
            points,
            confidence,
            scale_is_metric=False,
            weights_id=self._graph.content_hash,
            registered=determined,
        )

    def preprocess(
        self, sizes: Sequence[tuple[int, int]]
    ) -> tuple[list[Letterbox], tuple[int, int]]:
        """Place each picture in the input.

        Args:
            sizes: (width, height) of each picture.

        Returns:
            The placements, and the (width, height) of the input.
        """
        fixed_height, fixed_width = self._graph.input_shape[3:]
        width = fixed_width or _USUAL_SIDE
        limit = fixed_height or _USUAL_SIDE
        resized = [_resized(size, width, limit, self._mode) for size in sizes]
        height = limit
        if fixed_height is None and self._mode == "crop":
            height = min(limit, max(new[1] for new in resized))
        target = (width, height)
        return [
            Letterbox.place(size, new, target) for size, new in zip(sizes, resized, strict=True)
        ], target

    def _cloud(
        self,
        outputs: dict[str, np.ndarray],
        placements: Sequence[Letterbox],
        target: tuple[int, int],
    ) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
        """Return points and confidences of the pixels that show a picture, thinned evenly."""
        in_picture = np.zeros(outputs["world_points_conf"].shape, bool)
        for view, place in enumerate(placements):
            in_picture[view][place.inside(target)] = True
        points = outputs["world_points"][in_picture]
        confidence = outputs["world_points_conf"][in_picture]
        sound = np.isfinite(points).all(-1) & np.isfinite(confidence) & (confidence > 0)
        rows = evenly_spread(np.flatnonzero(sound), self._maximum_points)
        return points[rows].astype(np.float64), confidence[rows].astype(np.float64)


def decode_pose(
    encoding: Float[np.ndarray, "view 9"], size: tuple[int, int]
) -> tuple[
    Float[np.ndarray, "view 3 3"],
    Float[np.ndarray, "view 3 3"],
    Float[np.ndarray, "view 3"],
    Bool[np.ndarray, " view"],
]:
    """Decode cameras from VGGT's pose encoding.

    Args:
        encoding: (S, 9) translation, quaternion x y z w, vertical and horizontal field of view in
            radians.
        size: (width, height) of the network's input in pixels.

    Returns:
        K in pixels of the input with the principal point at its middle, world-to-camera R and t,
        and whether each camera is determined.
    """
    width, height = size
    translation, quaternion, field_of_view = encoding[:, :3], encoding[:, 3:7], encoding[:, 7:]
    length = np.linalg.norm(quaternion, axis=1)
    low, high = _FIELD_OF_VIEW
    # NaN fails every comparison, so it counts as undetermined.
    determined = (length > _SMALLEST_QUATERNION) & np.isfinite(translation).all(1)
    determined &= ((field_of_view > low) & (field_of_view < high)).all(1)
    has_rotation = np.isfinite(length) & (length > _SMALLEST_QUATERNION)
    quaternion = np.where(has_rotation[:, None], quaternion, np.array([[0.0, 0.0, 0.0, 1.0]]))
    angle = np.clip(np.where(np.isfinite(field_of_view), field_of_view, low), low, high)
    K = np.zeros((len(encoding), 3, 3))
    K[:, 0, 0] = width / 2 / np.tan(angle[:, 1] / 2)
    K[:, 1, 1] = height / 2 / np.tan(angle[:, 0] / 2)
    K[:, :, 2] = np.array([width / 2, height / 2, 1])[None, :]
    t = np.where(np.isfinite(translation), translation, 0)
    return K, Rotation.from_quat(quaternion).as_matrix(), t, determined


def _resized(
    size: tuple[int, int], width: int, height: int, mode: Literal["crop", "pad"]
) -> tuple[int, int]:
    """Compute the resized (width, height); each free side is a multiple of the patch."""
    if mode == "crop":
        return width, _patches(size[1] * width / size[0])
    scale = min(width / size[0], height / size[1])
    return min(width, _patches(size[0] * scale)), min(height, _patches(size[1] * scale))


def _patches(length: float) -> int:
    return max(1, round(length / _PATCH)) * _PATCH
