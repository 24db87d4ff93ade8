"""Cameras whose boxes fit the rig far worse than those of the others do."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Bool, Float

from catfree.settings import CalibrationSettings


def residual_outliers(
    residual: Float[np.ndarray, " cam"], settings: CalibrationSettings
) -> Bool[np.ndarray, " cam"]:
    """Whose boxes fit clearly worse than the others' do (`strained_residual`).

    Args:
        residual: (C,) median residual of each camera in standard deviations, NaN where no box took
            part (`Calibration.camera_residual`).
        settings: constants.
    """
    if np.isnan(residual).all():
        return np.zeros(len(residual), bool)
    return residual > settings.strained_residual * np.nanmedian(residual)


def worst_outlier(
    residual: Float[np.ndarray, " cam"],
    support: Float[np.ndarray, " cam"],
    settings: CalibrationSettings,
    tried: Collection[int] = (),
) -> int | None:
    """The camera whose boxes fit worst, if clearly worse than the others'.

    A camera that settled beside its place matches enough of a crowd to stay there, in every
    criterion that counts matches. What gives it away is that nothing quite fits, or that hardly any
    of its boxes belong to people of whom the others are sure.

    Args:
        residual: (C,) median residual of each camera in standard deviations, NaN where no box took
            part (`Calibration.camera_residual`).
        support: (C,) share of each camera's boxes that sure people hold, NaN of cameras that are
            not in the rig.
        settings: constants.
        tried: cameras that are left as they are.

    Returns:
        Its index, or None if no camera stands out or there are too few to tell. Cameras without
        support come first.
    """
    cameras = [int(c) for c in np.flatnonzero(np.isfinite(support))]
    if len(cameras) < settings.fewest_to_compare:
        return None
    left = [c for c in cameras if c not in tried]
    least = settings.unsupported_share * np.median(support[cameras])
    alone = [c for c in left if support[c] < least]
    if alone:
        return min(alone, key=lambda c: support[c])
    strained = residual_outliers(np.where(np.isfinite(support), residual, np.nan), settings)
    return max((c for c in left if strained[c]), key=lambda c: residual[c], default=None)
