"""Mutual nearest people of two ground maps, and how far they beat chance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.ndimage import gaussian_filter

from catfree.calibration.people.cameras._ground_map import GroundMap


def squared_distances(
    one: GroundMap, other: GroundMap
) -> tuple[
    Float[np.ndarray, "frame slot partner"],
    Float[np.ndarray, "frame slot partner"],
]:
    """Squared Mahalanobis distances and log determinants (T, N, M) between people of one frame."""
    x, y = (_pair_sums(one.xy[..., i], -other.xy[..., i]) for i in (0, 1))
    a, b, d = (
        _pair_sums(one.covariance[..., i, j], other.covariance[..., i, j])
        for i, j in ((0, 0), (0, 1), (1, 1))
    )
    determinant = a * d - b * b
    distance = (d * x * x - 2 * b * x * y + a * y * y) / determinant
    both = one.valid[:, :, None] & other.valid[:, None, :]
    return np.where(both, distance, np.inf), np.log(determinant)


def _pair_sums(
    one: Float[np.ndarray, "frame slot"], other: Float[np.ndarray, "frame partner"]
) -> Float32[np.ndarray, "frame slot partner"]:
    """Sums (T, N, M) of all pairs; single precision holds a millimetre in a kilometre."""
    return one.astype(np.float32)[:, :, None] + other.astype(np.float32)[:, None, :]


def mutual_nearest(
    distance: Float[np.ndarray, "frame slot partner"],
    log_determinant: Float[np.ndarray, "frame slot partner"],
    gate: float,
) -> tuple[Int[np.ndarray, " match"], Int[np.ndarray, " match"], Int[np.ndarray, " match"]]:
    """Pairs of people that are each other's best and lie within the gate.

    Args:
        distance: (T, N, M) squared Mahalanobis distances of the people of two maps.
        log_determinant: (T, N, M) log determinants of the covariances of their differences.
        gate: largest squared Mahalanobis distance of a pair.

    Returns:
        Frame, slot in the first map and slot in the second, each (pairs,).
    """
    cost = np.where(distance < gate, distance + log_determinant, np.inf)
    if cost.shape[1] == 0 or cost.shape[2] == 0:
        none = np.zeros(0, np.int64)
        return none, none, none
    forth, back = cost.argmin(2), cost.argmin(1)
    time, slot = np.nonzero(np.isfinite(cost.min(2)))
    partner = forth[time, slot]
    mutual = back[time, partner] == slot
    return time[mutual], slot[mutual], partner[mutual]


@dataclass(frozen=True)
class ChanceDensity:
    """How densely a camera's own boxes fall on the ground, per square metre and frame.

    Attributes:
        values: (X, Y) density of each cell.
        origin: (2,) corner of the first cell in metres.
        cell: side of a cell in metres.
    """

    values: Float[np.ndarray, "x y"]
    origin: Float[np.ndarray, "2"]
    cell: float

    def __call__(self, xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Density at points (..., 2)."""
        index = np.floor((xy - self.origin) / self.cell).astype(int)
        limit = np.array(self.values.shape) - 1
        inside = ((index >= 0) & (index <= limit)).all(-1)
        index = np.clip(index, 0, limit)
        return np.where(inside, self.values[index[..., 0], index[..., 1]], 0.0) + LEAST_DENSITY


LEAST_DENSITY = 0.002  # boxes per square metre and frame: one somewhere in 500 square metres
CELL = 0.5
LARGEST_MAP = 80.0


def chance_density(people: GroundMap) -> ChanceDensity:
    """The density of a map over all its frames, blurred by a metre.

    A person who stands still makes the density high where they stand, so that finding them again
    is no evidence.
    """
    xy = people.xy[people.valid]
    if not len(xy):
        return ChanceDensity(np.zeros((1, 1)), np.zeros(2), CELL)
    middle = np.median(xy, axis=0)
    xy = xy[(np.abs(xy - middle) < LARGEST_MAP).all(-1)]
    origin = xy.min(0) - 4
    shape = np.ceil((xy.max(0) + 4 - origin) / CELL).astype(int) + 1
    index = np.floor((xy - origin) / CELL).astype(int)
    counts = np.bincount(index[:, 0] * shape[1] + index[:, 1], minlength=shape[0] * shape[1])
    density = counts.reshape(shape) / (CELL**2 * len(people.xy))
    return ChanceDensity(gaussian_filter(density, 1.0 / CELL, mode="constant"), origin, CELL)


@dataclass(frozen=True)
class Judgment:
    """How well a camera's people agree with a map made without it.

    Attributes:
        evidence: log-likelihood ratio of "same people" against "same places, other times".
        association: share of the people whom both sides should see that are matched.
        matches: number of matched people.
        pairs: (matches, 3) frame, slot of the camera, slot of the map.
    """

    evidence: float
    association: float
    matches: int
    pairs: Int[np.ndarray, "match 3"]


def judge(
    own: GroundMap,
    others: GroundMap,
    density: ChanceDensity,
    others_expected: Bool[np.ndarray, "frame partner"],
    own_expected: Bool[np.ndarray, "frame slot"],
    *,
    gate: float,
    detection_rates: tuple[float, float],
) -> Judgment:
    """Weigh the people of one camera against a map of the others.

    Args:
        own: the camera's map in world coordinates.
        others: the map of the other cameras.
        density: chance density of the camera's boxes.
        others_expected: (T, M) whether the camera should see this person of the map.
        own_expected: (T, N) whether some other camera should see this person of the camera.
        gate: largest squared Mahalanobis distance of a match.
        detection_rates: bounds on the probability that a person who should be seen has a box.

    Returns:
        The judgment; people who should be seen and are not count against.
    """
    distance, log_determinant = squared_distances(own, others)
    time, slot, partner = mutual_nearest(distance, log_determinant, gate)
    at = (time, slot, partner)
    own_matched = np.zeros(own.valid.shape, bool)
    own_matched[time, slot] = True
    others_matched = np.zeros(others.valid.shape, bool)
    others_matched[time, partner] = True
    missed = int((others_expected & others.valid & ~others_matched).sum())
    lonely = int((own_expected & own.valid & ~own_matched).sum())
    matches = len(time)
    # The rate that explains the matches best, within what detectors do.
    rate = 2 * matches / max(1, 2 * matches + missed + lonely)
    low, high = detection_rates
    rate = min(max(rate, low), high)
    miss = np.log(1 - rate)
    chance = density(own.xy[time, slot])
    log_ratio = (
        np.log(rate)
        - distance[at] / 2
        - log_determinant[at] / 2
        - np.log(2 * np.pi)
        - np.log(chance)
    )
    # A match that says less than two separate people would is not believed as one.
    evidence = float(np.maximum(log_ratio, 2 * miss).sum() + miss * (missed + lonely))
    rates = [matches / max(1, matches + count) for count in (missed, lonely)]
    return Judgment(evidence, max(rates), matches, np.stack([time, slot, partner], -1))
