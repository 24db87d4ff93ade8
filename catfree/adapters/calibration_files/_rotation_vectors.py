"""Conversion of the rotation vectors that calibration files hold."""

import numpy as np
from scipy.spatial.transform import Rotation


def rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    """Convert a (3,) rotation vector in radians (OpenCV's Rodrigues) to a (3, 3) rotation."""
    return Rotation.from_rotvec(vector).as_matrix()


def rotation_to_vector(rotation: np.ndarray) -> np.ndarray:
    """Convert a (3, 3) rotation to a (3,) rotation vector in radians, at most pi long."""
    return Rotation.from_matrix(rotation).as_rotvec()
