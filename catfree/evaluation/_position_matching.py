"""One-to-one matching within a gate: most pairs first, then the smallest total distance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from catfree.evaluation._rows import Sequence

# Positions of the public data sets lie on grids of 2.5 cm, so distances of exactly 0.5 m are
# common; the tolerance keeps them inside the gate after the conversion from cells to meters.
GATE_TOLERANCE = 1e-9


class Matching(NamedTuple):
    """Matched pairs of one frame.

    Attributes:
        truth: (m,) index of the ground-truth point of each pair.
        predicted: (m,) index of its prediction.
        distance: (m,) their distance in meters.
    """

    truth: Int[np.ndarray, " m"]
    predicted: Int[np.ndarray, " m"]
    distance: Float[np.ndarray, " m"]


def match(distance: Float[np.ndarray, "g p"], admissible: Bool[np.ndarray, "g p"]) -> Matching:
    """Match true points to predictions, using only admissible pairs.

    Args:
        distance: (g, p) distances in meters; pairs that are not admissible may hold anything.
        admissible: (g, p) which pairs may be matched.

    Returns:
        The matching with the most pairs and, among those, the smallest total distance.
    """
    # One more pair must outweigh any saving on the others, so a forbidden pair costs more than all
    # admissible pairs together. An infinite cost would make the assignment infeasible.
    largest = distance[admissible].max(initial=0.0)
    forbidden = 2 * min(distance.shape) * (largest + 1) + 1
    truth, predicted = linear_sum_assignment(np.where(admissible, distance, forbidden))
    kept = admissible[truth, predicted]
    truth, predicted = truth[kept], predicted[kept]
    return Matching(truth, predicted, distance[truth, predicted])


def match_within(distance: Float[np.ndarray, "g p"], gate: float) -> Matching:
    """Match true points to predictions at most `gate` meters away; see `match`."""
    return match(distance, distance <= gate + GATE_TOLERANCE)


def matched_rows(
    sequence: Sequence, gate: float
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Match every frame by distance.

    Args:
        sequence: ground truth and predictions.
        gate: largest distance of a pair in meters.

    Returns:
        Indices of the paired rows in `sequence.truth` and in `sequence.predicted`.
    """
    truths = [np.zeros(0, dtype=np.int64)]
    predictions = [np.zeros(0, dtype=np.int64)]
    for truth, predicted in sequence:
        pairs = match_within(sequence.distances(truth, predicted), gate)
        truths.append(truth[pairs.truth])
        predictions.append(predicted[pairs.predicted])
    return np.concatenate(truths), np.concatenate(predictions)
