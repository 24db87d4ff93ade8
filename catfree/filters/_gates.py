"""The adaptive filters on uncertainty sigma and ground distance g, in every order of the ablation.

Source: paper, Sec. "Selecting pedestrian positions" and Table "gates".
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num

from catfree.errors import InvalidInputError, quoted
from catfree.filters._otsu import log_otsu, otsu
from catfree.filters._sample_arrays import as_floating, as_mask, as_selection
from catfree.settings import Selection
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import as_number

Gate = Literal["support", "uncertainty", "ground"]
Sample = Literal["all", "remaining"]

# Each order of the ablation: its gates in order, and the candidates that set their thresholds.
ORDERS: dict[Selection, tuple[tuple[Gate, Sample], ...]] = {
    "none": (),
    "support": (("support", "all"),),
    "ground_only": (("support", "all"), ("ground", "all")),
    "uncertainty_add": (("support", "all"), ("uncertainty", "all")),
    "uncertainty_replace": (("uncertainty", "all"),),
    "ground_then_uncertainty_replace": (("ground", "all"), ("uncertainty", "remaining")),
    "ground_then_uncertainty_add": (("support", "all"), ("ground", "all"), ("uncertainty", "all")),
    "uncertainty_then_ground": (("uncertainty", "all"), ("ground", "remaining")),
}


class Gates(NamedTuple):
    """Decisions of the gates on H hypotheses.

    Every candidate is in exactly one of the four masks, every other hypothesis in none.

    Attributes:
        keep: (H,) bool; passed every gate.
        uncertain: (H,) bool; removed by the uncertainty gate.
        off_ground: (H,) bool; removed by the ground gate.
        unsupported: (H,) bool; removed by the camera support gate.
        tau_sigma: () threshold of sigma in scene units, +inf if that gate did not run.
        tau_g: () threshold of g in scene units, +inf if that gate did not run.
        tau_support: () threshold of the weighted support, -inf if that gate did not run.
    """

    keep: Bool[Array, " h"]
    uncertain: Bool[Array, " h"]
    off_ground: Bool[Array, " h"]
    unsupported: Bool[Array, " h"]
    tau_sigma: Float[Array, ""]
    tau_g: Float[Array, ""]
    tau_support: Float[Array, ""]


def quantile(
    values: Num[HostOrDevice, " n"],
    share: float,
    where: Bool[HostOrDevice, " n"] | None = None,
) -> Float[Array, ""]:
    """Compute the quantile of a masked sample, linear between neighbors.

    Args:
        values: (n,) sample, any unit. Entries that are not finite are not part of it.
        share: in [0, 1]; 0.5 is the median.
        where: (n,) which entries are part of the sample; the others may hold anything.

    Returns:
        () in the unit of the values; +inf for an empty sample.
    """
    values = as_floating(values, "values")
    if values.shape[0] == 0:
        return jnp.asarray(jnp.inf, values.dtype)
    member = as_selection(where, values.shape) & jnp.isfinite(values)
    estimate = jnp.nanquantile(jnp.where(member, values, jnp.nan), jnp.asarray(share, values.dtype))
    return jnp.where(member.any(), estimate, jnp.inf)


def select(
    sigma: Num[HostOrDevice, " h"],
    ground_distance: Num[HostOrDevice, " h"],
    weighted_support: Num[HostOrDevice, " h"],
    candidate: Bool[HostOrDevice, " h"],
    *,
    gates: Selection = "uncertainty_then_ground",
    fixed_quantile: float | None = None,
) -> Gates:
    """Select the hypotheses that are well determined and stand on the ground.

    The gates on sigma and g accept values up to and including their threshold. The orders that
    "add" keep the camera support gate Q and compute each threshold from all candidates. The orders
    that "replace" drop Q and compute the second threshold from the survivors of the first gate.

    Args:
        sigma: (H,) ground uncertainty (Eq. sigma) in scene units; +inf (fewer than two cameras)
            is excluded from every estimate and fails the uncertainty gate.
        ground_distance: (H,) distance g to the ground in scene units, 0 or more.
        weighted_support: (H,) sum of the reliabilities w of the supporting rays, one per camera.
        candidate: (H,) bool; other rows may hold anything.
        gates: the order of the ablation (Table "gates"); the paper's method is
            "uncertainty_then_ground".
        fixed_quantile: replace log-Otsu by this quantile of the same sample.

    Returns:
        Masks and thresholds.

    Raises:
        InvalidInputError: if the quantile is outside [0, 1], or `gates` is unknown.

    Source: paper, Sec. "Selecting pedestrian positions".
    """
    if fixed_quantile is not None and not 0 <= as_number(fixed_quantile, "fixed_quantile") <= 1:
        raise InvalidInputError(f"fixed_quantile is {fixed_quantile}; it must be between 0 and 1.")
    if not isinstance(gates, str) or gates not in ORDERS:
        raise InvalidInputError(f"gates is {quoted(gates)}; it must be one of {', '.join(ORDERS)}.")
    sigma, ground_distance = (
        as_floating(sigma, "sigma"),
        as_floating(ground_distance, "ground_distance"),
    )
    weighted_support = as_floating(weighted_support, "weighted_support")
    candidate = as_mask(candidate, sigma.shape, "candidate")

    def threshold(values: Float[Array, " h"], where: Bool[Array, " h"]) -> Float[Array, ""]:
        if fixed_quantile is None:
            return log_otsu(values, where)
        return quantile(values, fixed_quantile, where)

    remaining = candidate
    uncertain = off_ground = unsupported = jnp.zeros_like(candidate)
    tau_sigma = tau_g = jnp.asarray(jnp.inf, sigma.dtype)
    tau_support = jnp.asarray(-jnp.inf, weighted_support.dtype)
    for gate, sample in ORDERS[gates]:
        estimated_on = candidate if sample == "all" else remaining
        match gate:
            case "support":
                tau_support = otsu(weighted_support, estimated_on)
                tau_support = jnp.where(jnp.isfinite(tau_support), tau_support, -jnp.inf)
                unsupported = remaining & ~(weighted_support >= tau_support)
                remaining = remaining & ~unsupported
            case "uncertainty":
                tau_sigma = threshold(sigma, estimated_on)
                uncertain = remaining & ~((sigma <= tau_sigma) & jnp.isfinite(sigma))
                remaining = remaining & ~uncertain
            case "ground":
                tau_g = threshold(ground_distance, estimated_on)
                off_ground = remaining & ~(ground_distance <= tau_g)
                remaining = remaining & ~off_ground
    return Gates(remaining, uncertain, off_ground, unsupported, tau_sigma, tau_g, tau_support)
