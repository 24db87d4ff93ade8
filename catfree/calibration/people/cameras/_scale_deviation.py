"""Uncertainty of the metric scale of a rig registered from pedestrians."""

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.people.cameras._camera_model import X
from catfree.settings import CalibrationSettings


def scale_deviation(
    parameters: Float[np.ndarray, "cam 7"],
    covariance: Float[np.ndarray, "common common"],
    known: Bool[np.ndarray, " cam"],
    people_at_a_time: float,
    settings: CalibrationSettings,
) -> float:
    """Relative standard deviation of all lengths of a rig.

    The scale has three sources of uncertainty: the height of the local people (the population mean
    and the finite sample), the excess size of detector boxes over people, and the box noise and
    foot offset, propagated by the bundle adjustment.

    Args:
        parameters: (C, 7) cameras as in `_camera_model`.
        covariance: (7C + 1, 7C + 1) of cameras and foot offset, from the bundle adjustment.
        known: (C,) cameras to use, at least two.
        people_at_a_time: mean number of matched people per frame; a lower bound of the number of
            distinct people, so the sampling error is overestimated.
        settings: constants.

    Returns:
        The standard deviation of true length over estimated length.
    """
    cameras = np.flatnonzero(known)
    spread = parameters[cameras, X:] - parameters[cameras, X:].mean(0)
    # Derivative of the scale of a fitted similarity with respect to the camera centers.
    slope = np.zeros(len(covariance))
    index = 7 * cameras[:, None] + np.arange(X, 7)
    slope[index] = spread / max(float((spread**2).sum()), 1e-12)
    adjusted = float(slope @ covariance @ slope)
    crowd = settings.crowd_height_sd**2
    sample = settings.person_height_sd**2 / max(people_at_a_time, 1.0)
    heights = (crowd + sample) / settings.person_height**2
    return float(np.sqrt(max(adjusted, 0.0) + heights + settings.box_slack_sd**2))
