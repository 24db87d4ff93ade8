"""Conversion of lens coefficients to the five that a `Rig` holds."""

import numpy as np

from catfree.adapters.files._documents import StrPath
from catfree.errors import FileFormatError


def five_coefficients(values: np.ndarray, source: StrPath, where: str) -> np.ndarray:
    """Convert a list that may be shorter, or end in zeros, to OpenCV k1, k2, p1, p2, k3.

    Args:
        values: (n,) coefficients in OpenCV's order; an empty list means an ideal pinhole.
        source: the file, for messages.
        where: the camera, for messages.

    Returns:
        (5,) float64.

    Raises:
        FileFormatError: if a coefficient is not finite, or a sixth or later one is not zero.
    """
    if not np.isfinite(values).all():
        raise FileFormatError(f"{source}: the distortion of {where} is not finite.")
    if values[5:].any():
        raise FileFormatError(
            f"{source}: the distortion of {where} has {len(values)} coefficients (rational or "
            "thin-prism model), but only k1, k2, p1, p2, k3 are supported. Undistort the images "
            "or calibrate again with five coefficients."
        )
    result = np.zeros(5)
    result[: min(5, len(values))] = values[:5]
    return result
