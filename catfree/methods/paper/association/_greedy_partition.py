"""The greedy cross-view partition: groups of rays that agree on one 3-D point.

Pairs are tried in a given order. A pair merges the groups of its two detections if the groups share
no camera and every ray of the merged group is close to the merged least-squares point. The decision
on a pair depends only on earlier pairs that touch one of its two groups. A pair that precedes all
other pending pairs of both its groups can therefore be decided at once. All such pairs of all
frames are decided together in rounds, with exactly the result of the sequential loop.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from catfree.geometry import angular_residual, triangulate_least_squares
from catfree.methods.paper.association._candidate_pairs import CandidatePairs
from catfree.methods.paper.association._on_ground import least_squares_on_ground
from catfree.types import Rays

WINDOW = 8192  # pairs processed together; later pairs wait, which cannot change the result
DECISIONS = 1024  # maximum number of merges tested in one round; the others wait for the next round


class _Groups(NamedTuple):
    """The partition so far; the last row means "no detection" and absorbs padding.

    Attributes:
        root: (N + 1,) the group of each detection, identified by one of its detections.
        members: (N + 1, C) detection of each camera in the group with that root, or -1.
        cameras: (N + 1, words) bit set of the cameras in that group.
    """

    root: Int[Array, " n"]
    members: Int[Array, "n cam"]
    cameras: UInt32[Array, "n words"]


def greedy_partition(
    rays: Rays,
    camera: Int[np.ndarray, " n"],
    pairs: CandidatePairs,
    *,
    camera_count: int,
    tolerance: float,
    constrain_to_ground: bool = False,
) -> Int[np.ndarray, "g cam"]:
    """Merge detections of different cameras into groups with at most one detection per camera.

    Args:
        rays: (N, ...) ray of each detection; weight 0 marks padding.
        camera: (N,) camera of each detection.
        pairs: candidate pairs in merging order, of any number of frames.
        camera_count: C.
        tolerance: largest angular residual of any ray of a merged group, radians.
        constrain_to_ground: restrict the common point to the ground z = 0 (ablation).

    Returns:
        (G, C) detection of each camera in each group of at least two, or -1; ordered by the first
        member.

    Source:
        Sec. "Matching pedestrians across cameras".
    """
    count = len(camera)
    groups = _singletons(camera, camera_count)
    for begin in range(0, len(pairs.first), WINDOW):
        rows = slice(begin, begin + WINDOW)
        padding = (0, WINDOW - len(pairs.first[rows]))
        groups = _merge_window(
            groups,
            rays.origin,
            rays.direction,
            rays.weight,
            np.pad(pairs.first[rows], padding, constant_values=count),
            np.pad(pairs.second[rows], padding, constant_values=count),
            np.pad(pairs.singletons_only[rows], padding),
            tolerance,
            constrained=constrain_to_ground,
        )
    root, members = np.asarray(groups.root)[:count], np.asarray(groups.members)[:count]
    names = np.flatnonzero((root == np.arange(count)) & ((members >= 0).sum(1) >= 2))
    return members[names].astype(np.int64)


def _singletons(camera: Int[np.ndarray, " n"], camera_count: int) -> _Groups:
    count = len(camera)
    index = np.arange(count)
    members = np.full((count + 1, camera_count), -1, np.int32)
    members[index, camera] = index
    words = np.zeros((count + 1, -(-camera_count // 32)), np.uint32)
    words[index, camera // 32] = np.left_shift(np.uint32(1), (camera % 32).astype(np.uint32))
    return _Groups(jnp.arange(count + 1, dtype=jnp.int32), jnp.asarray(members), jnp.asarray(words))


@partial(jax.jit, donate_argnums=0, static_argnames="constrained")
def _merge_window(
    groups: _Groups,
    origins: Float[Array, "n 3"],
    directions: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    first: Int[Array, " p"],
    second: Int[Array, " p"],
    singletons_only: Bool[Array, " p"],
    tolerance: Float[Array, ""] | float,
    *,
    constrained: bool,
) -> _Groups:
    nothing = groups.root.shape[0] - 1
    rank = jnp.arange(first.shape[0], dtype=jnp.int32)

    def still_possible(groups: _Groups, pending: Bool[Array, " p"]) -> Bool[Array, " p"]:
        # Groups only grow: two groups that share a camera, or are the same, can never merge.
        one = groups.cameras[groups.root[first]]
        other = groups.cameras[groups.root[second]]
        disjoint = ~jnp.any((one & other) != 0, axis=-1)
        size = jax.lax.population_count(one).sum(-1) + jax.lax.population_count(other).sum(-1)
        return pending & disjoint & (~singletons_only | (size == 2))

    def decide(state: tuple[_Groups, Bool[Array, " p"]]) -> tuple[_Groups, Bool[Array, " p"]]:
        groups, pending = state
        one, other = groups.root[first], groups.root[second]
        turn = jnp.where(pending, rank, rank.shape[0])
        earliest = jnp.full(nothing + 1, rank.shape[0], jnp.int32)
        earliest = earliest.at[one].min(turn).at[other].min(turn)
        leading = pending & (earliest[one] == rank) & (earliest[other] == rank)
        (chosen,) = jnp.nonzero(leading, size=DECISIONS, fill_value=rank.shape[0])
        one = one.at[chosen].get(mode="fill", fill_value=nothing)
        other = other.at[chosen].get(mode="fill", fill_value=nothing)
        merged = jnp.where(groups.members[one] >= 0, groups.members[one], groups.members[other])
        present = merged >= 0
        agrees = jax.vmap(partial(_agree, constrained=constrained), (0, 0, 0, None))(
            origins[merged],
            directions[merged],
            jnp.where(present, weights[merged], 0),
            tolerance,
        )
        keep = jnp.where(agrees, jnp.minimum(one, other), nothing + 1)
        union = groups.cameras[one] | groups.cameras[other]
        moved = jnp.where(present & agrees[:, None], merged, nothing + 1)
        groups = _Groups(
            groups.root.at[moved].set(jnp.broadcast_to(keep[:, None], moved.shape), mode="drop"),
            groups.members.at[keep].set(merged, mode="drop"),
            groups.cameras.at[keep].set(union, mode="drop"),
        )
        pending = pending.at[chosen].set(False, mode="drop")
        return groups, still_possible(groups, pending)

    real = first < nothing
    state = (groups, still_possible(groups, real))
    return jax.lax.while_loop(lambda state: jnp.any(state[1]), decide, state)[0]


def _agree(
    origins: Float[Array, "cam 3"],
    directions: Float[Array, "cam 3"],
    weights: Float[Array, " cam"],
    tolerance: Float[Array, ""] | float,
    *,
    constrained: bool,
) -> Bool[Array, ""]:
    """Return whether all present rays pass their least-squares point within the tolerance."""
    solve = least_squares_on_ground if constrained else triangulate_least_squares
    position = solve(origins, directions, weights)
    residual = jax.vmap(angular_residual, (None, 0, 0))(position, origins, directions)
    return jnp.all((residual <= tolerance) | (weights == 0)) & jnp.any(weights > 0)
