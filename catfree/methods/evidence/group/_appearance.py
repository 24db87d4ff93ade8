"""Appearance similarity of boxes as a log-likelihood ratio learned from the sequence."""

from dataclasses import dataclass
from itertools import pairwise

import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.settings import EvidenceSettings

SMALLEST_SPREAD = 0.01  # cosine distance: narrower samples are copies
ENTRIES = 1 << 20  # of pairwise distances turned into ratios at a time
KEPT_ENTRIES = 1 << 26  # of pairwise ratios kept from pass to pass: 256 MB


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Appearance:
    """Embeddings of all boxes, and their rows in the pair table of their frame.

    Attributes:
        embedding: (N, D) of unit length, in single precision, which is sufficient.
        slot: (N, 2) frame and row in that frame's table of each box.
        first: (F + 1,) first box of each frame.
        width: rows of a table.
    """

    embedding: Float[np.ndarray, "box dim"]
    slot: Int[np.ndarray, "box 2"]
    first: Int[np.ndarray, " bounds"]
    width: int

    def distances(self, frames: Int[np.ndarray, " f"]) -> Float[np.ndarray, "f slot slot"]:
        """Cosine distances in [0, 2] of all pairs of boxes of some frames."""
        shape = (len(frames), self.width, self.embedding.shape[1])
        block = np.zeros(shape, self.embedding.dtype)
        for i, frame in enumerate(frames):
            rows = slice(self.first[frame], self.first[frame + 1])
            block[i, : rows.stop - rows.start] = self.embedding[rows]
        distance = block @ block.transpose(0, 2, 1)
        return np.subtract(1, distance, out=distance)


def compare_frames(boxes: Boxes) -> Appearance | None:
    """Arrange the embeddings by frame; None without embeddings."""
    if boxes.embedding is None:
        return None
    place = np.arange(len(boxes.frame)) - boxes.first[boxes.frame]
    slot = np.column_stack([boxes.frame, place])
    return Appearance(boxes.embedding, slot, boxes.first, int(np.diff(boxes.first).max(initial=1)))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Likeness:
    """Gaussians of the cosine distance between boxes of one person and of two people.

    Attributes:
        same: () mean and deviation for one person; `other`: for two people.
        limit: bound of the absolute log-likelihood ratio.
    """

    same: tuple[float, float]
    other: tuple[float, float]
    limit: float

    def __call__(self, distance: np.ndarray) -> np.ndarray:
        """Log-likelihood ratio 'same person' against 'another person of the frame'."""
        (m1, s1), (m0, s0) = self.same, self.other
        # Beyond a Gaussian's mean the ratio stays constant, so that it is monotonic.
        d = np.clip(distance, m1, m0)
        ratio = np.log(s0 / s1) - 0.5 * ((d - m1) / s1) ** 2 + 0.5 * ((d - m0) / s0) ** 2
        return np.clip(ratio, -self.limit, self.limit)


def learn_ratio(
    appearance: Appearance, groups: Groups, settings: EvidenceSettings
) -> Likeness | None:
    """Learn the log-likelihood ratio from groups with enough views.

    Fits Gaussians (median and MAD) to the distances within and between the groups of each frame.
    Returns None if there are too few pairs or if distances do not discriminate people.
    """
    strong = np.flatnonzero((groups.member >= 0).sum(1) >= settings.witnesses)
    g, camera = np.nonzero(groups.member[strong] >= 0)
    label = strong[g]
    looks = appearance.embedding[groups.member[strong][g, camera]]
    _, begins = np.unique(groups.frame[label], return_index=True)
    within, between = [], []
    for begin, end in pairwise([*begins, len(label)]):
        rows = slice(begin, end)
        once = camera[rows][:, None] < camera[rows]
        distance = 1 - looks[rows] @ looks[rows].T
        same = label[rows][:, None] == label[rows]
        within.append(distance[once & same])
        between.append(distance[once & ~same])
    samples = [np.concatenate(values or [np.zeros(0)]) for values in (within, between)]
    if min(map(len, samples)) < settings.fewest_pairs:
        return None
    one, two = (_robust(values) for values in samples)
    return Likeness(one, two, settings.appearance_limit) if one[0] < two[0] else None


class PairRatios:
    """Weighted log-likelihood ratios of all pairs of boxes, by runs of frames.

    All passes of the association use the same ratios, so they are cached unless the sequence is too
    long.
    """

    def __init__(self, appearance: Appearance, likeness: Likeness, weight: float) -> None:
        self.appearance, self.likeness, self.weight = appearance, likeness, weight
        self._keep = (len(appearance.first) - 1) * appearance.width**2 <= KEPT_ENTRIES
        self._kept: dict[tuple[int, int], np.ndarray] = {}

    def of_run(self, begin: int, end: int) -> Float[np.ndarray, "f slot slot"]:
        """Ratios of the frames from `begin` up to `end`."""
        if (begin, end) in self._kept:
            return self._kept[begin, end]
        ratios = self.appearance.distances(np.arange(begin, end))
        entries = ratios.reshape(-1)
        for first in range(0, len(entries), ENTRIES):
            part = entries[first : first + ENTRIES]
            part[:] = self.weight * self.likeness(part)
        if self._keep:
            self._kept[begin, end] = ratios
        return ratios


def group_agreement(
    likeness: Likeness, appearance: Appearance, member: np.ndarray
) -> Float[np.ndarray, " group"]:
    """(H,) sum of the pairwise log-likelihood ratios within each group."""
    C = member.shape[1]
    total = np.zeros(len(member))
    for a in range(C):
        for b in range(a + 1, C):
            both = np.flatnonzero((member[:, a] >= 0) & (member[:, b] >= 0))
            one, two = (appearance.embedding[member[both, camera]] for camera in (a, b))
            total[both] += likeness(1 - (one * two).sum(1))
    return total


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Looks:
    """Appearance of each group, to be compared with that of the tracks so far.

    The mean distance between two sets of boxes follows from the sums of their embeddings.

    Attributes:
        total: (H, D) sum of the embeddings of each group's boxes.
        count: (H,) number of boxes with an embedding.
        likeness: maps a distance to a log-likelihood ratio.
        weight: of one box.
    """

    total: Float[np.ndarray, "group dim"]
    count: Int[np.ndarray, " group"]
    likeness: Likeness
    weight: float

    def ratio(
        self,
        total: Float[np.ndarray, "track dim"],
        count: Int[np.ndarray, " track"],
        groups: Int[np.ndarray, " k"],
    ) -> Float[np.ndarray, "track k"]:
        """Log-likelihood ratio that a group is a track's person rather than somebody else.

        Each box of the group counts like a new box of a group.

        Args:
            total: (T, D) sum of the embeddings of each track's boxes.
            count: (T,) their number.
            groups: (K,) the groups to compare with.

        Returns:
            (T, K), zero where the track or the group has no embedding.
        """
        new = self.count[groups]
        return self.compare(total, count, self.total[groups], new, new.astype(float))

    def compare(
        self,
        total: Float[np.ndarray, "track dim"],
        count: Int[np.ndarray, " track"],
        other: Float[np.ndarray, "k dim"],
        others: Int[np.ndarray, " k"],
        new: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, "track k"]:
        """Log-likelihood ratio that two sets of boxes show one person rather than two.

        Args:
            total: (T, D) sum of the embeddings of the boxes of each set.
            count: (T,) their number.
            other: (K, D) the same of the sets to compare with.
            others: (K,) their number.
            new: (K,) for how many new boxes each of these counts.

        Returns:
            (T, K), zero where one of the two has no embedding.
        """
        one = total / np.maximum(count, 1)[:, None]
        two = other / np.maximum(others, 1)[:, None]
        known = (count > 0)[:, None] & (others > 0)[None]
        ratio = self.weight * new[None] * self.likeness(1 - one @ two.T)
        return np.where(known, ratio, 0.0)


def looks_of(ratios: PairRatios, member: Int[np.ndarray, "group cam"]) -> Looks:
    """Sum the embeddings of each group.

    Args:
        ratios: the embeddings, the likelihood ratio and its weight.
        member: (H, C) boxes of each group, -1 for none.
    """
    embedding = ratios.appearance.embedding
    has_embedding = np.asarray(embedding.any(axis=1))
    is_usable = (member >= 0) & has_embedding[np.maximum(member, 0)]
    total = np.zeros((len(member), embedding.shape[1]), embedding.dtype)
    for camera in range(member.shape[1]):
        rows = np.flatnonzero(is_usable[:, camera])
        total[rows] += embedding[member[rows, camera]]
    return Looks(total, is_usable.sum(1), ratios.likeness, ratios.weight)


def _robust(values: np.ndarray) -> tuple[float, float]:
    middle = float(np.median(values))
    spread = MEDIAN_TO_DEVIATION * float(np.median(np.abs(values - middle)))
    return middle, max(spread, SMALLEST_SPREAD)
