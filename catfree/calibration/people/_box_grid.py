"""Person boxes as measurements, padded to a regular (camera, frame, slot) grid."""

from dataclasses import dataclass

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
        box: (C, T, N, 3) horizontal center, top row and bottom row of each box.
        sd: (C, T, N) standard deviation of an edge in pixels.
        valid: (C, T, N) whether the slot holds a box inside the image.
        size: (C, 2) image width and height.
        frames: (T,) frame numbers.
    """

    box: Float[np.ndarray, "cam frame slot 3"]
    sd: Float[np.ndarray, "cam frame slot"]
    valid: Bool[np.ndarray, "cam frame slot"]
    size: Int[np.ndarray, "cam 2"]
    frames: Int[np.ndarray, " frame"]

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return self.valid.shape[0]

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self.valid.shape[1]

    def thinned(self, most: int) -> "BoxGrid":
        """Select at most this many frames, evenly spread."""
        at = evenly_spread(np.arange(self.frame_count), most)
        return BoxGrid(
            self.box[:, at], self.sd[:, at], self.valid[:, at], self.size, self.frames[at]
        )

    def shifted(self, camera: int, shift: int) -> "BoxGrid":
        """Roll one camera's sequence circularly in time by `shift` frames."""
        box, sd, valid = self.box.copy(), self.sd.copy(), self.valid.copy()
        for part in (box, sd, valid):
            part[camera] = np.roll(part[camera], shift, axis=0)
        return BoxGrid(box, sd, valid, self.size, self.frames)


def grid_boxes(
    detections: Detections,
    size: Int[np.ndarray, "cam 2"],
    settings: CalibrationSettings,
    lenses: RadialLenses,
) -> BoxGrid:
    """Sort person boxes into a padded grid.

    Args:
        detections: boxes of all cameras.
        size: (C, 2) width and height in pixels.
        settings: constants.
        lenses: lenses to remove from the boxes.

    Returns:
        The grid. Boxes that touch the image border are omitted, because at least one of their edges
        is not an edge of the person.
    """
    frames = evenly_spread(np.unique(detections.frame), settings.maximum_frames)
    box, camera = np.asarray(detections.box, np.float64), detections.camera
    is_cut = cut_by_border(box, size[camera], settings.border).any(1)
    row = np.flatnonzero(~is_cut & np.isin(detections.frame, frames))
    time = np.searchsorted(frames, detections.frame[row])
    order = np.lexsort((box[row, 0], box[row, 3], time, camera[row]))
    row, time = row[order], time[order]
    group = camera[row] * len(frames) + time
    counts = np.bincount(group, minlength=len(size) * len(frames))
    slot = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    shape = (len(size), len(frames), int(counts.max(initial=1)))
    at = (camera[row], time, slot)
    edges = lenses.straightened(camera[row], edges_from_center(box[row], size[camera[row]]))
    box_grid, sd, valid = np.zeros((*shape, 3)), np.ones(shape), np.zeros(shape, bool)
    box_grid[at], valid[at] = edges, True
    sd[at] = edge_deviation(edges[:, 2] - edges[:, 1], settings.relative_sd, settings.pixel_sd)
    return BoxGrid(box_grid, sd, valid, size, frames)


def edges_from_center(
    box: Float[np.ndarray, "n 4"], size: Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """(n, 3) center column, top and bottom row of boxes in pixels from the image center.

    Args:
        box: (n, 4) x1, y1, x2, y2 in pixels.
        size: (n, 2) width and height of each image in pixels.
    """
    across, down = ((size - 1) / 2).T
    middle = (box[:, 0] + box[:, 2]) / 2
    return np.column_stack([middle - across, box[:, 1] - down, box[:, 3] - down])
