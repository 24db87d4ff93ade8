"""Detection of cameras whose boxes fit the rig far worse than those of the others."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Bool, Float

from catfree.settings import CalibrationSettings


def residual_outliers(
    residual: Float[np.ndarray, " cam"], settings: CalibrationSettings
) -> Bool[np.ndarray, " cam"]:
    """Mark the cameras whose boxes fit clearly worse than the others' (`strained_residual`), (C,).

    Args:
        residual: (C,) median residual of each camera in standard deviations, NaN for cameras
            without boxes (`Calibration.camera_residual`).
        settings: constants.
    """
    if np.isnan(residual).all():
        return np.zeros(len(residual), bool)
    return residual > settings.strained_residual * np.nanmedian(residual)


def worst_outlier(
    residual: Float[np.ndarray, " cam"],
    support: Float[np.ndarray, " cam"],
    settings: CalibrationSettings,
    tried: Collection[int],
) -> int | None:
    """Find the camera whose boxes fit worst, if they fit clearly worse than the others'.

    A misplaced camera matches enough of a crowd to pass every criterion that counts matches. It is
    revealed by high residuals, or because few of its boxes belong to confident people.

    Args:
        residual: (C,) median residual of each camera in standard deviations, NaN for cameras
            without boxes (`Calibration.camera_residual`).
        support: (C,) fraction of each camera's boxes that belong to confident people, NaN for
            unregistered cameras.
        settings: constants.
        tried: cameras to ignore.

    Returns:
        The index of the camera, or None if none stands out or there are too few to compare. Cameras
        without support come first.
    """
    cameras = [int(c) for c in np.flatnonzero(np.isfinite(support))]
    if len(cameras) < settings.fewest_to_compare:
        return None
    untried = [c for c in cameras if c not in tried]
    least = settings.unsupported_share * np.median(support[cameras])
    unsupported = [c for c in untried if support[c] < least]
    if unsupported:
        return min(unsupported, key=lambda c: support[c])
    is_outlier = residual_outliers(np.where(np.isfinite(support), residual, np.nan), settings)
    return max((c for c in untried if is_outlier[c]), key=lambda c: residual[c], default=None)
