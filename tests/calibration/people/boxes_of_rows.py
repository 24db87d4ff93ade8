"""Boxes of people, each in a camera of its own."""

import numpy as np

from catfree.calibration.people.cameras._camera_model import predict_boxes


def boxes_of_rows(
    parameters: np.ndarray, xy: np.ndarray, height: np.ndarray, foot_offset: float
) -> np.ndarray:
    """(n, 3) edges of people (n, 2) with heights (n,) in cameras (n, 7)."""
    rows = zip(parameters, xy, height, strict=True)
    return np.array([predict_boxes(c, p[None], h[None], foot_offset)[0][0] for c, p, h in rows])
