"""Match mutually nearest people of two ground maps and compare the matches with chance."""

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
    """Squared Mahalanobis distances and log determinants (T, N, M) between people of a frame."""
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
    """(T, N, M) sums of all pairs; single precision resolves a millimeter in a kilometer."""
    return one.astype(np.float32)[:, :, None] + other.astype(np.float32)[:, None, :]


def mutual_nearest(
    distance: Float[np.ndarray, "frame slot partner"],
    log_determinant: Float[np.ndarray, "frame slot partner"],
    gate: float,
) -> tuple[Int[np.ndarray, " match"], Int[np.ndarray, " match"], Int[np.ndarray, " match"]]:
    """Find pairs of people within the gate that are each other's best match.

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
    """Density of a camera's boxes on the ground, per square meter and frame.

    Attributes:
        values: (X, Y) density of each cell.
        origin: (2,) corner of the first cell in meters.
        cell: side of a cell in meters.
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


LEAST_DENSITY = 0.002  # boxes per square meter and frame: one somewhere in 500 square meters
CELL = 0.5
LARGEST_MAP = 80.0


def chance_density(people: GroundMap) -> ChanceDensity:
    """Density of a map over all frames, blurred by one meter.

    A person who stands still makes the local density high, so that a match there is not evidence.
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
    """Agreement of a camera's people with a map made without that camera.

    Attributes:
        evidence: log-likelihood ratio of "same people" against "same places, other times".
        association: fraction matched of the people that both sides should see.
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
        others_expected: (T, M) whether the camera should see each person of the map.
        own_expected: (T, N) whether any other camera should see each person of the camera.
        gate: largest squared Mahalanobis distance of a match.
        detection_rates: bounds on the probability that a person expected to be visible has a box.

    Returns:
        The judgment; missing people reduce the evidence.
    """
    distance, log_determinant = squared_distances(own, others)
    time, slot, partner = mutual_nearest(distance, log_determinant, gate)
    at = (time, slot, partner)
    own_matched = np.zeros(own.valid.shape, bool)
    own_matched[time, slot] = True
    others_matched = np.zeros(others.valid.shape, bool)
    others_matched[time, partner] = True
    missed = int((others_expected & others.valid & ~others_matched).sum())
    unmatched = int((own_expected & own.valid & ~own_matched).sum())
    matches = len(time)
    # Maximum likelihood detection rate, within the usual rates of detectors.
    rate = 2 * matches / max(1, 2 * matches + missed + unmatched)
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
    # A match less likely than two separate people counts as two separate people.
    evidence = float(np.maximum(log_ratio, 2 * miss).sum() + miss * (missed + unmatched))
    rates = [matches / max(1, matches + count) for count in (missed, unmatched)]
    return Judgment(evidence, max(rates), matches, np.stack([time, slot, partner], -1))
