"""Cameras whose boxes fit the rig far worse than those of the others do."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float

# Times the usual residual of a camera. With everybody in place cameras differ by up to 1.3: lenses,
# distances. A camera beside its place by a tenth of its range has twice the usual.
STRAINED = 1.5
FEWEST_TO_COMPARE = 4  # cameras; of fewer each bends the others as much as itself


def most_strained(residual: Float[np.ndarray, " cam"], tried: Collection[int] = ()) -> int | None:
    """The camera whose boxes fit worst, if clearly worse than the others'.

    A camera that settled beside its place matches enough of a crowd to stay there, in every
    criterion that counts matches. What gives it away is that nothing quite fits.

    Args:
        residual: (C,) median residual of each camera in standard deviations, NaN of those that are
            not in the rig (`Calibration.camera_residual`).
        tried: cameras that are left as they are.

    Returns:
        Its index, or None if no camera stands out or there are too few to tell.
    """
    cameras = np.flatnonzero(np.isfinite(residual))
    if len(cameras) < FEWEST_TO_COMPARE:
        return None
    limit = STRAINED * np.median(residual[cameras])
    left = [int(c) for c in cameras if c not in tried and residual[c] > limit]
    return max(left, key=lambda c: residual[c], default=None)
