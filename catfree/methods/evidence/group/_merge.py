"""Greedy merging of boxes into people by the gain in log evidence.

The frames of a run are merged together in rounds. Each round merges every pair of groups that are
each other's best partner. Because a gain depends only on the two groups, the result is exactly that
of merging the best pair one at a time, and only pairs with a changed group are weighed again.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from catfree.methods.evidence._gaussian import Information, log_evidence, with_height_prior
from catfree.methods.evidence.group._groups import Groups, Priors

# Log-likelihood ratio of the looks of pairs of boxes, given by row.
PairRatio = Callable[[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]], np.ndarray]

PAIR_BLOCK = 2**11  # pairs computed at a time; fits a cache
PAIRS_AT_A_TIME = 1 << 18  # neighbors processed together; fits a cache


def close_pairs(
    position: Float[np.ndarray, "item 2"],
    covariance: Float[np.ndarray, "item 2 2"],
    frame: Int[np.ndarray, " item"],
    camera: Int[np.ndarray, " item"],
    gate: float,
) -> Int[np.ndarray, "pair 2"]:
    """Find pairs of items within the gate, in the same frame but different cameras.

    Args:
        position: (N, 2) in H0.
        covariance: (N, 2, 2).
        frame: (N,) frame index.
        camera: (N,) camera index.
        gate: largest squared Mahalanobis distance.

    Returns:
        (P, 2) rows, the lower first, sorted.
    """
    total = len(frame)
    if total < 2:
        return np.zeros((0, 2), np.int64)
    xx, xy, yy = (covariance[:, k, m] for k, m in ((0, 0), (0, 1), (1, 1)))
    widest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)  # variance along the longest axis
    # Find each pair once, from its less certain member.
    order = np.argsort(widest, kind="stable")
    xx, xy, yy, widest = (values[order] for values in (xx, xy, yy, widest))
    (x, y), instant, view = position[order].T, frame[order], camera[order]
    reach = np.sqrt(2 * gate * widest)
    far = 4 * (np.abs(position).max() + reach[-1]) + 1  # keeps frames apart
    place = np.column_stack([x, y, instant * far])
    tree = KDTree(place)
    pairs = []
    for begin, end in _searches(reach, int(np.unique(instant, return_counts=True)[1].max())):
        near = KDTree(place[begin:end]).sparse_distance_matrix(
            tree, reach[end - 1], output_type="ndarray"
        )
        i, j, apart = near["i"] + begin, near["j"], near["v"]
        # Bounds on the squared distance, from cheap to exact.
        keep = np.flatnonzero(j < i)
        i, j, apart = i[keep], j[keep], apart[keep]
        keep = np.flatnonzero((apart**2 <= gate * (widest[i] + widest[j])) & (view[i] != view[j]))
        i, j = i[keep], j[keep]
        dx, dy, a, c = x[i] - x[j], y[i] - y[j], xx[i] + xx[j], yy[i] + yy[j]
        keep = np.flatnonzero((dx**2 <= gate * a) & (dy**2 <= gate * c))
        i, j = i[keep], j[keep]
        dx, dy, a, c = (values[keep] for values in (dx, dy, a, c))
        b = xy[i] + xy[j]
        m2 = (c * dx**2 - 2 * b * dx * dy + a * dy**2) / (a * c - b**2)
        close = m2 < gate
        pairs.append((order[i[close]], order[j[close]]))
    one, two = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return np.column_stack(
        np.divmod(np.sort(np.minimum(one, two) * total + np.maximum(one, two)), total)
    )


def _searches(reach: Float[np.ndarray, " n"], crowd: int) -> list[tuple[int, int]]:
    """Runs of items, as (first, end), whose neighbors are searched together.

    Within a run, search radii differ by less than a factor of two, and all neighbors fit into
    memory.

    Args:
        reach: (n,) search radius of each item, ascending.
        crowd: number of items in the fullest instant, an upper bound on the neighbors of one item.
    """
    octaves = np.flatnonzero(np.diff(np.ceil(np.log2(reach / reach[0])))) + 1
    step = max(PAIRS_AT_A_TIME // crowd, 1)
    return [
        (first, min(first + step, end))
        for begin, end in pairwise([0, *octaves.tolist(), len(reach)])
        for first in range(begin, end, step)
    ]


def merge_groups(
    info: Information,
    camera: Int[np.ndarray, " item"],
    cameras: int,
    pairs: Int[np.ndarray, "pair 2"],
    density: float,
    spread: float,
    ratio: PairRatio | None = None,
) -> Int[np.ndarray, "item cam"]:
    """Merge pairs of groups until no merge gains evidence.

    Args:
        info: (N) information of each item.
        camera: (N,) camera of each item (C for a track prior); a group has each at most once.
        cameras: C.
        pairs: (P, 2) rows of candidate pairs.
        density: people per H0².
        spread: standard deviation of heights in H0.
        ratio: appearance ratio of pairs of boxes, which precede the priors; None to ignore
            appearance.

    Returns:
        (N, C) boxes of each group, in the row of its first item; -1 elsewhere.
    """
    count = len(camera)
    info = jax.tree.map(np.array, info)  # a copy, which becomes the sums of the groups
    member = np.where(camera[:, None] == np.arange(cameras + 1), np.arange(count)[:, None], -1)
    evidence, items = np.zeros(count), _distinct(pairs.ravel())
    evidence[items] = log_evidence(info[items], density, spread)

    def gain_of(one: Int[np.ndarray, " pair"], two: Int[np.ndarray, " pair"]) -> np.ndarray:
        joint = jax.tree.map(np.add, info[one], info[two])
        gain = log_evidence(joint, density, spread) - evidence[one] - evidence[two]
        if ratio is not None:
            left, right = member[one, :cameras], member[two, :cameras]
            pair, of, to = np.nonzero((left >= 0)[:, :, None] & (right >= 0)[:, None, :])
            gain += np.bincount(pair, ratio(left[pair, of], right[pair, to]), len(one))
        return np.where((gain > 0) & np.isfinite(gain), gain, 0.0)

    one, two, gain = (np.zeros(0, kind) for kind in (int, int, float))
    added = pairs.T
    while True:
        blocks = range(0, added.shape[1], PAIR_BLOCK)
        gained = [gain_of(*added[:, block : block + PAIR_BLOCK]) for block in blocks]
        gain = np.concatenate([gain, *gained])
        one, two = (np.concatenate(rows) for rows in zip((one, two), added, strict=True))
        kept, absorbed = _mutually_best(one, two, gain, count)
        if not len(kept):
            return member[:, :cameras]
        for part in (info.matrix, info.vector, info.constant):
            part[kept] += part[absorbed]
        evidence[kept] = log_evidence(info[kept], density, spread)
        member[kept] = np.maximum(member[kept], member[absorbed])
        member[absorbed] = -1
        target, changed = np.arange(count), np.zeros(count, bool)
        target[absorbed], changed[kept], changed[absorbed] = kept, True, True
        # Only the gains of pairs with a changed group differ from before.
        again = changed[one] | changed[two]
        ends = np.sort(target[np.stack([one[again], two[again]])], axis=0)
        added = np.stack(np.divmod(_distinct(ends[0] * count + ends[1]), count))
        both = (member[added[0]] >= 0) & (member[added[1]] >= 0)
        added = added[:, ~both.any(1)]
        one, two, gain = one[~again], two[~again], gain[~again]


def _distinct(rows: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """The distinct rows, ascending; faster than `numpy.unique`, which hashes."""
    ordered = np.sort(rows)
    return ordered[np.diff(ordered, prepend=-1) > 0]


def _mutually_best(
    one: Int[np.ndarray, " pair"],
    two: Int[np.ndarray, " pair"],
    gain: Float[np.ndarray, " pair"],
    count: int,
) -> tuple[Int[np.ndarray, " merge"], Int[np.ndarray, " merge"]]:
    """Find the pairs of groups that gain most from each other, lower row first."""
    best, partner = np.zeros(count), np.full(count, count)
    np.maximum.at(best, one, gain)
    np.maximum.at(best, two, gain)
    for group, other in ((one, two), (two, one)):
        at = np.flatnonzero((gain > 0) & (gain == best[group]))
        np.minimum.at(partner, group[at], other[at])
    kept = np.flatnonzero(partner < count)
    kept = kept[(kept < partner[kept]) & (partner[partner[kept]] == kept)]
    return kept, partner[kept]


def merge_boxes(
    info: Information,
    frame: Int[np.ndarray, " box"],
    camera: Int[np.ndarray, " box"],
    valid: Bool[np.ndarray, " box"],
    cameras: int,
    density: float,
    spread: float,
    gate: float,
    ratio: PairRatio | None = None,
    priors: Priors | None = None,
) -> Groups:
    """Group the boxes of every frame into people.

    Args:
        info: (N) likelihoods of the boxes.
        frame: (N,) frame index.
        camera: (N,) camera index.
        valid: (N,) which boxes to group.
        cameras: C.
        density: people per H0².
        spread: standard deviation of heights in H0.
        gate: largest squared Mahalanobis distance of two boxes that may start or join a group.
        ratio: appearance ratio of pairs of boxes; None to ignore appearance.
        priors: predictions of the tracks.

    Returns:
        One group per person, including single boxes, sorted by frame and first member.
    """
    if priors is not None and len(priors.frame):
        count = len(priors.frame)
        info, frame = _joined(info, priors.info), _joined(frame, priors.frame)
        camera = _joined(camera, np.full(count, cameras))
        valid = _joined(valid, np.ones(count, bool))
    items = np.flatnonzero(valid)
    matrix, vector, _ = with_height_prior(info[items], spread)
    covariance = np.linalg.inv(matrix)  # accurate even for a vague prior
    position = np.einsum("nij,nj->ni", covariance[:, :2], vector)
    near = close_pairs(position, covariance[:, :2, :2], frame[items], camera[items], gate)
    member = merge_groups(info, camera, cameras, items[near], density, spread, ratio)
    heads = items[(member[items] >= 0).any(1)]
    member = member[heads]
    together, apart = info.summed(member), np.zeros(member.shape)
    apart[member >= 0] = log_evidence(info[member[member >= 0]], density, spread)
    gain = log_evidence(together, density, spread) - apart.sum(1)
    return Groups(frame[heads], member, together, gain)


def _joined(values: Any, more: Any) -> Any:
    """Concatenate rows."""
    return jax.tree.map(lambda *parts: np.concatenate(parts), values, more)
