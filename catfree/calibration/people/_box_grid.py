"""Person boxes as measurements, padded to a regular (camera, frame, slot) grid."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.calibration.people._radial_lens import RadialLenses
from catfree.geometry._person import cut_by_border, edge_deviation
from catfree.settings import CalibrationSettings
from catfree.types import Detections
from catfree.types._sampling import evenly_spread


@dataclass(frozen=True)
class BoxGrid:
    """All boxes of all cameras, padded for array operations.

    Pixels are relative to the image center, the assumed principal point, without lens distortion.

    Attributes:
        u: (C, T, N) horizontal box center.
        top: (C, T, N) top row.
        bottom: (C, T, N) bottom row.
        sd: (C, T, N) standard deviation of an edge in pixels.
        valid: (C, T, N) whether the slot holds a box inside the image.
        row: (C, T, N) row in the detections, or -1.
        size: (C, 2) image width and height.
        frames: (T,) frame numbers.
    """

    u: Float[np.ndarray, "cam frame slot"]
    top: Float[np.ndarray, "cam frame slot"]
    bottom: Float[np.ndarray, "cam frame slot"]
    sd: Float[np.ndarray, "cam frame slot"]
    valid: Bool[np.ndarray, "cam frame slot"]
    row: Int[np.ndarray, "cam frame slot"]
    size: Int[np.ndarray, "cam 2"]
    frames: Int[np.ndarray, " frame"]

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return self.u.shape[0]

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self.u.shape[1]

    def at_frames(self, index: Int[np.ndarray, " chosen"]) -> "BoxGrid":
        """Select frames of the grid."""
        picked = {k: getattr(self, k)[:, index] for k in _PER_BOX}
        return BoxGrid(**picked, size=self.size, frames=self.frames[index])

    def thinned(self, most: int) -> "BoxGrid":
        """Select at most so many frames, evenly spread."""
        return self.at_frames(evenly_spread(np.arange(self.frame_count), most))

    def shifted(self, camera: int, shift: int) -> "BoxGrid":
        """Roll one camera's sequence circularly in time by `shift` frames."""
        rolled = {}
        for name in _PER_BOX:
            value = getattr(self, name).copy()
            value[camera] = np.roll(value[camera], shift, axis=0)
            rolled[name] = value
        return BoxGrid(**rolled, size=self.size, frames=self.frames)

    def of_camera(
        self, camera: int
    ) -> tuple[
        Float[np.ndarray, "frame slot"],
        Float[np.ndarray, "frame slot"],
        Float[np.ndarray, "frame slot"],
        Float[np.ndarray, "frame slot"],
        Bool[np.ndarray, "frame slot"],
    ]:
        """(T, N) u, top, bottom, standard deviations and validity of one camera's boxes."""
        c = camera
        return self.u[c], self.top[c], self.bottom[c], self.sd[c], self.valid[c]

    def edges(self, at: tuple[Any, ...]) -> Float[np.ndarray, "n 3"]:
        """(n, 3) u, top and bottom of the boxes at an index."""
        return np.stack([self.u[at], self.top[at], self.bottom[at]], -1)


_PER_BOX = ("u", "top", "bottom", "sd", "valid", "row")


def grid_boxes(
    detections: Detections,
    image_size: Int[np.ndarray, "cam 2"],
    settings: CalibrationSettings,
    lenses: RadialLenses | None = None,
) -> BoxGrid:
    """Sort person boxes into a padded grid.

    Args:
        detections: boxes of all cameras.
        image_size: (C, 2) width and height in pixels.
        settings: constants.
        lenses: lenses to remove from the boxes, ideal if None.

    Returns:
        The grid. Boxes that touch the image border are omitted, since at least one of their edges
        is not an edge of the person.
    """
    size = np.asarray(image_size)
    camera_count = len(size)
    frames = evenly_spread(np.unique(detections.frame), settings.maximum_frames)
    box = np.asarray(detections.box, np.float64)
    camera = np.clip(detections.camera, 0, camera_count - 1)
    inside = (
        ~cut_by_border(box, size[camera], settings.border).any(1)
        & (detections.camera < camera_count)
        & np.isin(detections.frame, frames)
    )
    row = np.flatnonzero(inside)
    time = np.searchsorted(frames, detections.frame[row])
    order = np.lexsort((box[row, 0], box[row, 3], time, camera[row]))
    row, time = row[order], time[order]
    group = camera[row] * len(frames) + time
    counts = np.bincount(group, minlength=camera_count * len(frames))
    slot = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    shape = (camera_count, len(frames), max(1, int(counts.max(initial=1))))
    at = (camera[row], time, slot)

    def spread(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "cam frame slot"]:
        grid = np.zeros(shape)
        grid[at] = values
        return grid

    edges = edges_from_center(box[row], size[camera[row]])
    if lenses is not None:
        edges = lenses.straightened(camera[row], edges)
    sd = edge_deviation(edges[:, 2] - edges[:, 1], settings.relative_sd, settings.pixel_sd)
    row_grid = np.full(shape, -1)
    row_grid[at] = row
    return BoxGrid(
        u=spread(edges[:, 0]),
        top=spread(edges[:, 1]),
        bottom=spread(edges[:, 2]),
        sd=np.where(row_grid >= 0, spread(sd), 1.0),
        valid=row_grid >= 0,
        row=row_grid,
        size=size,
        frames=frames,
    )


def edges_from_center(
    box: Float[np.ndarray, "n 4"], size: Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """(n, 3) middle column, top and bottom of boxes, in pixels from the middle of their images.

    Args:
        box: (n, 4) x1, y1, x2, y2 in pixels.
        size: (n, 2) width and height of each image in pixels.
    """
    across, down = ((size - 1) / 2).T
    middle = (box[:, 0] + box[:, 2]) / 2
    return np.column_stack([middle - across, box[:, 1] - down, box[:, 3] - down])
