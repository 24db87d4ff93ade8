"""The spread of focal lengths between cameras."""

import numpy as np
from jaxtyping import Float

from catfree.settings import CalibrationSettings

SURE = 2.7  # log likelihood gain that identical cameras reach with a probability of 1 %


def learn_focal_spread(
    log_focal: Float[np.ndarray, " cam"],
    errors: Float[np.ndarray, "cam cam"],
    settings: CalibrationSettings,
) -> float:
    """Learn the spread of log focal lengths between cameras, beyond their errors.

    Args:
        log_focal: (C,) of each camera, estimated independently of the others.
        errors: (C, C) covariance of their errors.
        settings: `shared_focal_sd` is the spread of cameras of one kind, assumed unless another
            spread is significantly more likely.

    Returns:
        Standard deviation from the common mean; infinity if up to three cameras differ, which are
        too few to learn it.

    Source: the spread whose posterior means improve on the individual estimates, for four or more
        cameras: Efron and Morris (1973), "Stein's estimation rule and its competitors".
    """
    count = len(log_focal)
    center = np.eye(count) - 1 / count
    variance, axes = np.linalg.eigh(center @ errors @ center)
    square = (axes.T @ center @ log_focal) ** 2
    spreads = np.geomspace(settings.shared_focal_sd, settings.focal_log_sd)
    # Exclude the first axis, that of the mean.
    total = np.maximum(variance[1:], 0) + spreads[:, None] ** 2
    misfit = (square[1:] / total).sum(1)
    likelihood = -(np.log(total).sum(1) + misfit) / 2
    if likelihood.max() < likelihood[0] + SURE:
        return settings.shared_focal_sd
    wide = np.flatnonzero(misfit <= count - 3)
    return float(spreads[wide[0]]) if len(wide) else np.inf
