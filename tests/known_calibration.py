"""A given rig as the result of a calibration from people."""

from typing import Any

import numpy as np

from catfree.calibration import Calibration
from catfree.types import Scene


def calibration_of(scene: Scene, **others: Any) -> Calibration:
    """Make the calibration of a metric scene; values not in `others` are the same everywhere."""
    count = scene.rig.camera_count
    ones = np.ones(count)
    stated: dict[str, Any] = {
        "association_rate": ones,
        "log_likelihood_ratio": ones,
        "distortion_sd": 0 * ones,
        "camera_covariance": 1e-4 * np.eye(7 * count).reshape(count, 7, count, 7),
        "shared_focal": False,
        "scale_sd": 0.1,
        "crowd_height": 1.7,
        "crowd_height_sd": 0.06,
        "foot_offset": 0.15,
        "residual": 0.5,
        "camera_residual": 0.5 * ones,
        "sightings": np.full(count, 100),
        "frame_offset": np.zeros(count, int),
    }
    return Calibration(scene=scene, **stated | others)
