"""Conversion of the rotation vectors that calibration files hold."""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from catfree.adapters.files._documents import numbers
from catfree.errors import InvalidInputError


def rotation_from_vector(value: Any, where: str) -> np.ndarray:
    """Convert a rotation vector in radians (OpenCV's Rodrigues) to a (3, 3) rotation.

    Args:
        value: what the file holds, three numbers.
        where: the place in it, for messages.

    Raises:
        FileFormatError: if it is not three numbers.
        InvalidInputError: if it turns by more than a full turn, as angles in degrees do.
    """
    vector = numbers(value, (3,), where)
    if math.hypot(*vector) > 2 * math.pi:  # without overflow
        raise InvalidInputError(
            f"{where} is {vector.tolist()}, more than a full turn. A rotation vector is in "
            "radians; convert it from degrees."
        )
    return Rotation.from_rotvec(vector).as_matrix()
