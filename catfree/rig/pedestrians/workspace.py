"""Boxes of one sequence with what is computed once from them."""

import numpy as np

from catfree.rig.pedestrians.ground_map import GroundMap, map_ground
from catfree.rig.pedestrians.observations import BoxGrid
from catfree.rig.pedestrians.people import smallest_boxes
from catfree.rig.pedestrians.single_view import fit_planes
from catfree.settings import CalibrationSettings

QUICK_FRAMES = 24  # frames on which many placements are compared


class Workspace:
    """Boxes of one sequence with what is computed once from them."""

    def __init__(self, grid: BoxGrid, settings: CalibrationSettings) -> None:
        self.grid, self.settings = grid, settings
        self.smallest = smallest_boxes(grid)
        count = grid.frame_count
        self.voting = grid.at_frames(_spread(count, settings.voting_frames))
        self.quick = grid.at_frames(_spread(count, QUICK_FRAMES))
        self.scoring = grid.at_frames(_spread(count, settings.scoring_frames))
        self._planes: dict[tuple[int, float], np.ndarray] = {}

    def planes(self, camera: int, log_focal: float) -> np.ndarray:
        """Single-view planes of a camera at a focal length, remembered."""
        key = (camera, round(log_focal, 4))
        if key not in self._planes:
            self._planes[key] = fit_planes(self.grid, camera, np.exp(log_focal), self.settings)
        return self._planes[key]

    def local_map(
        self, grid: BoxGrid, camera: int, parameters: np.ndarray, tolerance: float
    ) -> GroundMap:
        """A camera's map of the ground with given parameters."""
        return map_ground(
            parameters,
            grid.u[camera],
            grid.top[camera],
            grid.bottom[camera],
            grid.sd[camera],
            grid.valid[camera],
            self.settings,
            foot_offset=self.settings.foot_offset,
            range_tolerance=tolerance,
        )


def _spread(count: int, wanted: int) -> np.ndarray:
    """Evenly spread frame indices."""
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int))
