"""Thresholds estimated from the sequence: Otsu's split of a sample into a low and a high class.

Source: N. Otsu, "A threshold selection method from gray-level histograms", IEEE Transactions on
Systems, Man, and Cybernetics 9(1), 1979; here on the sample itself instead of a histogram. The
paper uses it on log sigma and log g (Sec. "Selecting pedestrian positions") and on the signals of
the score (Sec. "The Scoring Stage").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Num

from catfree.filters._sample_arrays import as_sample, as_selection
from catfree.types._annotations import HostOrDevice

# Splits whose criteria agree to this many units of rounding are ties, so that neither the order of
# the sample nor its unit decides between them.
TIE_ROUNDINGS = 4
# In units of rounding, each comparison leaves about the square root of the previous error: three
# reach the rounding of the values from any start.
REFINEMENTS = 3


class _Split(NamedTuple):
    """The best split of a sorted sample.

    Attributes:
        first_high: () position of the lowest member of the high class.
        exists: () whether the sample has two distinct values.
        separability: () between-class variance over total variance, in [0, 1].
    """

    first_high: Int[Array, ""]
    exists: Bool[Array, ""]
    separability: Float[Array, ""]


def _sorted_sample(
    values: Float[Array, " n"], member: Bool[Array, " n"]
) -> tuple[Float[Array, " sorted"], Int[Array, ""]]:
    """The members in ascending order, then +inf (two or more entries in all), and their number."""
    ordered = jnp.sort(jnp.where(member, values, jnp.inf))
    lacking = max(2 - len(ordered), 0)
    return jnp.pad(ordered, (0, lacking), constant_values=jnp.inf), jnp.sum(member)


@jax.jit  # compiled once per shape: outside jit, its loop would be compiled at every call
def _best_split(
    ordered: Float[Array, " n"], statistic: Float[Array, " n"], count: Int[Array, ""]
) -> _Split:
    """The split between distinct neighbors of `ordered` that best separates `statistic`.

    Args:
        ordered: (n,) sorted members, then padding.
        statistic: (n,) increasing function of the members whose variances are compared.
        count: () number of members.
    """
    size = statistic.shape[0]
    member = jnp.arange(size) < count
    total = jnp.maximum(count, 1).astype(statistic.dtype)
    # Centered and scaled to 1, sums of many float32 values stay accurate and cannot overflow; the
    # difference of two large values could, and the inverse of the largest is 0.
    is_large = jnp.any(member & (jnp.abs(statistic) > 1))
    statistic = jnp.where(is_large, statistic / 16, statistic)
    middle = statistic[jnp.maximum(count - 1, 0) // 2]
    centered = jnp.where(member, statistic - jnp.where(member, middle, statistic), 0)
    scale = jnp.max(jnp.abs(centered))
    centered = centered / jnp.where(scale > 0, scale, 1)
    centered = jnp.where(member, centered - jnp.sum(centered) / total, 0)

    # With the mean at 0: n_low n_high (mean_low - mean_high)² / n = n below² / (n_low n_high).
    below = jnp.cumsum(centered)[:-1]  # sum of the low class if it ends here
    low = jnp.arange(1, size).astype(statistic.dtype)
    between = total / low * below * (below / jnp.maximum(total - low, 1))
    allowed = member[1:] & (ordered[:-1] < ordered[1:])
    best = jnp.argmax(jnp.where(allowed, between, -1))
    # The criterion is so flat at its maximum that many splits of a large float32 sample seem equal:
    # compare them with the best so far by differences.
    fixed_centered, fixed_below = jax.lax.stop_gradient((centered, below))

    def refine(_: Int[Array, ""], reference: Int[Array, ""]) -> Int[Array, ""]:
        gain, rounding = _gain_over(reference, fixed_centered, fixed_below, total)
        surely = jnp.max(jnp.where(allowed, gain - rounding, -jnp.inf))
        return jnp.argmax(allowed & (gain + rounding >= surely))

    best = jax.lax.fori_loop(0, REFINEMENTS, refine, best)

    exists = jnp.any(allowed)
    spread = jnp.sum(jnp.square(centered))
    defined = exists & (spread > 0)
    separability = jnp.where(defined, between[best] / jnp.where(defined, spread, 1), 0)
    return _Split(best + 1, exists, jnp.clip(separability, 0, 1))


def _gain_over(
    reference: Int[Array, ""],
    centered: Float[Array, " n"],
    below: Float[Array, " split"],
    total: Float[Array, ""],
) -> tuple[Float[Array, " split"], Float[Array, " split"]]:
    """Relative gain of each split over a reference split, and its rounding error.

    Both shrink in proportion to the number of values between a split and the reference; the
    difference of two criteria would keep the rounding error of the criteria.
    """
    position = jnp.arange(centered.shape[0])
    beyond = position > reference
    # One scan for both sides: sums from the reference upwards, and downwards.
    sides = jnp.stack([jnp.where(beyond, centered, 0), jnp.where(beyond, 0, centered)[::-1]])
    upwards, downwards = jnp.cumsum(sides, axis=1)
    start = below[reference]
    low = (reference + 1).astype(centered.dtype)
    high = jnp.maximum(total - low, 1)
    step = (position[:-1] - reference).astype(centered.dtype)
    # Changes of below, n_low and n_high relative to the reference.
    s = (upwards[:-1] - downwards[::-1][1:]) / jnp.where(start == 0, 1, start)
    a, b = step / low, step / high
    # below² / (n_low n_high) becomes (1 + s)² / ((1 + a) (1 - b)) times as large.
    terms = (2 * s, jnp.square(s), -a, b, a * b)
    sizes = jnp.where(b < 1, (1 + a) * (1 - b), 1)
    unit = TIE_ROUNDINGS * jnp.finfo(centered.dtype).eps
    gain = sum(terms[1:], start=terms[0])
    rounding = unit * sum(map(jnp.abs, terms[1:]), start=jnp.abs(terms[0]))
    return gain / sizes, rounding / sizes


def otsu(
    values: Num[HostOrDevice, " n"], where: Bool[HostOrDevice, " n"] | None = None
) -> Float[Array, ""]:
    """Find the value that best separates a sample into a low and a high class.

    Exact on the sample: of all splits between distinct neighbors, the one with the largest
    between-class variance (the lowest of equals); the threshold is midway between the two
    neighbors. `value <= threshold` is the low class. If all values are equal, the threshold is that
    value and all are low. For an empty sample it is +inf.

    Args:
        values: (n,) sample, any unit. Entries that are not finite are not part of it.
        where: (n,) which entries are part of the sample; the others may hold anything.

    Returns:
        () threshold in the unit of the values.

    Source: Otsu 1979, Eq. 12 to 18.
    """
    values = as_sample(values)
    member = as_selection(where, values.shape) & jnp.isfinite(values)
    ordered, count = _sorted_sample(values, member)
    split = _best_split(ordered, ordered, count)
    lower, upper = _neighbors(ordered, split)
    middle = lower / 2 + upper / 2
    return _inside(middle, lower, upper)


def log_otsu(
    values: Num[HostOrDevice, " n"], where: Bool[HostOrDevice, " n"] | None = None
) -> Float[Array, ""]:
    """Find Otsu's threshold of skewed positive values: exp(Otsu(log values)).

    The split is chosen among the logarithms; the threshold is the geometric mean of the two
    neighbors, which equals exp of their mean logarithm without its rounding. Multiplying all values
    by a factor multiplies the threshold by it.

    Args:
        values: (n,) positive sample, any unit. Entries without a finite logarithm (zeros,
            infinities, negative numbers, NaN) are not part of the sample.
        where: (n,) which entries are part of the sample; the others may hold anything.

    Returns:
        () threshold in the unit of the values; +inf if no value is positive and finite.

    Source: paper, Sec. "Selecting pedestrian positions", tau_sigma and tau_g.
    """
    values = as_sample(values)
    member = as_selection(where, values.shape) & jnp.isfinite(values) & (values > 0)
    ordered, count = _sorted_sample(values, member)
    finite = jnp.isfinite(ordered)
    logarithm = jnp.log(jnp.where(finite, ordered, 1))
    split = _best_split(ordered, logarithm, count)
    lower, upper = _neighbors(ordered, split)
    defined = jnp.isfinite(lower)  # else the sample is empty and the root has no gradient
    middle = jnp.sqrt(jnp.where(defined, lower, 1)) * jnp.sqrt(jnp.where(defined, upper, 1))
    return _inside(jnp.where(defined, middle, lower), lower, upper)


def otsu_separability(
    values: Num[HostOrDevice, " n"], where: Bool[HostOrDevice, " n"] | None = None
) -> Float[Array, ""]:
    """Find the largest ratio of between-class to total variance over all splits of a sample.

    Args:
        values: (n,) sample, any unit. Entries that are not finite are not part of it.
        where: (n,) which entries are part of the sample; the others may hold anything.

    Returns:
        () separability in [0, 1]: 1 for two distinct values, 0 if there is nothing to split. It
        does not change under a shift or a scaling of the values.

    Source: Otsu 1979, Eq. 19 (eta).
    """
    values = as_sample(values)
    member = as_selection(where, values.shape) & jnp.isfinite(values)
    ordered, count = _sorted_sample(values, member)
    return _best_split(ordered, ordered, count).separability


def _neighbors(
    ordered: Float[Array, " n"], split: _Split
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The values on both sides of the split; twice the smallest value if there is no split."""
    upper = jnp.where(split.exists, split.first_high, 0)
    return ordered[jnp.maximum(upper - 1, 0)], ordered[upper]


def _inside(
    middle: Float[Array, ""], lower: Float[Array, ""], upper: Float[Array, ""]
) -> Float[Array, ""]:
    """The middle, or the lower neighbor if rounding put the middle on or past a neighbor."""
    return jnp.where((middle > lower) & (middle < upper), middle, lower)
