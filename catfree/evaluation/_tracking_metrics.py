"""Tracking metrics on the ground: CLEAR MOT (MOTA, MOTP) and identity scores (IDF1)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from catfree.evaluation._pooling import pool
from catfree.evaluation._position_matching import match
from catfree.evaluation._rows import Frames, Number, Sequence, read_sequence
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_positive

MOSTLY_TRACKED = 0.8  # shares of a person's annotated frames, as in the MOT benchmarks
MOSTLY_LOST = 0.2


def _ratio(numerator: Number, denominator: Number) -> float:
    """The quotient; nan or infinite if the denominator is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.divide(numerator, denominator))


@dataclass(frozen=True)
class TrackingMetrics:
    """Tracking quality over a sequence: counts, and the rates computed from them.

    Rates are in percent. A rate whose denominator is 0 is nan; MOTA without ground truth is -inf
    if there are predictions.

    Attributes:
        num_frames: evaluated frames.
        num_ground_truth: ground-truth rows.
        num_predictions: predicted rows.
        num_objects: different ground-truth identities.
        num_matches: matched pairs that continue or start an identity.
        id_switches: matched pairs whose person was last matched to another prediction id.
        fp: unmatched predictions.
        fn: unmatched ground truth.
        distance_sum: summed distance of all matched pairs in meters.
        idtp: rows explained by the best one-to-one assignment of whole identities.
        idfp: predictions it does not explain.
        idfn: ground truth it does not explain.
        mostly_tracked: people matched in at least 80 percent of their frames.
        partially_tracked: people between the two.
        mostly_lost: people matched in less than 20 percent.
        fragmentations: interruptions between a person's first and last matched frame.
        threshold: the gate in meters.
    """

    num_frames: int
    num_ground_truth: int
    num_predictions: int
    num_objects: int
    num_matches: int
    id_switches: int
    fp: int
    fn: int
    distance_sum: float
    idtp: int
    idfp: int
    idfn: int
    mostly_tracked: int
    partially_tracked: int
    mostly_lost: int
    fragmentations: int
    threshold: float

    @property
    def tp(self) -> int:
        """All matched pairs, identity switches included."""
        return self.num_matches + self.id_switches

    @property
    def mota(self) -> float:
        """100 (1 - (FN + FP + identity switches) / GT)."""
        return 100 * (1 - _ratio(self.fn + self.fp + self.id_switches, self.num_ground_truth))

    @property
    def motp(self) -> float:
        """Mean distance of the matched pairs in meters: lower is better."""
        return _ratio(self.distance_sum, self.tp)

    @property
    def motp_percent(self) -> float:
        """100 (1 - MOTP / threshold), the form that papers with a gate of 1 m report."""
        return 100 * (1 - self.motp / self.threshold)

    @property
    def precision(self) -> float:
        """Percent of the predictions that are matched."""
        return 100 * _ratio(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float:
        """Percent of the ground truth that is matched."""
        return 100 * _ratio(self.tp, self.num_ground_truth)

    @property
    def idf1(self) -> float:
        """100 · 2 IDTP / (GT + predictions)."""
        return 100 * _ratio(2 * self.idtp, self.num_ground_truth + self.num_predictions)

    @property
    def idp(self) -> float:
        """100 IDTP / predictions."""
        return 100 * _ratio(self.idtp, self.num_predictions)

    @property
    def idr(self) -> float:
        """100 IDTP / GT."""
        return 100 * _ratio(self.idtp, self.num_ground_truth)

    def __str__(self) -> str:
        return (
            f"MOTA {self.mota:.2f}  MOTP {self.motp:.3f} m  IDF1 {self.idf1:.2f}  "
            f"ID switches {self.id_switches}  MT {self.mostly_tracked}  ML {self.mostly_lost}  "
            f"FP {self.fp}  FN {self.fn}  ({self.num_frames} frames)"
        )


def tracking_metrics(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    frames: Frames | None = None,
    threshold: Number = 1.0,
) -> TrackingMetrics:
    """Compare predicted with true trajectories.

    CLEAR MOT goes through the frames in ascending order. A person keeps the prediction id it was
    last matched to, however long ago, whenever that id is within the gate and not yet taken
    (ground-truth rows in input order). The remaining rows are matched one to one: as many pairs as
    possible, then the smallest total distance. The identity scores instead assign whole
    trajectories one to one so that as many rows as possible agree within the gate.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], x and y in meters on the ground.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        frames: the frames to evaluate, also those without rows; rows of other frames are ignored.
            None evaluates every frame that either array mentions.
        threshold: largest distance of a match in meters, inclusive.

    Returns:
        The metrics.

    Raises:
        InvalidInputError: naming the first bad row; an id may appear only once in a frame.

    Source:
        Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT
        metrics" (2008); Ristani et al., "Performance measures and a data set for multi-target,
        multi-camera tracking" (2016).
    """
    gate = as_positive(threshold, "threshold")
    sequence = read_sequence(ground_truth, predictions, frames, identified=True)
    people, person = np.unique(sequence.truth[:, 1], return_inverse=True)
    hypotheses, hypothesis = np.unique(sequence.predicted[:, 1], return_inverse=True)
    shared = np.zeros((len(people), len(hypotheses)), dtype=np.int64)
    clear = _match_frames(sequence, person, hypothesis, shared, gate)

    appearances = np.bincount(person, minlength=len(people))
    tracked = np.bincount(person, weights=clear.matched, minlength=len(people)) / appearances
    mostly_tracked = int((tracked >= MOSTLY_TRACKED).sum())
    mostly_lost = int((tracked < MOSTLY_LOST).sum())

    # Every unmatched row is an error, and a pair of identities removes its shared frames from both
    # error counts: the fewest errors are therefore the most shared frames.
    idtp = int(shared[linear_sum_assignment(shared, maximize=True)].sum())
    tp = int(clear.matched.sum())
    switches = int(clear.switched.sum())
    return TrackingMetrics(
        num_frames=len(sequence.frames),
        num_ground_truth=len(sequence.truth),
        num_predictions=len(sequence.predicted),
        num_objects=len(people),
        num_matches=tp - switches,
        id_switches=switches,
        fp=len(sequence.predicted) - tp,
        fn=len(sequence.truth) - tp,
        distance_sum=float(clear.distance.sum()),
        idtp=idtp,
        idfp=len(sequence.predicted) - idtp,
        idfn=len(sequence.truth) - idtp,
        mostly_tracked=mostly_tracked,
        partially_tracked=len(people) - mostly_tracked - mostly_lost,
        mostly_lost=mostly_lost,
        fragmentations=_fragmentations(sequence.truth[:, 0], person, clear.matched),
        threshold=gate,
    )


class _ClearMatches(NamedTuple):
    """Match of each ground-truth row.

    Attributes:
        matched: (G,) whether it has a prediction.
        switched: (G,) whether that prediction's id differs from the person's last one.
        distance: (G,) to that prediction in meters, 0 if there is none.
    """

    matched: Bool[np.ndarray, " g"]
    switched: Bool[np.ndarray, " g"]
    distance: Float[np.ndarray, " g"]


def _match_frames(
    sequence: Sequence,
    person: Int[np.ndarray, " g"],
    hypothesis: Int[np.ndarray, " p"],
    shared: Int[np.ndarray, "people hypotheses"],
    gate: float,
) -> _ClearMatches:
    """Match each frame with continuity, and count in `shared` the frames that each pair shares."""
    matched = np.zeros(len(person), dtype=bool)
    switched = np.zeros(len(person), dtype=bool)
    distance = np.zeros(len(person))
    last = np.full(shared.shape[0], -1)
    for truth, predicted in sequence:
        difference = sequence.truth[truth, None, 2:] - sequence.predicted[None, predicted, 2:]
        squared = (difference**2).sum(axis=-1)
        # Squares, not roots: rounding a root would let a distance just above the gate in. The
        # product of floats may be infinite, where their power is an OverflowError.
        admissible = squared <= gate * gate
        distances = np.sqrt(squared)
        row, column = np.nonzero(admissible)
        shared[person[truth[row]], hypothesis[predicted[column]]] += 1

        column_of = {int(h): j for j, h in enumerate(hypothesis[predicted])}
        free = admissible.copy()
        pairs = []
        for i, previous in enumerate(last[person[truth]]):
            j = column_of.get(int(previous))
            if j is not None and free[i, j]:
                pairs.append((i, j))
                free[i, :] = False
                free[:, j] = False
        continued = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        new = match(distances, free)
        i = np.concatenate([continued[:, 0], new.truth])
        j = np.concatenate([continued[:, 1], new.predicted])

        rows, ids = truth[i], hypothesis[predicted[j]]
        before = last[person[rows]]
        matched[rows] = True
        switched[rows] = (before >= 0) & (before != ids)
        distance[rows] = distances[i, j]
        last[person[rows]] = ids
    return _ClearMatches(matched, switched, distance)


def _fragmentations(
    frame: Float[np.ndarray, " g"], person: Int[np.ndarray, " g"], matched: Bool[np.ndarray, " g"]
) -> int:
    """Count how often a matched person is lost and then matched again."""
    order = np.lexsort((frame, person))
    # Two successive matches of one person are interrupted unless they are neighbors in the list of
    # that person's rows.
    position = np.flatnonzero(matched[order])
    same_person = np.diff(person[order][position]) == 0
    return int((same_person & (np.diff(position) > 1)).sum())


def combine_tracking(parts: Iterable[TrackingMetrics]) -> TrackingMetrics:
    """Combine the metrics of several sequences by adding all counts.

    Args:
        parts: metrics of the sequences, all made with the same threshold.

    Returns:
        The metrics of the summed counts.

    Raises:
        InvalidInputError: if there are no parts or their thresholds differ.
    """
    alike = {"threshold": "threshold"}
    return pool(parts, TrackingMetrics, sum, alike=alike, name="tracking")
