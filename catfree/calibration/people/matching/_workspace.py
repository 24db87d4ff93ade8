"""Boxes of one sequence with what is computed once from them."""

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._ground_map import GroundMap, map_ground
from catfree.calibration.people.cameras._single_view import fit_planes
from catfree.calibration.people.matching._group_people import smallest_boxes
from catfree.settings import CalibrationSettings
from catfree.types._sampling import evenly_spread

QUICK_FRAMES = 24  # frames on which many placements are compared


class Workspace:
    """Boxes of one sequence with what is computed once from them.

    Args:
        grid: all boxes.
        settings: constants.

    Attributes:
        grid: all boxes.
        settings: constants.
        smallest: (C,) box height in pixels below which a camera hardly detects anybody.
        voting: frames on which placements are voted for.
        quick: frames on which many placements are compared.
        scoring: frames on which few placements are compared.
    """

    def __init__(self, grid: BoxGrid, settings: CalibrationSettings) -> None:
        self.grid, self.settings = grid, settings
        self.smallest = smallest_boxes(grid)
        count = grid.frame_count
        self.voting = grid.at_frames(evenly_spread(np.arange(count), settings.voting_frames))
        self.quick = grid.at_frames(evenly_spread(np.arange(count), QUICK_FRAMES))
        self.scoring = grid.at_frames(evenly_spread(np.arange(count), settings.scoring_frames))
        self._planes: dict[tuple[int, float], Float[np.ndarray, "plane 7"]] = {}

    def planes(self, camera: int, log_focal: float) -> Float[np.ndarray, "plane 7"]:
        """Single-view planes of a camera at a focal length, remembered."""
        key = (camera, round(log_focal, 4))
        if key not in self._planes:
            self._planes[key] = fit_planes(self.grid, camera, np.exp(log_focal), self.settings)
        return self._planes[key]

    def local_map(
        self, grid: BoxGrid, camera: int, parameters: Float[np.ndarray, "7"], tolerance: float
    ) -> GroundMap:
        """A camera's map of the ground with given parameters.

        Args:
            grid: the frames to map.
            camera: which camera.
            parameters: (7,) where it stands.
            tolerance: share of the range by which the map may be wrong.
        """
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
