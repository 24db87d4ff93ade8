"""The auxiliary score: seven signals of each hypothesis, weighted by their separability.

Source: paper, Sec. "The Scoring Stage".
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Num

from catfree.errors import InvalidInputError
from catfree.filters._otsu import otsu, otsu_separability
from catfree.filters._sample_arrays import as_floating, as_mask, as_selection
from catfree.types._annotations import HostOrDevice


class Signal(IntEnum):
    """The columns of the signals; higher is better in each."""

    SUPPORTING_RAYS = 0
    NEGATIVE_MEDIAN_RESIDUAL = 1
    DETECTOR_CONFIDENCE = 2
    VIEW_SUPPORT_RATIO = 3
    HEIGHT_CONSISTENCY = 4
    TEMPORAL_PERSISTENCE = 5
    RECONSTRUCTION_CONFIDENCE = 6


class AuxiliaryScore(NamedTuple):
    """The score of H hypotheses.

    Attributes:
        score: (H,) weighted mean of the standardized signals; 0 is average.
        weights: (7,) weight of each signal, 0 if it is missing or constant.
        threshold: () Otsu's threshold of the score.
    """

    score: Float[Array, " h"]
    weights: Float[Array, "7"]
    threshold: Float[Array, ""]


def auxiliary_score(
    signals: Num[HostOrDevice, "h 7"], where: Bool[HostOrDevice, " h"] | None = None
) -> AuxiliaryScore:
    """Rank the hypotheses of a sequence by seven signals from the images.

    Each signal is standardized over the sequence and weighted by its Otsu separability; the weight
    of the reconstruction confidence is also multiplied by its correlation with the consensus of
    the other six, where that is positive.

    Args:
        signals: (H, 7) in the order of `Signal`, each in its own unit, higher is better. Entries
            that are not finite are missing and count as average.
        where: (H,) which hypotheses take part; the others may hold anything and score 0.

    Returns:
        Score, weights and threshold. They do not depend on the offset or scale of any signal.

    Raises:
        InvalidInputError: if there are not seven signals.

    Source: paper, Sec. "The Scoring Stage".
    """
    signals = as_floating(signals, "signals")
    if signals.ndim != 2 or signals.shape[1] != len(Signal):
        raise InvalidInputError(
            f"signals has shape {signals.shape}; it needs one column for each `Signal`, of which "
            f"there are {len(Signal)}. Fill those that are missing with NaN."
        )
    present = as_selection(where, signals.shape[:1])
    valid = present[:, None] & jnp.isfinite(signals)
    standardized = jax.vmap(_standardize, (1, 1), 1)(signals, valid)
    weights = jax.vmap(otsu_separability, (1, 1))(signals, valid)
    last = Signal.RECONSTRUCTION_CONFIDENCE
    consensus = standardized[:, :last] @ weights[:last]
    agreement = _correlation(standardized[:, last], consensus, valid[:, last])
    weights = weights.at[last].multiply(jnp.maximum(agreement, 0))
    total = jnp.sum(weights)
    score = standardized @ weights / jnp.where(total > 0, total, 1)
    return AuxiliaryScore(score, weights, otsu(score, present))


def view_support_ratio(
    supporting: Bool[HostOrDevice, " cam"], seeing: Bool[HostOrDevice, " cam"]
) -> Float[Array, ""]:
    """Compute the share of the cameras expected to see a position that do.

    Args:
        supporting: (C,) cameras with a supporting ray.
        seeing: (C,) cameras whose image contains the position; supporting cameras count as seeing.

    Returns:
        () in [0, 1]; 0 if no camera sees the position.

    Raises:
        InvalidInputError: if the two have different shapes, or hold anything but true and false.

    Source: paper, Sec. "The Scoring Stage", which names the signal but gives no formula.
    """
    supporting = as_mask(supporting, np.shape(supporting), "supporting")
    seeing_count = jnp.sum(supporting | as_mask(seeing, supporting.shape, "seeing"))
    ratio = jnp.sum(supporting) / jnp.maximum(seeing_count, 1)
    return ratio.astype(jnp.result_type(float))


def median_residual(
    residuals: Num[HostOrDevice, " cam"], where: Bool[HostOrDevice, " cam"]
) -> Float[Array, ""]:
    """Compute the median angular residual of the supporting rays; the signal is its negative.

    Args:
        residuals: (C,) angles in radians.
        where: (C,) cameras with a supporting ray; the others may hold anything.

    Returns:
        () in radians; NaN (a missing signal) without supporting rays.

    Source: paper, Sec. "The Scoring Stage", of the angles of Eq. theta.
    """
    residuals = as_floating(residuals, "residuals")
    where = as_selection(where, residuals.shape)
    if residuals.size == 0:
        return jnp.full((), jnp.nan, residuals.dtype)
    return jnp.nanmedian(jnp.where(where, residuals, jnp.nan))


def height_consistency(
    heights: Num[HostOrDevice, " cam"], where: Bool[HostOrDevice, " cam"]
) -> Float[Array, ""]:
    """Measure the cameras' agreement on a person's height: minus the relative spread.

    Args:
        heights: (C,) implied heights, any unit.
        where: (C,) which cameras have one; the others may hold anything.

    Returns:
        () minus standard deviation over mean magnitude, at most 0; NaN (a missing signal) if fewer
        than two cameras can be compared.

    Source: paper, Sec. "The Scoring Stage", which names the signal but gives no formula.
    """
    heights = as_floating(heights, "heights")
    where = as_selection(where, heights.shape)
    values = jnp.where(where, heights, 0)
    count = jnp.maximum(jnp.sum(where), 1).astype(values.dtype)
    magnitude = jnp.sum(jnp.abs(values)) / count
    comparable = (jnp.sum(where) >= 2) & (magnitude > 0)
    # Squares of heights themselves overflow in some units.
    values = values / jnp.where(comparable, magnitude, 1)
    deviation = jnp.where(where, values - jnp.sum(values) / count, 0)
    variance = jnp.sum(jnp.square(deviation)) / count
    spread = jnp.sqrt(jnp.where(variance > 0, variance, 1))
    return jnp.where(comparable, -jnp.where(variance > 0, spread, 0), jnp.nan)


def _standardize(values: Float[Array, " h"], valid: Bool[Array, " h"]) -> Float[Array, " h"]:
    """Scale to zero mean and unit variance over the valid entries; 0 elsewhere or if all equal."""
    count = jnp.maximum(jnp.sum(valid), 1).astype(values.dtype)
    values = jnp.where(valid, values, 0)
    # Centering twice brings a constant column to 0 within its rounding.
    values = jnp.where(valid, values - jnp.sum(values) / count, 0)
    values = jnp.where(valid, values - jnp.sum(values) / count, 0)
    largest = jnp.max(jnp.abs(values), initial=0)  # its square overflows in some units
    values = values / jnp.where(largest > 0, largest, 1)
    variance = jnp.sum(jnp.square(values)) / count
    return values / jnp.sqrt(jnp.where(variance > 0, variance, 1))


def _correlation(
    first: Float[Array, " h"], second: Float[Array, " h"], where: Bool[Array, " h"]
) -> Float[Array, ""]:
    """Pearson's correlation over the entries in `where`; 0 if one is constant."""
    first, second = _standardize(first, where), _standardize(second, where)
    count = jnp.maximum(jnp.sum(where), 1).astype(first.dtype)
    return jnp.clip(jnp.sum(first * second) / count, -1, 1)
