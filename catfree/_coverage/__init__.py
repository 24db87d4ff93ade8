"""How well a rig can localize people, place by place, before anybody has walked there.

Only the cameras are needed: where two of them see the same ground, the angular noise of foot rays
says how uncertain a position there will be. Occlusion by other people and by walls is not known,
so every answer is an upper bound of what the site will deliver.
"""

from catfree._coverage._camera_ranking import (
    CameraGain as CameraGain,
    CameraRanking as CameraRanking,
    camera_gain as camera_gain,
    coverage_with as coverage_with,
    coverage_without as coverage_without,
    rank_cameras as rank_cameras,
)
from catfree._coverage._expected_sigma import (
    Coverage as Coverage,
    CoverageOptions as CoverageOptions,
    coverage as coverage,
    visible_area as visible_area,
)
