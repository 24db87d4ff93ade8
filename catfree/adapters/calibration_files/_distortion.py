"""Lens coefficients of calibration files."""

from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import numbers
from catfree.errors import FileFormatError
from catfree.types import Lens


def lens_coefficients(value: Any, where: str, lens: Lens = Lens.PINHOLE) -> Float[np.ndarray, "8"]:
    """Convert a list of coefficients that may be shorter than its model has, or end in zeros.

    Args:
        value: what the file holds, coefficients in OpenCV's order; none means an ideal lens.
        where: the camera, for messages.
        lens: `FISHEYE` for k1 to k4 of `cv2.fisheye`.

    Returns:
        (8,) float64, zero where the list ends.

    Raises:
        FileFormatError: if it holds something else, or the model has fewer that are not zero.
        InvalidInputError: if a coefficient is not finite.
    """
    values = numbers(value, None, f"the distortion of {where}")
    most = 4 if lens == Lens.FISHEYE else 8
    if values[most:].any():
        supported = "k1 to k4 of a fisheye" if most == 4 else "k1, k2, p1, p2, k3, k4, k5, k6"
        raise FileFormatError(
            f"the distortion of {where} has {len(values)} coefficients, but only {supported} are "
            "supported (no thin-prism or tilted model). Undistort the images or calibrate again "
            "with fewer coefficients."
        )
    coefficients = np.zeros(8)
    coefficients[: min(most, len(values))] = values[:most]
    return coefficients
