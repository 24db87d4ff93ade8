"""Appearance similarity of boxes as a log-likelihood ratio learned from the sequence."""

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, Real

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._embeddings import BLOCK, Embeddings
from catfree.settings import EvidenceSettings

SMALLEST_SPREAD = 0.01  # cosine distance; samples with less spread are copies
NUMBERS_AT_A_TIME = 1 << 18  # of embeddings compared together; fits a cache


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Likeness:
    """Gaussian models of the cosine distance between boxes of one person and of two people.

    Attributes:
        same: () mean and deviation for one person; `other`: for two people.
        limit: bound on the absolute log-likelihood ratio, before weighting.
        weight: discount of the ratio.
    """

    same: tuple[float, float]
    other: tuple[float, float]
    limit: float
    weight: float

    def __call__(self, distance: np.ndarray) -> np.ndarray:
        """Weighted log-likelihood ratio of 'same person' against 'another person in the frame'."""
        (m1, s1), (m0, s0) = self.same, self.other
        # Beyond the mean of either Gaussian the ratio is held constant, so that it is monotonic.
        d = np.clip(distance, m1, m0)
        ratio = np.log(s0 / s1) - 0.5 * ((d - m1) / s1) ** 2 + 0.5 * ((d - m0) / s0) ** 2
        return self.weight * np.clip(ratio, -self.limit, self.limit)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PairRatios:
    """Log-likelihood ratios of pairs of boxes.

    Attributes:
        embedding: embeddings of the boxes.
        likeness: maps a distance to a log-likelihood ratio.
    """

    embedding: Embeddings
    likeness: Likeness

    def __call__(
        self, one: Int[np.ndarray, " pair"], two: Int[np.ndarray, " pair"]
    ) -> Float[np.ndarray, " pair"]:
        """Ratios of pairs of boxes, given by row; 0 where either has no embedding."""
        cosine = np.empty(len(one), np.float32)
        step = max(NUMBERS_AT_A_TIME // self.embedding.dim, 1)
        for begin in range(0, len(one), step):
            pairs = slice(begin, begin + step)
            left, right = self.embedding[one[pairs]], self.embedding[two[pairs]]
            np.einsum("nd,nd->n", left, right, out=cosine[pairs])
        known = self.embedding.exists(one) & self.embedding.exists(two)
        return np.where(known, self.likeness(1 - cosine), 0.0)

    def of_boxes(self, rows: slice) -> "PairRatios":
        """Those of some boxes alone, which are counted from the first of them."""
        return replace(self, embedding=self.embedding.of_boxes(rows))


def learn_ratios(boxes: Boxes, groups: Groups, settings: EvidenceSettings) -> PairRatios | None:
    """Learn the likelihood ratio of embeddings from groups with enough views.

    Fits Gaussians (median and MAD) to the distances within and between the groups of each frame.
    Returns None if there are no embeddings or too few pairs, or if distances do not discriminate
    people.
    """
    if boxes.embedding is None:
        return None
    strong = np.flatnonzero((groups.member >= 0).sum(1) >= settings.witnesses)
    _, begins = np.unique(groups.frame[strong], return_index=True)
    within, between = [], []
    for begin, end in pairwise([*begins, len(strong)]):
        member = groups.member[strong[begin:end]]
        looks, known = boxes.embedding[member], (member >= 0) & boxes.embedding.exists(member)
        # Multiply few rows at a time: BLAS splits larger products among threads that wait for each
        # other.
        for one, two in combinations(range(member.shape[1]), 2):
            left, right = (np.flatnonzero(known[:, camera]) for camera in (one, two))
            distance = 1 - looks[left, one] @ looks[right, two].T
            same = left[:, None] == right
            within.append(distance[same])
            between.append(distance[~same])
    samples = [np.concatenate(values or [np.zeros(0)]) for values in (within, between)]
    if min(map(len, samples)) < settings.fewest_pairs:
        return None
    one, two = (_robust(values) for values in samples)
    if one[0] >= two[0]:
        return None
    likeness = Likeness(one, two, settings.appearance_limit, settings.appearance_weight)
    return PairRatios(boxes.embedding, likeness)


def appearance_log_odds(groups: Groups, ratios: PairRatios | None) -> Float[np.ndarray, " group"]:
    """Appearance log-odds of each group of k boxes: the mean pairwise ratio times k - 1.

    Boxes without an embedding do not count.
    """
    total = np.zeros(len(groups))
    if ratios is None:
        return total
    for one, two in combinations(groups.member.T, 2):
        both = np.flatnonzero((one >= 0) & (two >= 0))
        total[both] += ratios(one[both], two[both])
    known = (groups.member >= 0) & ratios.embedding.exists(groups.member)
    return 2 * total / np.maximum(known.sum(1), 1)


class Looks(NamedTuple):
    """Summed embeddings of sets of boxes, from which mean distances between sets follow.

    Attributes:
        total: (N, D) sum of the embeddings of each set; D is 0 if embeddings are uninformative.
        boxes: (N,) number of boxes with an embedding.
    """

    total: Float[np.ndarray, "n dim"]
    boxes: Int[np.ndarray, " n"]

    @property
    def dim(self) -> int:
        """Numbers per embedding."""
        return self.total.shape[1]

    def at(self, rows) -> "Looks":
        """Some of the sets."""
        return Looks(self.total[rows], self.boxes[rows])


class GroupLooks(NamedTuple):
    """Looks of groups, summed on demand because those of all groups would fill memory.

    Attributes:
        embedding: embeddings of the boxes.
        member: (H, C) boxes of each group, -1 for none.
    """

    embedding: Embeddings
    member: Int[np.ndarray, "group cam"]

    @property
    def dim(self) -> int:
        """Numbers per embedding."""
        return self.embedding.dim

    def at(self, rows) -> Looks:
        """Those of some groups."""
        member = self.member[rows]
        is_usable = (member >= 0) & self.embedding.exists(member)
        total = np.zeros((len(member), self.dim), np.float32)
        for begin in range(0, len(member), BLOCK):
            some = slice(begin, begin + BLOCK)
            row, camera = np.nonzero(is_usable[some])
            first = np.flatnonzero(np.diff(row, prepend=-1))
            if len(row):
                looks = self.embedding[member[some][row, camera]]
                total[some][row[first]] = np.add.reduceat(looks, first, axis=0)
        return Looks(total, is_usable.sum(1))


def compare_looks(
    one: Looks, two: Looks, new: Real[np.ndarray, " k"], likeness: Likeness | None
) -> Float[np.ndarray, "track k"]:
    """Log-likelihood ratio that two sets of boxes show one person rather than two.

    Args:
        one: looks of T sets.
        two: looks of K sets.
        new: (K,) number of new boxes that each of the K sets counts as.
        likeness: maps a distance to the ratio of one box; None if looks are uninformative.

    Returns:
        (T, K), zero where either has no embedding.
    """
    if likeness is None:
        return np.zeros((len(one.boxes), len(two.boxes)))
    mean, other = (sets.total / np.maximum(sets.boxes, 1)[:, None] for sets in (one, two))
    known = (one.boxes > 0)[:, None] & (two.boxes > 0)[None]
    return np.where(known, new * likeness(1 - mean @ other.T), 0.0)


def no_looks(sets: int, dim: int = 0) -> Looks:
    """Looks of sets without embeddings, with room for `dim` numbers each."""
    return Looks(np.zeros((sets, dim)), np.zeros(sets, np.int64))


def _robust(values: np.ndarray) -> tuple[float, float]:
    middle = float(np.median(values))
    spread = MEDIAN_TO_DEVIATION * float(np.median(np.abs(values - middle)))
    return middle, max(spread, SMALLEST_SPREAD)
