"""Lens coefficients of calibration files."""

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import StrPath
from catfree.errors import FileFormatError
from catfree.types import Lens


def lens_coefficients(
    values: np.ndarray, source: StrPath, where: str, lens: Lens = Lens.PINHOLE
) -> Float[np.ndarray, "8"]:
    """Check a list of coefficients that may be shorter than its model has, or end in zeros.

    Args:
        values: (n,) coefficients in OpenCV's order; an empty list means an ideal lens.
        source: the file, for messages.
        where: the camera, for messages.
        lens: `FISHEYE` for k1 to k4 of `cv2.fisheye`.

    Returns:
        (8,) float64, zero where the list ends.

    Raises:
        FileFormatError: if a coefficient is not finite, or the model has fewer that are not zero.
    """
    if not np.isfinite(values).all():
        raise FileFormatError(f"{source}: the distortion of {where} is not finite.")
    most = 4 if lens == Lens.FISHEYE else 8
    if values[most:].any():
        supported = "k1 to k4 of a fisheye" if most == 4 else "k1, k2, p1, p2, k3, k4, k5, k6"
        raise FileFormatError(
            f"{source}: the distortion of {where} has {len(values)} coefficients, but only "
            f"{supported} are supported (no thin-prism or tilted model). Undistort the images or "
            "calibrate again with fewer coefficients."
        )
    coefficients = np.zeros(8)
    coefficients[: min(most, len(values))] = values[:most]
    return coefficients
