"""Boxes of one sequence and quantities computed once from them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people._box_grid import BoxGrid, grid_boxes
from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS, GroundMap, map_camera
from catfree.calibration.people.cameras._single_view import FEWEST_BOXES, fit_planes
from catfree.errors import CalibrationError
from catfree.settings import CalibrationSettings
from catfree.types import Detections
from catfree.types._validation import shown_camera


class Workspace:
    """Boxes of one sequence and quantities computed once from them.

    Attributes:
        grid: all boxes.
        settings: constants.
        lenses: lenses whose distortion was removed from the boxes.
        useful: (C,) whether a camera has enough boxes to be placed.
        smallest: (C,) box height in pixels below which a camera hardly detects people:
            the 5 % quantile.
        voting: frames used to vote on placements and to compare many of them.
        scoring: frames used to compare few placements.
    """

    def __init__(self, grid: BoxGrid, settings: CalibrationSettings, lenses: RadialLenses) -> None:
        self.grid, self.settings, self.lenses = grid, settings, lenses
        self.useful = grid.valid.sum((1, 2)) >= FEWEST_BOXES
        tall = np.where(grid.valid, grid.box[..., 2] - grid.box[..., 1], np.nan)
        shown = np.flatnonzero(grid.valid.any((1, 2)))
        self.smallest = np.full(grid.camera_count, np.inf)
        self.smallest[shown] = np.nanquantile(tall[shown], 0.05, axis=(1, 2))
        self.voting = grid.thinned(settings.voting_frames)
        self.scoring = grid.thinned(settings.scoring_frames)
        self._planes: dict[tuple[int, float], Float[np.ndarray, "plane 7"]] = {}
        self._maps: dict[tuple[int, bytes], GroundMap] = {}

    def planes(self, camera: int, log_focal: float) -> Float[np.ndarray, "plane 7"]:
        """Single-view planes of a camera for a focal length, cached."""
        key = (camera, round(log_focal, 4))
        if key not in self._planes:
            self._planes[key] = fit_planes(self.grid, camera, np.exp(log_focal), self.settings)
        return self._planes[key]

    def local_map(self, camera: int, plane: Float[np.ndarray, "7"]) -> GroundMap:
        """Map of a camera's people on one of its planes, in the voting frames, cached."""
        key = (camera, plane.tobytes())
        if key not in self._maps:
            self._maps[key] = map_camera(self.voting, camera, plane, self.settings, RANGE_ERRORS[0])
        return self._maps[key]


def prepare(
    detections: Detections,
    size: Int[np.ndarray, "cam 2"],
    settings: CalibrationSettings,
    camera_names: Sequence[str] | None,
    lenses: RadialLenses,
) -> Workspace:
    """Arrange the boxes in a grid, and check that there are enough.

    Args:
        detections: (N,) boxes of all cameras.
        size: (C, 2) image widths and heights in pixels.
        settings: constants.
        camera_names: for error messages.
        lenses: lenses whose distortion is removed from the boxes.

    Raises:
        CalibrationError: if there are too few cameras, frames or boxes.
    """
    grid = grid_boxes(detections, size, settings, lenses)
    work = Workspace(grid, settings, lenses)
    seeing = int(work.useful.sum())
    if seeing < 2:
        boxes = enumerate(grid.valid.sum((1, 2)).tolist())
        counts = ", ".join(f"{shown_camera(c, camera_names)}: {count}" for c, count in boxes)
        raise CalibrationError(
            f"Calibration from people needs 2 cameras with at least {FEWEST_BOXES} boxes "
            f"inside the image each, but has {seeing} ({counts or 'no cameras'})."
        )
    if grid.frame_count < settings.minimum_frames:
        raise CalibrationError(
            f"Calibration from people needs at least {settings.minimum_frames} frames with boxes, "
            f"and has {grid.frame_count}, too few to exclude chance agreement; record longer."
        )
    return work
