"""One position per person: greedy non-maximum suppression on the ground, and the area left free.

Source: paper, Sec. "Selecting pedestrian positions", duplicate removal and recovery.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num, ScalarLike

from catfree.errors import InvalidInputError
from catfree.filters._sample_arrays import as_floating, as_mask, as_radius, as_selection
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import require_shape


def suppress(
    positions: Num[HostOrDevice, "h 2"],
    priority: Num[HostOrDevice, " h"] | Num[HostOrDevice, "h rank"],
    radius: ScalarLike,
    where: Bool[HostOrDevice, " h"] | None = None,
) -> Bool[Array, " h"]:
    """Keep the strongest of the positions within a radius of each other (greedy NMS).

    In order of descending priority, a position is kept if it is farther than the radius from all
    positions kept before. Computed in parallel rounds: positions that no undecided neighbor beats
    are kept and their neighbors removed, until all are decided.

    Args:
        positions: (H, 2) on the ground, any unit.
        priority: (H,), or (H, k) where later columns break ties of earlier ones. The lower index
            wins remaining ties.
        radius: 0 or more, in the unit of the positions; a distance equal to it suppresses.
        where: (H,) which positions take part; the others may hold anything and are not kept.

    Returns:
        (H,) bool, which positions are kept.

    Raises:
        InvalidInputError: if the numbers of priorities and positions differ, positions do not have
            2 coordinates, the radius is negative or not a number, or `where` holds anything but
            true and false.

    Source: paper, Sec. "Selecting pedestrian positions", duplicate removal.
    """
    positions, priority = as_floating(positions, "positions"), as_floating(priority, "priority")
    count = positions.size // 2
    one_each = priority.ndim in (1, 2) and priority.shape[0] == count and priority.size >= count
    if positions.shape != (count, 2) or not one_each:
        raise InvalidInputError(
            "Suppression needs positions of shape (n, 2) with one priority each, got shapes "
            f"{positions.shape} and {priority.shape}."
        )
    if count == 0:
        return jnp.zeros(0, bool)
    present = as_selection(where, (count,))
    columns = priority[:, None] if priority.ndim == 1 else priority
    columns = jnp.where(present[:, None], -columns, jnp.inf)
    order = jnp.lexsort(tuple(columns.T[::-1]))  # stable: ties stay in index order
    near = _near(positions, radius, present, present)[order][:, order]
    beaten_by = near & (jnp.arange(count)[None, :] < jnp.arange(count)[:, None])
    return jnp.zeros(count, bool).at[order].set(_greedy(beaten_by, present[order]))


def outside(
    positions: Num[HostOrDevice, "h 2"],
    accepted: Bool[HostOrDevice, " h"],
    radius: ScalarLike,
    where: Bool[HostOrDevice, " h"] | None = None,
) -> Bool[Array, " h"]:
    """Find the positions farther than a radius from all accepted ones, for the recovery.

    Args:
        positions: (H, 2) on the ground, any unit.
        accepted: (H,) which positions are accepted.
        radius: 0 or more, in the unit of the positions.
        where: (H,) which positions to test; the others may hold anything unless accepted.

    Returns:
        (H,) bool; false where `where` is false, and for accepted positions.

    Raises:
        InvalidInputError: as `suppress`, or if `accepted` holds anything but true and false.

    Source: paper, Sec. "Selecting pedestrian positions", recovery.
    """
    positions = as_floating(positions, "positions")
    require_shape(positions, (None, 2), "positions")
    accepted = as_mask(accepted, positions.shape[:1], "accepted")
    tested = as_selection(where, accepted.shape) & ~accepted
    return tested & ~jnp.any(_near(positions, radius, tested, accepted), axis=1)


def _near(
    positions: Float[Array, "h 2"],
    radius: ScalarLike,
    row: Bool[Array, " h"],
    column: Bool[Array, " h"],
) -> Bool[Array, "h h"]:
    """Mark the pairs of positions, one of `row` and one of `column`, at most the radius apart."""
    x, y = jnp.where((row | column)[:, None], positions, 0).T
    distance = jnp.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
    return (distance <= as_radius(radius, x.dtype)) & row[:, None] & column[None, :]


@jax.jit  # compiled once per shape: outside jit, its loop would be compiled at every call
def _greedy(beaten_by: Bool[Array, "h h"], present: Bool[Array, " h"]) -> Bool[Array, " h"]:
    """Keep in rounds the positions that no undecided one beats, and remove those they beat."""

    def decide(
        state: tuple[Bool[Array, " h"], Bool[Array, " h"]],
    ) -> tuple[Bool[Array, " h"], Bool[Array, " h"]]:
        undecided, kept = state
        new = undecided & ~jnp.any(beaten_by & undecided[None, :], axis=1)
        removed = jnp.any(beaten_by & new[None, :], axis=1)
        return undecided & ~new & ~removed, kept | new

    start = (present, jnp.zeros_like(present))
    _, kept = jax.lax.while_loop(lambda state: jnp.any(state[0]), decide, start)
    return kept
