"""Higher order tracking accuracy (HOTA) on the ground."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from catfree.evaluation._pooling import pool
from catfree.evaluation._rows import Frames, Number, Sequence, read_sequence
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_positive

# Same expression as the reference evaluator: similarities on a grid fall exactly on these values,
# and any other expression differs in the last bit.
ALPHAS = np.arange(0.05, 0.99, 0.05)
_EPSILON = np.finfo(np.float64).eps

PerAlpha = Float[np.ndarray, " alpha"]


@dataclass(frozen=True, eq=False)
class HotaMetrics:
    """HOTA and its parts in percent, from sums at each localization threshold alpha.

    The short names (`hota`, `deta`, ...) are means over alpha; the arrays end in `_per_alpha`.

    Attributes:
        tp: (19,) matched rows whose similarity reaches alpha.
        fp: (19,) predictions without match.
        fn: (19,) ground truth without match.
        similarity_sum: (19,) summed similarity of the matched rows.
        association_sum: (19,) sum over matched rows of their pair's association accuracy.
        association_recall_sum: (19,) the same for association recall.
        association_precision_sum: (19,) the same for association precision.
        zero_distance: distance in meters at which similarity is 0.
    """

    tp: PerAlpha
    fp: PerAlpha
    fn: PerAlpha
    similarity_sum: PerAlpha
    association_sum: PerAlpha
    association_recall_sum: PerAlpha
    association_precision_sum: PerAlpha
    zero_distance: float

    @property
    def alphas(self) -> PerAlpha:
        """(19,) similarity thresholds 0.05, 0.10, ..., 0.95."""
        return ALPHAS.copy()

    @property
    def deta_per_alpha(self) -> PerAlpha:
        """Detection accuracy TP / (TP + FN + FP)."""
        return 100 * self.tp / np.maximum(1, self.tp + self.fn + self.fp)

    @property
    def detre_per_alpha(self) -> PerAlpha:
        """Detection recall TP / (TP + FN)."""
        return 100 * self.tp / np.maximum(1, self.tp + self.fn)

    @property
    def detpr_per_alpha(self) -> PerAlpha:
        """Detection precision TP / (TP + FP)."""
        return 100 * self.tp / np.maximum(1, self.tp + self.fp)

    @property
    def assa_per_alpha(self) -> PerAlpha:
        """Association accuracy, averaged over the matched rows."""
        return 100 * self.association_sum / np.maximum(1, self.tp)

    @property
    def assre_per_alpha(self) -> PerAlpha:
        """Association recall, averaged over the matched rows."""
        return 100 * self.association_recall_sum / np.maximum(1, self.tp)

    @property
    def asspr_per_alpha(self) -> PerAlpha:
        """Association precision, averaged over the matched rows."""
        return 100 * self.association_precision_sum / np.maximum(1, self.tp)

    @property
    def loca_per_alpha(self) -> PerAlpha:
        """Mean similarity of the matched rows; 100 where nothing is matched."""
        return 100 * np.where(self.tp > 0, self.similarity_sum / np.maximum(1, self.tp), 1.0)

    @property
    def hota_per_alpha(self) -> PerAlpha:
        """Geometric mean of detection and association accuracy."""
        return np.sqrt(self.deta_per_alpha * self.assa_per_alpha)

    @property
    def hota(self) -> float:
        """Mean over alpha of `hota_per_alpha`."""
        return float(self.hota_per_alpha.mean())

    @property
    def deta(self) -> float:
        """Mean over alpha of `deta_per_alpha`."""
        return float(self.deta_per_alpha.mean())

    @property
    def assa(self) -> float:
        """Mean over alpha of `assa_per_alpha`."""
        return float(self.assa_per_alpha.mean())

    @property
    def loca(self) -> float:
        """Mean over alpha of `loca_per_alpha`."""
        return float(self.loca_per_alpha.mean())

    @property
    def detre(self) -> float:
        """Mean over alpha of `detre_per_alpha`."""
        return float(self.detre_per_alpha.mean())

    @property
    def detpr(self) -> float:
        """Mean over alpha of `detpr_per_alpha`."""
        return float(self.detpr_per_alpha.mean())

    @property
    def assre(self) -> float:
        """Mean over alpha of `assre_per_alpha`."""
        return float(self.assre_per_alpha.mean())

    @property
    def asspr(self) -> float:
        """Mean over alpha of `asspr_per_alpha`."""
        return float(self.asspr_per_alpha.mean())

    def __str__(self) -> str:
        return (
            f"HOTA {self.hota:.2f}  DetA {self.deta:.2f}  AssA {self.assa:.2f}  "
            f"LocA {self.loca:.2f}  DetRe {self.detre:.2f}  DetPr {self.detpr:.2f}  "
            f"AssRe {self.assre:.2f}  AssPr {self.asspr:.2f}"
        )


def hota(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    frames: Frames | None = None,
    *,
    zero_distance: Number = 1.0,
) -> HotaMetrics:
    """Compare predicted with true trajectories by HOTA.

    The similarity of two positions d meters apart is max(0, 1 - d / zero_distance). Each frame is
    matched once, for the largest sum of similarity times how well the two identities agree over
    the whole sequence; each alpha then keeps the pairs whose similarity reaches it.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], x and y in meters on the ground.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        frames: the frames to evaluate, also those without rows; rows of other frames are ignored.
            None evaluates every frame that either array mentions.
        zero_distance: distance in meters at which the similarity is 0.

    Returns:
        The metrics, in percent.

    Raises:
        InvalidInputError: naming the first bad row; an id may appear only once in a frame.

    Source:
        Luiten et al., "HOTA: a higher order metric for evaluating multi-object tracking" (2021).
    """
    zero = as_positive(zero_distance, "zero_distance")
    sequence = read_sequence(ground_truth, predictions, frames, identified=True)
    people, person = np.unique(sequence.truth[:, 1], return_inverse=True)
    hypotheses, hypothesis = np.unique(sequence.predicted[:, 1], return_inverse=True)
    person_rows = np.bincount(person, minlength=len(people))
    hypothesis_rows = np.bincount(hypothesis, minlength=len(hypotheses))

    similarities = [np.maximum(0, 1 - sequence.distances(*rows) / zero) for rows in sequence]
    agreement = _agreement(sequence, similarities, person, hypothesis)
    agreement /= np.maximum(_EPSILON, person_rows[:, None] + hypothesis_rows[None, :] - agreement)

    pairs, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for (truth, predicted), similarity in zip(sequence, similarities, strict=True):
        p, h = person[truth], hypothesis[predicted]
        i, j = linear_sum_assignment(agreement[np.ix_(p, h)] * similarity, maximize=True)
        pairs.append(p[i] * len(hypotheses) + h[j])
        values.append(similarity[i, j])
    pair, value = np.concatenate(pairs), np.concatenate(values)

    sums = np.zeros((5, len(ALPHAS)))
    for k, alpha in enumerate(ALPHAS):
        reached = value >= alpha - _EPSILON
        unique, count = np.unique(pair[reached], return_counts=True)
        if not len(unique):
            continue
        n_person = person_rows[unique // len(hypotheses)]
        n_hypothesis = hypothesis_rows[unique % len(hypotheses)]
        sums[:, k] = (
            reached.sum(),
            value[reached].sum(),
            (count * count / (n_person + n_hypothesis - count)).sum(),
            (count * count / n_person).sum(),
            (count * count / n_hypothesis).sum(),
        )
    return HotaMetrics(
        tp=sums[0],
        fp=len(sequence.predicted) - sums[0],
        fn=len(sequence.truth) - sums[0],
        similarity_sum=sums[1],
        association_sum=sums[2],
        association_recall_sum=sums[3],
        association_precision_sum=sums[4],
        zero_distance=zero,
    )


def _agreement(
    sequence: Sequence, similarities: list[np.ndarray], person: np.ndarray, hypothesis: np.ndarray
) -> Float[np.ndarray, "people hypotheses"]:
    """Soft count of the frames that each pair of identities shares.

    A frame counts fully if the two are similar only to each other, less if others compete.
    """
    shared = np.zeros((person.max(initial=-1) + 1, hypothesis.max(initial=-1) + 1))
    for (truth, predicted), similarity in zip(sequence, similarities, strict=True):
        union = similarity.sum(0)[None, :] + similarity.sum(1)[:, None] - similarity
        share = np.divide(similarity, union, out=np.zeros_like(similarity), where=union > _EPSILON)
        shared[np.ix_(person[truth], hypothesis[predicted])] += share
    return shared


def combine_hota(parts: Iterable[HotaMetrics]) -> HotaMetrics:
    """Combine the HOTA metrics of several sequences by adding all sums at each alpha.

    Args:
        parts: metrics of the sequences, all made with the same zero_distance.

    Returns:
        The metrics of the added sums; association is weighted by matched rows.

    Raises:
        InvalidInputError: if there are no parts or their zero_distance differs.
    """
    alike = {"zero_distance": "zero_distance"}
    return pool(parts, HotaMetrics, sum, alike=alike, name="HOTA")
