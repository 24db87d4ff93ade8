"""Precision of positions, and whether it suffices to report them."""

import numpy as np
from jaxtyping import Bool, Float

from catfree.methods.evidence._gaussian import probability_within
from catfree.settings import EvidenceSettings


def sharp_positions(
    covariance: Float[np.ndarray, "node state state"],
    shift: Float[np.ndarray, "node 2"],
    probability: Float[np.ndarray, " node"],
    settings: EvidenceSettings,
) -> tuple[Float[np.ndarray, "node 2 2"], Bool[np.ndarray, " node"]]:
    """Choose the rows that are more likely than not a person at the correct place.

    Args:
        covariance: of the states of M rows in H0.
        shift: (M, 2) position shift per unit of height of the feet above the plane, see
            `_uneven_ground`.
        probability: (M,) that the person is present.
        settings: `report_radius` is the largest error of a correct place.

    Returns:
        (M, 2, 2) covariances of the positions, with sway and uneven ground, and (M,) whether
        chosen.
    """
    spread = covariance[:, :2, :2] + settings.sway**2 * np.eye(2)
    spread = spread + settings.unevenness**2 * (shift[:, :, None] * shift[:, None, :])
    within = probability_within(spread, settings.report_radius)
    return spread, (probability > 0.5) & (within > 0.5)
