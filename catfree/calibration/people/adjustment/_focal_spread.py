"""How alike the focal lengths of the cameras are."""

import numpy as np
from jaxtyping import Float

from catfree.settings import CalibrationSettings

SURE = 2.7  # gain in log likelihood that cameras of one kind reach once in a hundred times


def learn_focal_spread(
    log_focal: Float[np.ndarray, " cam"],
    errors: Float[np.ndarray, "cam cam"],
    settings: CalibrationSettings,
) -> float:
    """Learn by how much log focal lengths differ between cameras, beyond their errors.

    Args:
        log_focal: (C,) of each camera, found without regard to the others.
        errors: (C, C) covariance of their errors.
        settings: `shared_focal_sd` is the spread of cameras of one kind, which is assumed unless
            another one is surely likelier.

    Returns:
        Standard deviation from the common mean; infinity for up to three cameras that differ, from
        which it cannot be learned.

    Source: the spread whose posterior means are better than what each camera finds for itself, for
        four cameras and more: Efron and Morris (1973), "Stein's estimation rule and its
        competitors".
    """
    count = len(log_focal)
    center = np.eye(count) - 1 / count
    variance, axes = np.linalg.eigh(center @ errors @ center)
    square = (axes.T @ center @ log_focal) ** 2
    spreads = np.geomspace(settings.shared_focal_sd, settings.focal_log_sd)
    # Without the mean's own axis, the first.
    total = np.maximum(variance[1:], 0) + spreads[:, None] ** 2
    misfit = (square[1:] / total).sum(1)
    likelihood = -(np.log(total).sum(1) + misfit) / 2
    if likelihood.max() < likelihood[0] + SURE:
        return settings.shared_focal_sd
    wide = np.flatnonzero(misfit <= count - 3)
    return float(spreads[wide[0]]) if len(wide) else np.inf
