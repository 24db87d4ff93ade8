"""Identities of the reported positions, from the past and the future of each instant.

A chain is the positions of one identity. At each instant, a Kalman filter summarizes the past of
every chain, and a backward filter its future. The likelihood that a future continues a past then
follows from two Gaussians, and one assignment finds the best pairs of all pasts with all futures.
This repairs both lost and switched identities. A sweep over all instants never lowers the evidence
of the chains. Sweeps are repeated until nothing changes, a few times at most; before each one, the
rates at which people leave and hide are estimated from the chains. Positions do not change.
"""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.methods.evidence._gaussian import Information, mean_and_covariance
from catfree.methods.evidence.group._appearance import GroupLooks, Looks, compare_looks
from catfree.methods.evidence.track._pasts import (
    Pasts,
    SeenPositions,
    assign,
    extend,
    no_pasts,
    predict,
)
from catfree.methods.evidence.track._tracking import (
    Motion,
    Population,
    Trails,
    distances,
    log_likelihood_of_states,
    transition,
    within_bounds,
)

SWEEPS = 4  # at most; a recording of a few minutes takes as many
HORIZON = 40  # most frames between a past and a future that are compared
HOPELESS = -10.0  # log evidence of places alone; pairs below are not compared
LAGS = 3  # of each of the two groups of lags from which the memory is estimated
LONGEST_MEMORY = 0.99  # a hundred steps straight ahead


class AbsenceHabits(NamedTuple):
    """How often people come, leave and hide, per person and frame.

    Attributes:
        leave: probability of leaving for good, and of being new.
        hide: probability of not being reported in the next frame although present.
        stay_hidden: probability that a hidden person is not reported in the next frame either.
    """

    leave: float
    hide: float
    stay_hidden: float

    def surprise(self, hidden: Int[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Negative log probability of being hidden for exactly this many frames."""
        cost = -np.log(self.hide) - np.log1p(-self.stay_hidden)
        return np.where(hidden > 0, cost - (hidden - 1) * np.log(self.stay_hidden), 0.0)


def identify(
    trails: Trails,
    reported: Bool[np.ndarray, " node"],
    error: Float[np.ndarray, "node 2 2"],
    info: Information,
    population: Population,
) -> Int[np.ndarray, " node"]:
    """Give each reported position an identity, unique within its frame.

    Args:
        trails: the tracks, whose identities are the initial ones.
        reported: (M,) which of their rows to use.
        error: (M, 2, 2) covariance of the positions beyond that of the boxes, in H0².
        info: (H) of the boxes of each group of the trails.
        population: common to all; its `motion` is used where the chains are too short to estimate
            it.

    Returns:
        (M,) identity, -1 for rows that are not reported.
    """
    rows = np.flatnonzero(reported)
    rows = rows[np.argsort(trails.frame[rows], kind="stable")]
    names = np.full(len(trails), -1)
    if len(rows) == 0:
        return names
    position, frame, group = trails.mean[rows, :2], trails.frame[rows], trails.group[rows]
    measured, _ = mean_and_covariance(info[group[group >= 0]], population.spread)
    position[group >= 0] = measured[:, :2]
    seen = seen_positions(trails, rows, error, info, population.looks)
    chain = np.unique(trails.track[rows], return_inverse=True)[1]
    motion = estimate_walk(position, frame, chain, population)
    population = population._replace(motion=motion)
    for _ in range(SWEEPS):
        habits = estimate_habits(frame, chain, len(population.time))
        new = sweep(frame, seen, chain, habits, population)
        pairs = len(np.unique(np.stack([chain, new]), axis=1).T)
        same = pairs == chain.max() + 1 == new.max() + 1
        chain = new
        if same:
            break
    names[rows] = chain
    return names


def seen_positions(
    trails: Trails,
    rows: Int[np.ndarray, " n"],
    error: Float[np.ndarray, "node 2 2"],
    info: Information,
    looks: Looks | GroupLooks,
) -> SeenPositions:
    """The boxes of each row, or the smoothed state in a gap, widened by the error."""
    group = trails.group[rows]
    is_detected = group >= 0
    small = np.linalg.inv(trails.covariance[rows, :3, :3])
    small_vector = np.einsum("nij,nj->ni", small, trails.mean[rows, :3])
    small[is_detected] = info.matrix[group[is_detected]]
    small_vector[is_detected] = info.vector[group[is_detected]]
    # (I⁻¹ + E)⁻¹ = (1 + I E)⁻¹ I avoids the inverse of I, which is singular for some single views.
    wider = np.eye(3) + small @ np.pad(error[rows], ((0, 0), (0, 1), (0, 1)))
    matrix = np.linalg.solve(wider, small)
    vector = np.linalg.solve(wider, small_vector[..., None])[..., 0]
    shown = looks.at(group)
    for part in shown:
        part[~is_detected] = 0
    return SeenPositions(matrix, vector, shown)


def estimate_habits(
    frame: Int[np.ndarray, " n"], chain: Int[np.ndarray, " n"], frames: int
) -> AbsenceHabits:
    """Estimate the rates of the chains by Laplace's rule of succession.

    Args:
        frame: (N,) sorted frame indices.
        chain: (N,) identities from 0.
        frames: number of frames of the sequence; people present at its beginning or end neither
            came nor left.
    """
    order = np.argsort(chain, kind="stable")
    step = np.diff(frame[order])
    same = np.diff(chain[order]) == 0
    came = (frame[order][np.r_[True, ~same]] > 0).sum()
    left = (frame[order][np.r_[~same, True]] < frames - 1).sum()
    hidden = step[same] - 1
    times, total, count = (hidden > 0).sum(), hidden.sum(), len(frame)
    return AbsenceHabits(
        leave=(came + left + 2) / (2 * count + 4),
        hide=(times + 1) / (count + 2),
        stay_hidden=(total - times + 1) / (total + 2),
    )


def estimate_walk(
    position: Float[np.ndarray, "n 2"],
    frame: Int[np.ndarray, " n"],
    chain: Int[np.ndarray, " n"],
    population: Population,
) -> Motion:
    """Estimate speed and memory from products of steps of one chain that are a few frames apart.

    The error of a position affects only neighboring steps, so products of steps farther apart are
    those of the velocity: speed² memory^lag. The returned memory is raised to the power of
    `sudden`.

    Args:
        position: (N, 2) in H0.
        frame: (N,) sorted frame indices.
        chain: (N,) identities.
        population: its `motion` is returned if there are too few steps, or if velocities do not
            persist.
    """
    time, usual, settings = population.time, population.motion, population.settings
    order = np.argsort(chain, kind="stable")
    x, f = position[order], frame[order]
    new = (np.diff(chain[order]) != 0) | (np.diff(f) != 1)
    new |= np.abs(np.diff(time[f]) - 1) > 0.5
    step = np.clip(np.diff(x, axis=0), -settings.fastest, settings.fastest)
    run = np.where(new, -1, np.cumsum(new))
    product, count = np.zeros(2), np.zeros(2)
    for lag in range(2, 2 + 2 * LAGS):
        together = (run[lag:] == run[:-lag]) & (run[lag:] >= 0)
        late = int(lag >= 2 + LAGS)
        product[late] += (step[lag:] * step[:-lag])[together].sum()
        count[late] += 2 * together.sum()
    if count.min() < settings.fewest_samples or product.min() <= 0:
        return usual
    early, late = product / count
    memory = min(float((late / early) ** (1 / LAGS)), LONGEST_MEMORY)
    speed = np.sqrt(early / np.mean(memory ** np.arange(2, 2 + LAGS)))
    return replace(
        usual, speed=within_bounds(float(speed), settings), memory=memory**settings.sudden
    )


class ChainBoxes(NamedTuple):
    """The boxes of each chain's positions.

    Attributes:
        looks: looks of the K chains.
        sightings: (K,) number of positions with an embedding.
    """

    looks: Looks
    sightings: Int[np.ndarray, " k"]

    @classmethod
    def of(cls, seen: SeenPositions, chain: Int[np.ndarray, " n"], chains: int) -> "ChainBoxes":
        """Boxes of N positions; `chain` (N,) names one of `chains` for each of them."""
        total, boxes = seen.looks
        sums = np.zeros((chains, total.shape[1]))
        np.add.at(sums, chain, total)
        counts, sightings = (
            np.bincount(chain, number, chains).astype(int) for number in (boxes, boxes > 0)
        )
        return cls(Looks(sums, counts), sightings)

    def at(self, chains: Int[np.ndarray, " k"]) -> "ChainBoxes":
        """Some of the chains."""
        return jax.tree.map(lambda part: part[chains], self)

    def subtract(self, seen: SeenPositions, chain: Int[np.ndarray, " n"]) -> None:
        """Remove positions, each of a different chain, in place."""
        self.looks.total[chain] -= seen.looks.total
        self.looks.boxes[chain] -= seen.looks.boxes
        self.sightings[chain] -= seen.looks.boxes > 0


class Futures(NamedTuple):
    """Chains from one frame on: their index, information, and frames until they are seen."""

    chain: Int[np.ndarray, " k"]
    matrix: Float[np.ndarray, "k 5 5"]
    vector: Float[np.ndarray, "k 5"]
    wait: Int[np.ndarray, " k"]


def futures_of(
    at: list[np.ndarray], seen: SeenPositions, chain: np.ndarray, steps: list[tuple]
) -> list[Futures]:
    """Compute the information on each chain's state at each frame from that frame onward."""
    place = np.full(chain.max(initial=-1) + 1, -1)
    future = Futures(np.zeros(0, int), np.zeros((0, 5, 5)), np.zeros((0, 5)), np.zeros(0, int))
    futures = []
    for t in range(len(at) - 1, -1, -1):
        name, matrix, vector, wait = future
        if futures:
            A, Q = steps[t]
            # Backward over x' = A x + noise: A' (L⁻¹ + Q)⁻¹ A, without an inverse of L.
            loss = np.linalg.solve(np.eye(5) + matrix @ Q, np.eye(5))
            matrix, vector = A.T @ loss @ matrix @ A, (loss @ vector[..., None])[..., 0] @ A
            near = wait < HORIZON
            name, matrix, vector, wait = name[near], matrix[near], vector[near], wait[near] + 1
        rows = at[t]
        place[:] = -1
        place[name] = np.arange(len(name))
        old = place[chain[rows]]
        hit, fresh = rows[old >= 0], rows[old < 0]
        old = old[old >= 0]
        matrix[old, :3, :3] += seen.matrix[hit]
        vector[old, :3] += seen.vector[hit]
        wait[old] = 0
        # The velocity is unknown.
        new_matrix = np.pad(seen.matrix[fresh], ((0, 0), (0, 2), (0, 2)))
        new_vector = np.pad(seen.vector[fresh], ((0, 0), (0, 2)))
        future = Futures(
            np.concatenate([name, chain[fresh]]),
            np.concatenate([matrix, new_matrix]),
            np.concatenate([vector, new_vector]),
            np.concatenate([wait, np.zeros(len(fresh), int)]),
        )
        futures.append(future)
    return futures[::-1]


def _of_known_and_any_height(
    mean: Float[np.ndarray, "t 5"], cov: Float[np.ndarray, "t 5 5"], spread: float
) -> tuple[Float[np.ndarray, "2 t 5"], Float[np.ndarray, "2 t 5 5"]]:
    """States and covariances: as given, and with unknown height."""
    mean, cov = np.stack([mean, mean]), np.stack([cov, cov])
    mean[1, :, 2], cov[1, :, 2], cov[1, :, :, 2] = 1.0, 0.0, 0.0
    cov[1, :, 2, 2] = spread**2
    return mean, cov


def sweep(
    frame: Int[np.ndarray, " n"],
    seen: SeenPositions,
    chain: Int[np.ndarray, " n"],
    habits: AbsenceHabits,
    population: Population,
) -> Int[np.ndarray, " n"]:
    """Match pasts and futures once at every frame, in temporal order.

    Args:
        frame: (N,) sorted frame indices.
        seen: (N) the positions.
        chain: (N,) identities from 0, none twice in a frame.
        habits: rates of leaving and hiding.
        population: common to all chains.

    Returns:
        (N,) new identities from 0, in the order of their first positions.
    """
    bounds = np.searchsorted(frame, np.arange(len(population.time) + 1))
    at = [np.arange(a, b) for a, b in pairwise(bounds)]
    kinds = {dt: transition(population.motion, dt) for dt in set(np.diff(population.time).tolist())}
    steps = [kinds[dt] for dt in np.diff(population.time).tolist()]
    futures = futures_of(at, seen, chain, steps)
    pasts = no_pasts(seen.looks.dim)
    chains = int(chain.max()) + 1
    ahead = ChainBoxes.of(seen, chain, chains)
    names, count = np.zeros(len(chain), int), 0
    place = np.full(chains, -1)
    for t, future in enumerate(futures):
        if t:
            pasts = predict(pasts, *steps[t - 1])
        name = future.chain
        past = match_chains(pasts, future, ahead.at(name), habits, population)
        rows = at[t]
        place[name] = np.arange(len(name))
        linked = past[place[chain[rows]]]
        new = linked < 0
        names[rows[~new]] = pasts.name[linked[~new]]
        names[rows[new]] = begun = count + np.arange(new.sum())
        count += len(begun)
        now = seen.at(rows)
        pasts = extend(pasts, linked, begun, now, population.spread, population.motion.speed)
        pasts = pasts.seen_within(HORIZON - 1)  # drop chains that can no longer be continued
        ahead.subtract(now, chain[rows])
    return names


def match_chains(
    pasts: Pasts,
    future: Futures,
    ahead: ChainBoxes,
    habits: AbsenceHabits,
    population: Population,
) -> Int[np.ndarray, " k"]:
    """Assign pasts to futures.

    Args:
        pasts: the chains up to the frame before, predicted for this one.
        future: (K) the chains from this frame on.
        ahead: (K) their boxes.
        habits: rates of leaving and hiding.
        population: common to all chains.

    Returns:
        (K,) row of the past that each continues, or -1.
    """
    _, matrix, vector, wait = future
    density, spread, speed = population.density, population.spread, population.motion.speed
    # Terms of the prior of a new person, and of leaving and coming instead of staying.
    constant = np.log(2 * np.pi * density) - np.log(spread * speed**2)
    constant += 2 * np.log(habits.leave) - 0.5 / spread**2
    # Each future as a person never seen before, with usual height and velocity.
    alone = matrix + np.diag([0.0, 0.0, spread**-2, speed**-2, speed**-2])
    start = vector + np.array([0.0, 0.0, spread**-2, 0.0, 0.0])
    around = np.linalg.inv(alone)
    place = (around @ start[..., None])[..., 0]
    value = constant + 0.5 * ((start * place).sum(-1) - np.linalg.slogdet(alone)[1])
    mean, cov = pasts.mean, pasts.covariance
    hidden = pasts.gap[:, None] + wait[None]
    surprise = habits.surprise(hidden)
    m2, area = distances(mean[:, :2], cov[:, :2, :2], place[:, :2], around[:, :2, :2])
    cost = surprise + np.log(2 * np.pi * density * habits.leave**2)
    hope = -0.5 * (m2 + np.log(area)) - cost
    i, j = np.nonzero((hope > HOPELESS) & (hidden < HORIZON))
    mean, cov = _of_known_and_any_height(mean[i], cov[i], spread)
    same = log_likelihood_of_states(mean, cov, matrix[j], vector[j])
    misled = population.settings.foot_outlier  # heights mislead: those of one person disagree
    same += np.log([[1 - misled], [misled]])
    gain = np.zeros(hope.shape)
    gain[i, j] = np.logaddexp(*same) - value[j] - surprise[i, j]
    # A whole future counts as one usual position, because its errors are shared.
    each = ahead.looks.boxes / np.maximum(ahead.sightings, 1)
    ratio = compare_looks(pasts.looks, ahead.looks, each, population.likeness)
    gain[i, j] += ratio[i, j]
    return assign(gain)
