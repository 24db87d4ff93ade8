"""How alike the focal lengths of the cameras are."""

import numpy as np
from jaxtyping import Float
from scipy.special import softmax

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
        settings: as likely as not the cameras are of one kind, with a spread of `shared_focal_sd`;
            otherwise its logarithm is equally likely anywhere from there to that of `focal_log_sd`.

    Returns:
        The posterior mean of the standard deviation from the common mean.

    Source: the likelihood of what differs between the cameras, whose mean is free: Patterson and
        Thompson (1971), "Recovery of inter-block information when block sizes are unequal".
    """
    count = len(log_focal)
    center = np.eye(count) - 1 / count
    variance, axes = np.linalg.eigh(center @ errors @ center)
    square = (axes.T @ center @ log_focal) ** 2
    others = np.geomspace(settings.shared_focal_sd, settings.focal_log_sd)
    spreads = np.append(settings.shared_focal_sd, others)
    prior = np.append(1.0, np.full(len(others), 1 / len(others)))
    # Without the mean's own axis, the first.
    total = np.maximum(variance[1:], 0) + spreads[:, None] ** 2
    log_likelihood = -(np.log(total) + square[1:] / total).sum(1) / 2
    return float(softmax(np.log(prior) + log_likelihood) @ spreads)
