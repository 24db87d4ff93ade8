"""The past of each person up to an instant: a forward Kalman filter.

It follows both tracks and the identities made of them.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from catfree.methods.evidence._gaussian import Information, mean_and_covariance
from catfree.methods.evidence.group._appearance import Looks, no_looks
from catfree.types._annotations import HostOrDevice


class SeenPositions(NamedTuple):
    """Information of boxes on positions.

    Attributes:
        matrix: (N, 3, 3) information of y1, y2, H.
        vector: (N, 3) the matrix times the measured state.
        looks: looks of the N positions.
    """

    matrix: Float[HostOrDevice, "n 3 3"]
    vector: Float[HostOrDevice, "n 3"]
    looks: Looks

    def at(self, rows) -> "SeenPositions":
        """Some of the positions."""
        return jax.tree.map(lambda part: part[rows], self)


class Pasts(NamedTuple):
    """The people of an instant, each estimated from the positions of one name so far.

    Attributes:
        name: (T,) number of each person.
        gap: (T,) frames since the last position; 0 if in this instant.
        mean: (T, 5) y1, y2, H, v1, v2 per usual step, and `covariance`: (T, 5, 5).
        looks: looks of the T people.
    """

    name: Int[np.ndarray, " past"]
    gap: Int[np.ndarray, " past"]
    mean: Float[np.ndarray, "past 5"]
    covariance: Float[np.ndarray, "past 5 5"]
    looks: Looks

    def at(self, rows) -> "Pasts":
        """Some of the people."""
        return jax.tree.map(lambda part: part[rows], self)

    def seen_within(self, frames: int) -> "Pasts":
        """Select those with a position in this instant or this many before it."""
        return self.at(self.gap <= frames)


def no_pasts(dim: int) -> Pasts:
    """Return no people, with room for embeddings of `dim` numbers."""
    none = np.zeros(0, int)
    return Pasts(none, none, np.zeros((0, 5)), np.zeros((0, 5, 5)), no_looks(0, dim))


def predict(pasts: Pasts, A: Float[np.ndarray, "5 5"], Q: Float[np.ndarray, "5 5"]) -> Pasts:
    """Predict people one step ahead with this transition and noise."""
    return pasts._replace(mean=pasts.mean @ A.T, covariance=A @ pasts.covariance @ A.T + Q)


def assign(gain: Float[np.ndarray, "past n"]) -> Int[np.ndarray, " n"]:
    """Assign people to positions so as to maximize the sum of positive gains.

    Args:
        gain: (T, N) log evidence that a position continues a past rather than being a new person.

    Returns:
        (N,) row of the past that each position continues; -1 begins a new one.
    """
    rows, columns = linear_sum_assignment(-np.maximum(gain, 0))
    good = gain[rows, columns] > 0
    past = np.full(gain.shape[1], -1)
    past[columns[good]] = rows[good]
    return past


def extend(
    pasts: Pasts,
    linked: Int[np.ndarray, " n"],
    begun: Int[np.ndarray, " new"],
    seen: SeenPositions,
    spread: float,
    speed: float,
) -> Pasts:
    """Add the positions of an instant to the people before it, and append new people.

    Args:
        pasts: the people before, predicted for this instant.
        linked: (n,) the past that each position continues; -1 begins a new one.
        begun: names of the new people, in the order of their positions.
        seen: (n) the positions.
        spread: standard deviation of heights in H0.
        speed: standard deviation of a velocity component, H0 per usual step.
    """
    hit, new = linked >= 0, linked < 0
    old = linked[hit]
    mean, cov, gap = pasts.mean.copy(), pasts.covariance.copy(), pasts.gap + 1
    total, boxes = pasts.looks.total.copy(), pasts.looks.boxes.copy()
    mean[old], cov[old] = corrected_states(mean[old], cov[old], seen.matrix[hit], seen.vector[hit])
    gap[old] = 0
    total[old] += seen.looks.total[hit]
    boxes[old] += seen.looks.boxes[hit]
    info = Information(seen.matrix[new], seen.vector[new], np.zeros(len(begun)))
    place, around = mean_and_covariance(info, spread)
    state = np.pad(place, ((0, 0), (0, 2)))
    covariance = np.pad(around, ((0, 0), (0, 2), (0, 2)))
    covariance[:, [3, 4], [3, 4]] = speed**2
    none = np.zeros(len(begun), int)
    added = Pasts(begun, none, state, covariance, seen.looks.at(new))
    longer = Pasts(pasts.name, gap, mean, cov, Looks(total, boxes))
    return jax.tree.map(lambda *parts: np.concatenate(parts), longer, added)


def corrected_states(
    mean: Float[np.ndarray, "t n"],
    covariance: Float[np.ndarray, "t n n"],
    matrix: Float[HostOrDevice, "t d d"],
    vector: Float[HostOrDevice, "t d"],
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, "t n n"]]:
    """Update states with information (M, v) on their first d components."""
    # (C⁻¹ + M)⁻¹ = (1 + C M)⁻¹ C has no subtraction, so it stays positive definite.
    part = covariance[:, :, : vector.shape[-1]]
    loss = np.tile(np.eye(mean.shape[-1]), (len(mean), 1, 1))
    loss[:, :, : vector.shape[-1]] += part @ matrix
    pulled = mean[..., None] + part @ vector[..., None]
    after = np.linalg.solve(loss, np.concatenate([covariance, pulled], -1))
    return after[..., -1], after[..., :-1]
