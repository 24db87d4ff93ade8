"""How much two boxes look alike, as a log-likelihood ratio learned from the sequence."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.evidence.association import Groups
from catfree.evidence.boxes import Boxes, padded_length
from catfree.settings import EvidenceSettings

SMALLEST_SAMPLE = 50  # pairs below which nothing is learned
SMALLEST_SPREAD = 0.01  # cosine distance


class Appearance(eqx.Module):
    """Cosine distances of all pairs of boxes of each frame.

    Attributes:
        distance: (F, D, D) cosine distance in [0, 2].
        slot: (N, 2) frame and position in `distance` of each box.
    """

    distance: Float[np.ndarray, "frame slot slot"]
    slot: Int[np.ndarray, "box 2"]


def compare_frames(boxes: Boxes) -> Appearance | None:
    """Distances of all pairs within each frame, or None without embeddings."""
    if boxes.embedding is None:
        return None
    F = len(boxes.frames)
    count = np.diff(boxes.first)
    D = padded_length(int(count.max(initial=1)), 8)
    n = int(boxes.first[-1])
    slot = np.zeros((len(boxes.frame), 2), np.int64)
    slot[:n, 0] = boxes.frame[:n]
    slot[:n, 1] = np.arange(n) - boxes.first[boxes.frame[:n]]
    block = np.zeros((F, D, boxes.embedding.shape[1]))
    block[slot[:n, 0], slot[:n, 1]] = boxes.embedding[:n]
    return Appearance(1 - block @ block.transpose(0, 2, 1), slot)


def learn_ratio(
    appearance: Appearance, groups: Groups, settings: EvidenceSettings
) -> np.ndarray | None:
    """(F, D, D) log-likelihood ratio 'same person' against 'another person of the frame'.

    Two Gaussians (median and MAD) of the distances within and between groups of at least three
    views, clipped; None where too little is known or distances do not tell people apart.
    """
    views = (groups.member >= 0).sum(1)
    label = np.full(appearance.distance.shape[:2], -1)
    camera = np.full(appearance.distance.shape[:2], -1)
    strong = np.flatnonzero(views >= 3)
    g, c = np.nonzero(groups.member[strong] >= 0)
    rows = groups.member[strong][g, c]
    label[appearance.slot[rows, 0], appearance.slot[rows, 1]] = strong[g]
    camera[appearance.slot[rows, 0], appearance.slot[rows, 1]] = c
    known = (label >= 0)[:, :, None] & (label >= 0)[:, None, :]
    known &= camera[:, :, None] < camera[:, None, :]
    same = known & (label[:, :, None] == label[:, None, :])
    other = known & ~same
    if same.sum() < SMALLEST_SAMPLE or other.sum() < SMALLEST_SAMPLE:
        return None
    (m1, s1), (m0, s0) = (_robust(appearance.distance[k]) for k in (same, other))
    if m1 >= m0:
        return None
    # Beyond its own centre a distance cannot speak for the other side.
    d = np.clip(appearance.distance, m1, m0)
    ratio = np.log(s0 / s1) - 0.5 * ((d - m1) / s1) ** 2 + 0.5 * ((d - m0) / s0) ** 2
    return np.clip(ratio, -settings.appearance_limit, settings.appearance_limit)


def group_agreement(ratio: np.ndarray, appearance: Appearance, member: np.ndarray) -> np.ndarray:
    """(H,) sum of the pairwise ratios within each group."""
    there = member >= 0
    rows = np.maximum(member, 0)
    frame = appearance.slot[rows, 0].max(1, initial=0, where=there)
    position = appearance.slot[rows, 1]
    C = member.shape[1]
    total = np.zeros(len(member))
    for a in range(C):
        for b in range(a + 1, C):
            both = there[:, a] & there[:, b]
            total[both] += ratio[frame[both], position[both, a], position[both, b]]
    return total


def _robust(values: np.ndarray) -> tuple[float, float]:
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return middle, max(spread, SMALLEST_SPREAD)
