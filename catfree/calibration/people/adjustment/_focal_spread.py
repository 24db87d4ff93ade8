"""The spread of focal lengths between cameras."""

import numpy as np
from jaxtyping import Float

from catfree.calibration.people.cameras._camera_model import LOG_FOCAL
from catfree.settings import CalibrationSettings

SURE = 2.7  # log likelihood gain that identical cameras reach with a probability of 1 %


def learn_focal_spread(
    log_focal: Float[np.ndarray, " cam"],
    covariance: Float[np.ndarray, "cam 7 cam 7"],
    settings: CalibrationSettings,
) -> tuple[float, Float[np.ndarray, "cam 7 cam 7"]]:
    """Learn the spread of log focal lengths between cameras, beyond their errors.

    Args:
        log_focal: (C,) of each camera, estimated independently of the others.
        covariance: (C, 7, C, 7) of the errors of these cameras.
        settings: `shared_focal_sd` is the spread of cameras of one kind, assumed unless another
            spread is significantly more likely.

    Returns:
        Standard deviation from the common mean, infinity if up to three cameras differ, which are
        too few to learn it; and the covariance (C, 7, C, 7) of the cameras adjusted with it, which
        covers the adjustments with other spreads, weighted by their likelihood.

    Source: the spread whose posterior means improve on the individual estimates, for four or more
        cameras: Efron and Morris (1973), "Stein's estimation rule and its competitors".
    """
    count = len(log_focal)
    center = np.eye(count) - 1 / count
    errors = covariance[:, LOG_FOCAL, :, LOG_FOCAL]
    variance, axes = np.linalg.eigh(center @ errors @ center)
    # Exclude the first axis, that of the mean.
    variance, axes = np.maximum(variance[1:], 0), axes[:, 1:]
    apart = axes.T @ log_focal
    spreads = np.geomspace(settings.shared_focal_sd, settings.focal_log_sd)
    precision = 1 / (variance + spreads[:, None] ** 2)
    misfit = (apart**2 * precision).sum(1)
    likelihood = (np.log(precision).sum(1) - misfit) / 2
    spread = settings.shared_focal_sd
    if likelihood.max() >= likelihood[0] + SURE:
        wide = np.flatnonzero(misfit <= count - 3)
        spread = float(spreads[wide[0]]) if len(wide) else np.inf
    # A spread changes the estimate and its covariance by linear maps of the separate focal lengths.
    weight = np.exp(likelihood - likelihood.max())
    weight /= weight.sum()
    change = (precision - 1 / (variance + spread**2)) * apart
    middle = (weight * change.T) @ change - np.diag(weight @ precision)
    slope = covariance[..., LOG_FOCAL] @ axes
    return spread, covariance + np.einsum("cia,ab,djb->cidj", slope, middle, slope)
