"""How alike the focal lengths of the cameras are."""

import numpy as np
from jaxtyping import Float

from catfree.settings import CalibrationSettings


def learn_focal_spread(
    log_focal: Float[np.ndarray, " cam"],
    errors: Float[np.ndarray, "cam cam"],
    settings: CalibrationSettings,
) -> float:
    """Learn by how much log focal lengths differ between cameras, beyond their errors.

    Args:
        log_focal: (C,) of each camera, found without regard to the others.
        errors: (C, C) covariance of their errors.
        settings: `shared_focal_sd` is the spread of cameras of one kind. Another one has to be more
            likely by a factor of e, the price of one parameter (Akaike, 1974).

    Returns:
        Standard deviation from the common mean, of which nothing is assumed.
    """
    center = np.eye(len(log_focal)) - 1 / len(log_focal)
    variance, axes = np.linalg.eigh(center @ errors @ center)
    square = (axes.T @ center @ log_focal) ** 2
    spreads = np.geomspace(settings.shared_focal_sd, settings.focal_log_sd)
    # Without the mean's own axis, the first.
    total = np.maximum(variance[1:], 0) + spreads[:, None] ** 2
    likelihood = -(np.log(total) + square[1:] / total).sum(1) / 2
    best = int(np.argmax(likelihood))
    return float(spreads[best if likelihood[best] > likelihood[0] + 1 else 0])
