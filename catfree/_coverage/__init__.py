"""Prediction of how well a rig can localize people at each place, before recording anyone.

Only the cameras are needed: where two of them see the same ground, the angular noise of foot rays
determines the uncertainty of a position. Occlusion by people and walls is not modeled, so every
result is an upper bound on the actual accuracy.
"""

from catfree._coverage._camera_ranking import (
    CameraGain as CameraGain,
    CameraRanking as CameraRanking,
    camera_gain as camera_gain,
    rank_cameras as rank_cameras,
)
from catfree._coverage._expected_sigma import (
    Coverage as Coverage,
    CoverageOptions as CoverageOptions,
    coverage as coverage,
    visible_area as visible_area,
)
