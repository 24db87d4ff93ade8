"""Mutually nearest people of two ground maps, and the density of chance matches."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.ndimage import gaussian_filter

from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.types._sampling import mutually_lowest

ROUNDING = 1.01  # single precision may shorten a distance by less
LEAST_DENSITY = 0.002  # boxes per square meter and frame: one in 500 square meters
CELL = 0.5  # meters; of the density map of boxes
BLUR = 1.0  # meters; of that map
MARGIN = 4 * BLUR  # where the blur ends


class Matches(NamedTuple):
    """People of two maps who are each other's best match.

    Attributes:
        frame: (K,) ascending.
        slot: (K,) of the person in the first map.
        partner: (K,) slot of the person in the second map.
        distance: (K,) squared Mahalanobis distance of their positions.
        log_determinant: (K,) of the covariance of the difference of their positions.
    """

    frame: Int[np.ndarray, " match"]
    slot: Int[np.ndarray, " match"]
    partner: Int[np.ndarray, " match"]
    distance: Float32[np.ndarray, " match"]
    log_determinant: Float32[np.ndarray, " match"]


def mutual_nearest(one: GroundMap, other: GroundMap, gate: float) -> Matches:
    """Find pairs of people within the gate that are each other's best match.

    Covariances are evaluated only for pairs within reach by their distance in meters: a squared
    Mahalanobis distance is at least the squared distance over the trace of the covariance.

    Args:
        one: (T, N) people.
        other: (T, M) people in the same frames.
        gate: largest squared Mahalanobis distance of a pair.
    """
    slots, partners = one.valid.shape[1], other.valid.shape[1]
    x, y, a, b, d, reach = _components(one, gate)
    to_x, to_y, to_a, to_b, to_d, to_reach = _components(other, gate)
    apart = x[:, :, None] - to_x[:, None, :]
    apart *= apart
    sideways = y[:, :, None] - to_y[:, None, :]
    sideways *= sideways
    apart += sideways
    near = np.flatnonzero(apart < reach[:, :, None] + to_reach[:, None, :])
    row, partner = np.divmod(near, partners)
    frame, slot = np.divmod(row, slots)
    column = frame * partners + partner
    x, y = (p.ravel()[row] - q.ravel()[column] for p, q in ((x, to_x), (y, to_y)))
    a, b, d = (p.ravel()[row] + q.ravel()[column] for p, q in ((a, to_a), (b, to_b), (d, to_d)))
    determinant = a * d - b * b
    distance = (d * x * x - 2 * b * x * y + a * y * y) / determinant
    log_determinant = np.log(determinant)
    pairs = Matches(frame, slot, partner, distance, log_determinant)
    cost = np.where(distance < gate, distance + log_determinant, np.inf)
    best = mutually_lowest(cost, row, column)
    return Matches(*(values[best] for values in pairs))


def _components(people: GroundMap, gate: float) -> tuple[Float32[np.ndarray, "frame slot"], ...]:
    """Return x, y, the covariance and the squared distance that it allows, -inf for empty slots.

    Single precision resolves a millimeter in a kilometer.
    """
    a, d = people.covariance[..., 0, 0], people.covariance[..., 1, 1]
    reach = np.where(people.valid, ROUNDING * gate * (a + d), -np.inf)
    b = people.covariance[..., 0, 1]
    values = (people.xy[..., 0], people.xy[..., 1], a, b, d, reach)
    return tuple(np.ascontiguousarray(value, np.float32) for value in values)


def chance_density(
    people: GroundMap,
) -> Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]:
    """Estimate the density of a camera's boxes on the ground, blurred by `BLUR`.

    A standing person raises the local density, so that a match there is not evidence.

    Args:
        people: the camera's map.

    Returns:
        A function from points (n, 2) to boxes per square meter and frame, (n,).
    """
    xy = people.xy[people.valid]
    if not len(xy):
        return lambda xy: np.full(len(xy), LEAST_DENSITY)
    origin = xy.min(0) - MARGIN
    shape = np.ceil((xy.max(0) + MARGIN - origin) / CELL).astype(int) + 1
    index = np.floor((xy - origin) / CELL).astype(int)
    counts = np.bincount(np.ravel_multi_index(index.T, shape), minlength=shape.prod())
    density = counts.reshape(shape) / (CELL**2 * len(people.xy))
    density = gaussian_filter(density, BLUR / CELL, mode="constant")

    def at(xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        index = np.floor((xy - origin) / CELL).astype(int)
        inside = ((index >= 0) & (index < shape)).all(-1)
        x, y = np.clip(index, 0, shape - 1).T
        return np.where(inside, density[x, y], 0.0) + LEAST_DENSITY

    return at
