"""COLMAP's camera models: numbers, names, parameters and equivalent OpenCV lenses.

The readers of text and binary files share them.
"""

import numpy as np

from catfree.adapters.calibration_files._named_rig import lens_coefficients
from catfree.errors import FileFormatError, shortened
from catfree.types import Lens

# Number, name and parameters of the supported models; coefficients are OpenCV's.
MODELS = {
    0: ("SIMPLE_PINHOLE", "f cx cy"),
    1: ("PINHOLE", "fx fy cx cy"),
    2: ("SIMPLE_RADIAL", "f cx cy k1"),
    3: ("RADIAL", "f cx cy k1 k2"),
    4: ("OPENCV", "fx fy cx cy k1 k2 p1 p2"),
    5: ("OPENCV_FISHEYE", "fx fy cx cy k1 k2 k3 k4"),
    6: ("FULL_OPENCV", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    8: ("SIMPLE_RADIAL_FISHEYE", "f cx cy k1"),
    9: ("RADIAL_FISHEYE", "f cx cy k1 k2"),
}
PARAMETERS = {name: parameters.split() for name, parameters in MODELS.values()}
COEFFICIENTS = {
    Lens.PINHOLE: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    Lens.FISHEYE: ("k1", "k2", "k3", "k4"),
}

# COLMAP puts the center of the top-left pixel at (0.5, 0.5), catfree and OpenCV at (0, 0).
PIXEL_CENTER = 0.5

# Model, width, height and parameters of a camera.
ColmapCamera = tuple[str, int, int, np.ndarray]
# Name, camera id, quaternion wxyz and translation of an image.
ColmapImage = tuple[str, int, np.ndarray, np.ndarray]


def intrinsics(
    model: str, parameters: np.ndarray, where: str
) -> tuple[np.ndarray, np.ndarray, Lens]:
    """Convert to (3, 3) K with catfree's pixel center, (8,) OpenCV coefficients, and the lens."""
    value = dict(zip(PARAMETERS[model], parameters.tolist(), strict=True))
    K = np.array(
        [
            [value.get("fx", value.get("f")), 0.0, value["cx"] - PIXEL_CENTER],
            [0.0, value.get("fy", value.get("f")), value["cy"] - PIXEL_CENTER],
            [0.0, 0.0, 1.0],
        ]
    )
    lens = Lens.FISHEYE if model.endswith("_FISHEYE") else Lens.PINHOLE
    coefficients = np.array([value.get(name, 0.0) for name in COEFFICIENTS[lens]])
    return K, lens_coefficients(coefficients, where, lens), lens


def supported_model(model: str, camera_id: int) -> str:
    """Return the model's name if it is supported.

    Raises:
        FileFormatError: if catfree does not support the model.
    """
    if model not in PARAMETERS:
        raise FileFormatError(
            f"camera {camera_id} has the model {shortened(model)}; supported are "
            f"{', '.join(PARAMETERS)}. Undistort the images with COLMAP first."
        )
    return model
