"""The common type that every data-set reader returns: `MultiViewSequence`."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError
from catfree.types import Detections, Rig, Scene


@dataclasses.dataclass(frozen=True, eq=False)
class MultiViewSequence:
    """Detections of synchronized static cameras, with the data set's ground truth.

    Frames keep the numbers of their source, which may step by more than one (WildTrack: 0, 5, 10,
    ...). They are synchronized labels: two frames are consecutive if they are neighbors in
    `frames`, not if their numbers differ by one.

    Attributes:
        name: name of the sequence.
        detections: person boxes of all cameras and frames.
        rig: true or given cameras in the order of `camera_names`, or None if unknown.
        scene: rig, ground and extent, or None if the rig is unknown. A metric scene is in
            meters with z up and the ground at z = 0.
        ground_truth: (G, 4) float64 rows [frame, id, x, y]: true positions on the ground in
            meters; id is -1 if identities are unknown. They are in the frame of the scene,
            or in that of `true_centres` if `scene.metric` is False.
        frames: (F,) int64 ascending numbers of all frames, including those without detections.
        camera_names: (C,) names; `detections.camera` indexes them.
        fps: synchronized frames per second, or None if unknown.
        evaluation_area: x_min, x_max, y_min, y_max in meters of the area that is annotated, or
            None for everywhere.
        true_centres: (C, 3) true camera centers in meters, in the frame of `ground_truth`, or
            None if unknown.
        images: (C, F) path of the image of each camera and frame, None if the file is missing;
            empty if the source has no images.
        identity: (N,) int64 true person of each detection for annotated boxes, -1 if unknown;
            None if the boxes come from a detector.
        points: (P, 3) reconstructed scene points in scene units, or None.
    """

    name: str
    detections: Detections
    rig: Rig | None
    scene: Scene | None
    ground_truth: Float[np.ndarray, "g 4"]
    frames: Int[np.ndarray, " f"]
    camera_names: tuple[str, ...]
    fps: float | None = None
    evaluation_area: tuple[float, float, float, float] | None = None
    true_centres: Float[np.ndarray, "cam 3"] | None = None
    images: tuple[tuple[Path | None, ...], ...] = ()
    identity: Int[np.ndarray, " n"] | None = None
    points: Float[np.ndarray, "p 3"] | None = None

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return len(self.camera_names)

    @property
    def image_size(self) -> Int[np.ndarray, "cam 2"] | None:
        """(C, 2) width and height in pixels, or None if the rig is unknown."""
        return None if self.rig is None else self.rig.image_size

    def select_frames(self, frames: Any) -> "MultiViewSequence":
        """Select some frames by their numbers, leaving everything else unchanged.

        Raises:
            InvalidInputError: if a frame number is not one of the sequence's.
        """
        chosen = np.unique(np.asarray(frames, np.int64))
        unknown = ~np.isin(chosen, self.frames)
        if unknown.any():
            raise InvalidInputError(
                f"{self.name} has no frame {int(chosen[unknown][0])}; choose from its `frames` "
                f"({len(self.frames)} numbers)."
            )
        rows = np.isin(self.detections.frame, chosen)
        columns = np.flatnonzero(np.isin(self.frames, chosen))
        return dataclasses.replace(
            self,
            detections=self.detections[rows],
            ground_truth=self.ground_truth[np.isin(self.ground_truth[:, 0], chosen)],
            frames=chosen,
            images=tuple(tuple(row[i] for i in columns) for row in self.images),
            identity=None if self.identity is None else self.identity[rows],
        )


def require_people_in_front(rig: Rig, positions: np.ndarray) -> None:
    """Raise if every camera has most of the true positions behind it.

    This indicates a left-handed world or camera-to-world extrinsics.

    Args:
        rig: the cameras, meters, z up.
        positions: (G, 2) true x, y on the ground z = 0 in meters; zero rows pass.

    Raises:
        InvalidInputError: stating the share of positions behind the cameras.
    """
    if len(positions) == 0:
        return
    axis = np.asarray(rig.R)[:, 2]
    depth = axis[:, :2] @ positions.T + np.asarray(rig.t)[:, 2:]
    behind = (depth <= 0).mean(-1)
    if (behind > 0.5).all():
        raise InvalidInputError(
            f"the calibration puts {100 * behind.min():.0f} % or more of the annotated positions "
            "behind every camera: its world is mirrored or its extrinsics are camera-to-world "
            "instead of x_camera = R x + t."
        )
