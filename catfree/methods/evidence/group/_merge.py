"""Greedy merging of boxes into people by the gain in log evidence.

All frames are merged together in rounds. Each round merges every pair of groups that are each
other's best partner. A gain depends only on the two groups, so the result is exactly that of
merging one best pair at a time.
"""

from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from catfree.geometry._buckets import coarse_length, fine_length
from catfree.methods.evidence._gaussian import Information, log_evidence
from catfree.methods.evidence.group._groups import Groups, Priors, collect_groups, prior_information

PAIR_BLOCK = 2**11  # pairs computed at a time: fits a cache
FEWEST_PAIRS = 2**14  # to pad to: padding takes less time than another compilation
BITS = 31  # cameras per word, with or without 64-bit integers
PAIRS_AT_A_TIME = 1 << 18  # neighbors processed together: fits a cache


def candidate_pairs(
    position: np.ndarray,
    covariance: np.ndarray,
    frame: np.ndarray,
    camera: np.ndarray,
    items: np.ndarray,
    gate: float,
) -> np.ndarray:
    """Find pairs of items of one frame and different cameras within the gate.

    Args:
        position: (N, 2) in H0.
        covariance: (N, 2, 2).
        frame: (N,) frame index.
        camera: (N,) camera index.
        items: (n,) the rows to pair.
        gate: largest squared Mahalanobis distance.

    Returns:
        (P, 2) rows, the lower first, sorted.
    """
    if len(items) < 2:
        return np.zeros((0, 2), np.int64)
    xx, xy, yy = (covariance[items, k, m] for k, m in ((0, 0), (0, 1), (1, 1)))
    widest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)  # variance along the longest axis
    order = np.argsort(
        widest, kind="stable"
    )  # each pair is found once, from its less certain member
    items, xx, xy, yy, widest = (values[order] for values in (items, xx, xy, yy, widest))
    (x, y), instant, view = position[items].T, frame[items], camera[items]
    reach = np.sqrt(2 * gate * widest)
    far = 4 * (np.abs(position[items]).max() + reach[-1]) + 1  # separates frames
    place = np.column_stack([x, y, instant * far])
    tree = KDTree(place)
    found = []
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
        i, j, dx, dy, a, c = (values[keep] for values in (i, j, dx, dy, a, c))
        b = xy[i] + xy[j]
        m2 = (c * dx**2 - 2 * b * dx * dy + a * dy**2) / (a * c - b**2)
        close = m2 < gate
        found.append((items[i[close]], items[j[close]]))
    one, two = (np.concatenate(side) for side in zip(*found, strict=True))
    total = int(items.max()) + 1
    return np.column_stack(
        np.divmod(np.sort(np.minimum(one, two) * total + np.maximum(one, two)), total)
    )


def _searches(reach: np.ndarray, crowd: int) -> list[tuple[int, int]]:
    """Runs of items, as (first, end), whose neighbors are searched together.

    Their reaches differ by less than a factor of two, and all their neighbors fit into memory.

    Args:
        reach: (n,) search radius of each item, ascending.
        crowd: items of the fullest instant, an upper bound on the neighbors of one item.
    """
    octaves = np.flatnonzero(np.diff(np.ceil(np.log2(reach / reach[0])))) + 1
    step = max(PAIRS_AT_A_TIME // crowd, 1)
    return [
        (first, min(first + step, end))
        for begin, end in pairwise([0, *octaves.tolist(), len(reach)])
        for first in range(begin, end, step)
    ]


@partial(jax.jit, static_argnames=("appearance",))
def merge_groups(
    info, camera, pairs, count, members, looks, slot, density, spread, appearance: bool
):
    """Merge while any pair gains.

    Args:
        info: (N) information of each item.
        camera: (N,) camera of each item (C for a track prior); a group has each at most once.
        pairs: (P, 2) candidate pairs, padded with (0, 0) to a multiple of `PAIR_BLOCK`.
        count: of the pairs without padding; blocks of nothing but padding cost nothing.
        members: (N, C) the item's own index at its camera, -1 elsewhere.
        looks: (F, D, D) weighted appearance log-likelihood ratios, or (1, 1, 1).
        slot: (N, 2) frame and position in `looks` of each item.
        density: people per H0².
        spread: of heights in H0.
        appearance: whether to use `looks`.

    Returns:
        (N,) the row that represents each item's group.
    """
    N = camera.shape[0]
    item_evidence = log_evidence(info, density, spread)
    rows = jnp.arange(N)
    blocks = (count + PAIR_BLOCK - 1) // PAIR_BLOCK

    def roots(root, block):
        pair = root[jax.lax.dynamic_slice_in_dim(pairs, block * PAIR_BLOCK, PAIR_BLOCK)]
        return pair.min(1), pair.max(1)

    def gains(a, b, matrix, vector, constant, evidence, mask, members):
        joint = Information(matrix[a] + matrix[b], vector[a] + vector[b], constant[a] + constant[b])
        gain = log_evidence(joint, density, spread) - evidence[a] - evidence[b]
        if appearance:
            left, right = members[a], members[b]
            where = (left[:, :, None] >= 0) & (right[:, None, :] >= 0)
            at = slot[jnp.maximum(left, 0), 1][:, :, None]
            other = slot[jnp.maximum(right, 0), 1][:, None, :]
            ratio = looks[slot[a, 0][:, None, None], at, other].astype(gain.dtype)
            gain = gain + jnp.where(where, ratio, 0.0).sum((1, 2))
        allowed = (a != b) & ((mask[a] & mask[b]) == 0).all(-1)
        return jnp.where(allowed & (gain > 0), gain, -jnp.inf)

    def step(carry):
        root, *groups, _ = carry
        matrix, vector, constant, evidence, mask, members = groups

        def find_best(block, carry):
            gain, best = carry
            a, b = roots(root, block)
            here = gains(a, b, *groups)
            gain = jax.lax.dynamic_update_slice_in_dim(gain, here, block * PAIR_BLOCK, 0)
            return gain, best.at[a].max(here).at[b].max(here)

        def find_partner(block, partner):
            a, b = roots(root, block)
            here = jax.lax.dynamic_slice_in_dim(gain, block * PAIR_BLOCK, PAIR_BLOCK)
            hopeful = jnp.isfinite(here)
            return (
                partner
                .at[a].min(jnp.where(hopeful & (here == best[a]), b, N))
                .at[b].min(jnp.where(hopeful & (here == best[b]), a, N))
            )  # fmt: skip

        no_gain = [jnp.full(n, -jnp.inf, evidence.dtype) for n in (len(pairs), N)]
        gain, best = jax.lax.fori_loop(0, blocks, find_best, tuple(no_gain))
        partner = jax.lax.fori_loop(0, blocks, find_partner, jnp.full(N, N))
        safe = jnp.minimum(partner, N - 1)
        mutual = (partner < N) & (partner[safe] == rows)
        absorbs = mutual & (rows < partner)
        absorbed = mutual & (rows > partner)
        target = jnp.where(absorbed, safe, rows)
        add = lambda x: jnp.where(  # noqa: E731
            absorbs.reshape(-1, *(1,) * (x.ndim - 1)), x + x[safe], x
        )
        matrix, vector, constant = add(matrix), add(vector), add(constant)
        mask = jnp.where(absorbs[:, None], mask | mask[safe], mask)
        members = jnp.where(absorbs[:, None], jnp.maximum(members, members[safe]), members)
        evidence = jnp.where(
            absorbs, log_evidence(Information(matrix, vector, constant), density, spread), evidence
        )
        return target[root], matrix, vector, constant, evidence, mask, members, mutual.any()

    # One bit per camera and one for track priors, in as many words as needed.
    words = members.shape[1] // BITS + 1
    bits = jnp.left_shift(1, camera % BITS)[:, None]
    mask = jnp.where(camera[:, None] // BITS == jnp.arange(words)[None], bits, 0)
    start = (
        rows, info.matrix, info.vector, info.constant, item_evidence, mask, members,
        jnp.array(True),
    )  # fmt: skip
    return jax.lax.while_loop(lambda carry: carry[-1], step, start)[0]


def associate(
    info: Information,
    position: np.ndarray,
    covariance: np.ndarray,
    frame: np.ndarray,
    camera: np.ndarray,
    valid: np.ndarray,
    cameras: int,
    density: float,
    spread: float,
    gate: float,
    looks: np.ndarray | None = None,
    slot: np.ndarray | None = None,
    priors: Priors | None = None,
) -> Groups:
    """Group the boxes of every frame into people.

    Args:
        info: (N) likelihoods of the boxes.
        position: (N, 2) estimate from each box alone, in H0.
        covariance: (N, 2, 2) of the position.
        frame: (N,) frame index.
        camera: (N,) camera index.
        valid: (N,) which boxes to group.
        cameras: C.
        density: people per H0².
        spread: of heights in H0.
        gate: largest squared Mahalanobis distance of two boxes that may start or join a group.
        looks: (F, D, D) weighted appearance log-likelihood ratios, or None.
        slot: (N, 2) frame and place in `looks` of each box.
        priors: predictions of the tracks.

    Returns:
        One group per person, including single boxes, sorted by frame and first member.
    """
    if priors is not None and len(priors.frame):
        # Use existing padding for the priors first.
        begin = int(np.flatnonzero(valid).max(initial=-1)) + 1
        count = begin + len(priors.frame)
        length = max(len(frame), fine_length(count))
        extend = partial(_extend, begin=begin, length=length)
        info = jax.tree.map(extend, info, prior_information(priors, density, spread))
        position = extend(position, priors.mean[:, :2])
        covariance = extend(covariance, priors.covariance[:, :2, :2])
        camera = extend(camera, np.full(len(priors.frame), cameras))
        frame = extend(frame, priors.frame)
        valid = extend(valid, np.ones(len(priors.frame), bool))
        if slot is not None:
            slot = extend(slot, np.zeros((len(priors.frame), 2), np.int64))
    total = len(frame)
    items = np.flatnonzero(valid)
    pairs = candidate_pairs(position, covariance, frame, camera, items, gate)
    padded = np.zeros((coarse_length(len(pairs), FEWEST_PAIRS, 8), 2), np.int64)
    padded[: len(pairs)] = pairs
    members = np.full((total, cameras), -1)
    boxes = items[camera[items] < cameras]
    members[boxes, camera[boxes]] = boxes
    use = looks is not None
    root = merge_groups(
        info, camera, padded, np.asarray(len(pairs)), members,
        looks if use else np.zeros((1, 1, 1)), slot if use else np.zeros((total, 2), np.int64),
        np.asarray(density), np.asarray(spread), appearance=use,
    )  # fmt: skip
    root = np.asarray(root)
    return collect_groups(root, items, info, frame, camera, cameras, density, spread)


def _extend(values: Any, more: Any, *, begin: int, length: int) -> np.ndarray:
    """Rows up to `begin`, followed by more rows and zero padding."""
    host = np.asarray(values)
    out = np.zeros((length, *host.shape[1:]), host.dtype)
    out[:begin], out[begin : begin + len(more)] = host[:begin], more
    return out
