"""Boxes of people in cameras with seven parameters."""

import numpy as np

from catfree.calibration.people.cameras._camera_model import X, Z, projection
from catfree.geometry._person import NEAREST_DEPTH, box_ends, edges_of


def boxes_of_rows(
    parameters: np.ndarray, xy: np.ndarray, height: np.ndarray, foot_offset: float
) -> np.ndarray:
    """Return (n, 3) edges of people (n, 2) with heights (n,) in one camera (7,) or (n, 7)."""
    person = np.column_stack([xy, height])
    head, foot, depth = box_ends(projection(parameters), person, parameters[..., X:Z], foot_offset)
    assert (depth > NEAREST_DEPTH).all(), "The camera does not see all of these people."
    return edges_of(head, foot)
