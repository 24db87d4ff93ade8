"""How well the metric scale of a rig from pedestrians is known."""

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

    Three things make the scale, and each is uncertain: how tall the people of this place are (the
    mean of everybody who might walk here, and the few who do), how much larger than a person the
    detector draws a box, and what the bundle adjustment passes on of box noise and of the foot
    offset.

    Args:
        parameters: (C, 7) cameras as in `camera_model`.
        covariance: (7C + 1, 7C + 1) of them and the foot offset, from the bundle adjustment.
        known: (C,) cameras that count, at least two.
        people_at_a_time: mean number of matched people in a frame; more come by, so it understates
            how well their mean height represents the crowd's.
        settings: constants.

    Returns:
        The standard deviation of true length over estimated length.
    """
    cameras = np.flatnonzero(known)
    spread = parameters[cameras, X:] - parameters[cameras, X:].mean(0)
    # How much larger a rig is whose centres move: the slope of a fitted similarity.
    slope = np.zeros(len(covariance))
    index = 7 * cameras[:, None] + np.arange(X, 7)
    slope[index] = spread / max(float((spread**2).sum()), 1e-12)
    adjusted = float(slope @ covariance @ slope)
    crowd = settings.crowd_height_sd**2
    sample = settings.person_height_sd**2 / max(people_at_a_time, 1.0)
    heights = (crowd + sample) / settings.person_height**2
    return float(np.sqrt(max(adjusted, 0.0) + heights + settings.box_slack_sd**2))
