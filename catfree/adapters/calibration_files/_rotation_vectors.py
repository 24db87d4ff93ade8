"""Rotation vectors, the form in which calibration files keep rotations."""

import numpy as np
from scipy.spatial.transform import Rotation


def rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a (3,) rotation vector in radians (OpenCV's Rodrigues vector)."""
    return Rotation.from_rotvec(vector).as_matrix()


def rotation_to_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) rotation vector in radians, at most pi long, of a (3, 3) rotation."""
    return Rotation.from_matrix(rotation).as_rotvec()
