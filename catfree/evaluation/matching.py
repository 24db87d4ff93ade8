"""One-to-one matching within a gate: most pairs first, then the smallest total distance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment


class Matching(NamedTuple):
    """Matched pairs of one frame.

    Attributes:
        truth: (m,) index of the ground-truth point of each pair.
        predicted: (m,) index of its prediction.
        distance: (m,) their distance in metres.
    """

    truth: Int[np.ndarray, " m"]
    predicted: Int[np.ndarray, " m"]
    distance: Float[np.ndarray, " m"]


def match(distance: Float[np.ndarray, "g p"], gate: float) -> Matching:
    """Match true points to predictions no farther than `gate`.

    Args:
        distance: (g, p) distances in metres.
        gate: largest distance of a pair in metres, itself included.

    Returns:
        The matching with the most pairs and, among those, the smallest total distance.
    """
    admissible = distance <= gate
    # One pair more must outweigh any saving on the others, so a forbidden pair costs more than
    # all admissible ones together. An infinite cost would make the assignment infeasible.
    forbidden = 2 * gate * (min(distance.shape) + 1)
    truth, predicted = linear_sum_assignment(np.where(admissible, distance, forbidden))
    kept = admissible[truth, predicted]
    truth, predicted = truth[kept], predicted[kept]
    return Matching(truth, predicted, distance[truth, predicted])
