"""Link groups over time: Kalman filter, assignment by evidence, smoothing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from catfree.methods.evidence._gaussian import Information, log_evidence, mean_and_covariance
from catfree.methods.evidence.group._appearance import GroupLooks, Likeness, Looks, compare_looks
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.track._pasts import (
    Pasts,
    SeenPositions,
    assign,
    extend,
    no_pasts,
    predict,
)
from catfree.settings import EvidenceSettings
from catfree.types._annotations import HostOrDevice

CONSECUTIVE = 1.5  # usual steps; frames farther apart are not used for the speed
LINKS_AT_A_TIME = 1 << 20  # pairs of a track and a group; 100 MB


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """Motion model of the people of a sequence.

    Attributes:
        speed: () standard deviation of a velocity component, H0 per frame.
        memory: () correlation of the velocity over one frame.
        jitter: () standard deviation of a step that no velocity explains, H0 per frame.
        height_jitter: () the same for the height.
    """

    speed: float
    memory: float
    jitter: float
    height_jitter: float


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trails:
    """Tracks as rows sorted by track, then frame; frames of a track are consecutive.

    Attributes:
        track: (M,) identity.
        frame: (M,) frame index.
        group: (M,) the group of the frame, or -1 in a gap.
        mean: (M, 5) smoothed y1, y2, H, v1, v2 per usual step; NaN for an unknown velocity.
        covariance: (M, 5, 5).
    """

    track: Int[np.ndarray, " node"]
    frame: Int[np.ndarray, " node"]
    group: Int[np.ndarray, " node"]
    mean: Float[np.ndarray, "node 5"]
    covariance: Float[np.ndarray, "node 5 5"]

    def __len__(self) -> int:
        return len(self.track)

    def __getitem__(self, rows) -> "Trails":
        return jax.tree.map(lambda part: part[rows], self)


def estimate_motion(
    position: np.ndarray, frame: np.ndarray, time: np.ndarray, settings: EvidenceSettings
) -> Motion:
    """Estimate the speed from mutual nearest neighbors in consecutive frames.

    Args:
        position: (H, 2) trusted positions in H0.
        frame: (H,) frame index, sorted.
        time: (F,) time of each frame in usual steps.
        settings: constants.
    """
    interrupted = np.diff(time, prepend=time[:1]) > CONSECUTIVE
    number = np.arange(len(time)) + np.cumsum(interrupted)
    return motion_of(counted_steps(position, number[frame], settings), settings)


def sure_groups(
    member: Int[np.ndarray, "group cam"],
    log_odds: Float[np.ndarray, " group"],
    cameras: int,
    settings: EvidenceSettings,
) -> Bool[np.ndarray, " group"]:
    """Mark groups that are certainly people: seen by enough cameras, or by all if there are fewer.

    Args:
        member: boxes of each group, -1 for none.
        log_odds: log-odds of existence.
        cameras: number of cameras that see anybody.
        settings: constants.
    """
    enough = (member >= 0).sum(1) >= min(settings.witnesses, cameras)
    return enough & (log_odds > settings.evidence_limit / 2)


def mutual_steps(
    position: Float[np.ndarray, "n 2"], frame: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "k 2"]:
    """Displacements between mutual nearest neighbors in consecutive frames."""
    if len(frame) == 0:
        return np.zeros((0, 2))
    # Time is the third axis, scaled so that other frames are farther away than any position of this
    # one.
    away = 1 + float(np.ptp(position, axis=0).sum())
    places = np.column_stack([position, away * frame])
    tree, later = KDTree(places), np.array([0, 0, away])
    after, before = (np.asarray(tree.query(places + side * later)[1]) for side in (1, -1))
    first = np.flatnonzero((before[after] == np.arange(len(frame))) & (frame[after] - frame == 1))
    return position[after[first]] - position[first]


def usual_motion(settings: EvidenceSettings) -> Motion:
    """Return the motion model assumed while too little is known about people."""
    return Motion(
        settings.fastest / 2, settings.memory, settings.position_jitter, settings.height_jitter
    )


def counted_steps(
    position: Float[np.ndarray, "n 2"], frame: Int[np.ndarray, " n"], settings: EvidenceSettings
) -> Float[np.ndarray, "2"]:
    """Sum of squares of `mutual_steps` along both axes, each clipped, and their number."""
    step = mutual_steps(position, frame)
    return np.array([np.minimum(step**2, settings.fastest**2).sum(), step.size])


def motion_of(steps: Float[np.ndarray, "2"], settings: EvidenceSettings) -> Motion:
    """Compute the motion model from `counted_steps`."""
    squares, count = steps.tolist()
    usual = usual_motion(settings)
    if count < 2 * settings.fewest_samples:
        return usual
    return replace(usual, speed=within_bounds(float(np.sqrt(squares / count)), settings))


def within_bounds(speed: float, settings: EvidenceSettings) -> float:
    """Clip a speed to where steps stand out from jitter and people can walk."""
    return float(np.clip(speed, settings.position_jitter, settings.fastest))


def transition(motion: Motion, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix (5, 5) and noise (5, 5) of y1, y2, H, v1, v2 over some usual steps."""
    decay = motion.memory**dt
    A = np.eye(5)
    A[0, 3] = A[1, 4] = dt
    A[3, 3] = A[4, 4] = decay
    q = (1 - decay**2) * motion.speed**2
    Q = np.diag([motion.jitter**2 * dt] * 2 + [motion.height_jitter**2 * dt] + [q] * 2)
    for i in (0, 1):
        Q[i, i] += q * dt**2 / 3
        Q[i, i + 3] = Q[i + 3, i] = q * dt / 2
    return A, Q


def distances(
    mean: Float[np.ndarray, "t 2"],
    covariance: Float[np.ndarray, "t 2 2"],
    center: Float[np.ndarray, "k 2"],
    around: Float[np.ndarray, "k 2 2"],
) -> tuple[Float[np.ndarray, "t k"], Float[np.ndarray, "t k"]]:
    """Squared Mahalanobis distances between two sets of uncertain places, and |S| of each."""
    d = mean[:, None] - center[None]
    S = covariance[:, None] + around[None]
    area = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    form = S[..., 1, 1] * d[..., 0] ** 2 + S[..., 0, 0] * d[..., 1] ** 2
    form -= 2 * S[..., 0, 1] * d[..., 0] * d[..., 1]
    return form / area, area


def log_likelihood_of_states(
    mean: Float[np.ndarray, "*#t n"],
    covariance: Float[np.ndarray, "*#t n n"],
    matrix: Float[HostOrDevice, "*#t n n"],
    vector: Float[HostOrDevice, "*#t n"],
) -> Float[np.ndarray, "*#t"]:
    """Log of the mean of exp(-(s' M s - 2 v' s) / 2) over uncertain states s."""
    # With r = v - M m, of the density N(s; m, C): (C⁻¹ + M)⁻¹ r = C (1 + M C)⁻¹ r.
    pull = (matrix @ mean[..., None])[..., 0]
    rest = vector - pull
    loss = np.eye(mean.shape[-1]) + matrix @ covariance
    moved = (covariance @ np.linalg.solve(loss, rest[..., None]))[..., 0]
    form = (rest * moved + (2 * vector - pull) * mean).sum(-1)
    return 0.5 * (form - np.log(np.linalg.det(loss)))


def _link_gain(
    before: Pasts, info: Information, population: "Population"
) -> Float[np.ndarray, "track group"]:
    """Log evidence that a group continues a track rather than starting a new person."""
    density, spread, gate = population.density, population.spread, population.settings.gate
    center, around = mean_and_covariance(info, spread)
    alone = 0.5 * info.constant + log_evidence(info, density, spread)
    block, gains = max(1, LINKS_AT_A_TIME // max(len(center), 1)), []
    for begin in range(0, max(len(before.name), 1), block):
        tracks = before.at(slice(begin, begin + block))
        mean, covariance = tracks.mean[:, :3], tracks.covariance[:, :3, :3]
        m2, _ = distances(mean[:, :2], covariance[:, :2, :2], center[:, :2], around[:, :2, :2])
        i, j = np.nonzero(m2 < gate)
        matrix, vector = info.matrix[j], info.vector[j]
        gain = np.full(m2.shape, -np.inf)
        gain[i, j] = log_likelihood_of_states(mean[i], covariance[i], matrix, vector) - alone[j]
        gains.append(gain)
    return np.concatenate(gains)


class Population(NamedTuple):
    """Quantities common to all tracks of a sequence.

    Attributes:
        time: (F,) time of each frame in usual steps.
        motion: motion model of the people.
        density: people per H0².
        spread: standard deviation of heights in H0.
        settings: constants.
        looks: looks of the groups.
        likeness: compares looks; None if they are uninformative.
    """

    time: Float[np.ndarray, " frame"]
    motion: Motion
    density: float
    spread: float
    settings: EvidenceSettings
    looks: Looks | GroupLooks
    likeness: Likeness | None = None


def follow(groups: Groups, log_odds: np.ndarray, population: Population) -> Trails:
    """Link groups into tracks and smooth them.

    Args:
        groups: sorted by frame.
        log_odds: (H,) log-odds of existence.
        population: the people and their frames.

    Returns:
        All tracks, including gaps but not beyond their first and last group.
    """
    time = population.time
    likely = np.flatnonzero(log_odds > -population.settings.evidence_limit / 2)
    bounds = np.searchsorted(groups.frame[likely], np.arange(len(time) + 1))
    heads = no_pasts(population.looks.dim)
    history, count = [], 0
    for t in range(len(time)):
        rows = likely[bounds[t] : bounds[t + 1]]
        info = groups.info[rows]
        if t:
            heads = predict(heads, *transition(population.motion, float(time[t] - time[t - 1])))
        node, heads, count = link(heads, info, rows, count, population)
        history.append(node)
    return smooth(history, time, population.motion)[0]


class Node(NamedTuple):
    """The tracks of one frame: existing ones, then new ones.

    Attributes:
        track: (T,) number, ascending.
        group: (T,) the group of the frame, or -1 in a gap.
        mean, covariance: (T, 5) and (T, 5, 5) given the frames so far.
    """

    track: Int[np.ndarray, " track"]
    group: Int[np.ndarray, " track"]
    mean: Float[np.ndarray, "track 5"]
    covariance: Float[np.ndarray, "track 5 5"]

    @property
    def trails(self) -> Trails:
        """The tracks as rows of a single frame."""
        frame = np.zeros(len(self.track), np.int64)
        return Trails(self.track, frame, self.group, self.mean, self.covariance)


def link(
    before: Pasts,
    info: Information,
    group: Int[np.ndarray, " k"],
    count: int,
    population: Population,
) -> tuple[Node, Pasts, int]:
    """Assign groups to tracks, update the tracks, and begin new tracks with the other groups.

    Args:
        before: the tracks, predicted for this frame.
        info: (K) information of the groups of this frame.
        group: (K,) their rows in `looks`, as used by `Node.group`.
        count: number of the next track.
        population: common to all tracks.

    Returns:
        The tracks of this frame, those of them to follow further, and the number of the next track.
    """
    settings, looks = population.settings, population.looks.at(group)
    gain = _link_gain(before, info, population) - settings.gap_penalty * before.gap[:, None]
    # Each box of a group counts as a new box.
    gain = gain + compare_looks(before.looks, looks, looks.boxes, population.likeness)
    past = assign(gain)
    is_new = past < 0
    begun = count + np.arange(is_new.sum())
    seen = SeenPositions(info.matrix, info.vector, looks)
    tracks = extend(before, past, begun, seen, population.spread, population.motion.speed)
    linked = np.full(len(tracks.name), -1)
    linked[np.where(is_new, len(before.name) + np.cumsum(is_new) - 1, past)] = group
    node = Node(tracks.name, linked, tracks.mean, tracks.covariance)
    return node, tracks.seen_within(settings.gap), count + len(begun)


def smooth(
    history: Sequence[Node], time: Float[np.ndarray, " frame"], motion: Motion
) -> tuple[Trails, Int[np.ndarray, " node"]]:
    """Rauch-Tung-Striebel smoothing, all tracks of a frame at once.

    Args:
        history: nodes of consecutive frames.
        time: (F,) their times in usual steps.
        motion: the motion model.

    Returns:
        The tracks, each ending with its last group, and the index of each row's node over all
        frames.
    """
    track = np.concatenate([node.track for node in history])
    group = np.concatenate([node.group for node in history])
    first = np.cumsum([0, *(len(node.track) for node in history)])
    frame = np.repeat(np.arange(len(history)), np.diff(first))
    order = np.lexsort((frame, track))
    last_seen = np.full(track.max(initial=-1) + 1, -1)
    np.maximum.at(last_seen, track[group >= 0], frame[group >= 0])
    order = order[frame[order] <= last_seen[track[order]]]
    rows = len(order)
    row_of = np.full(len(track), -1)
    row_of[order] = np.arange(rows)
    trails = Trails(
        track[order], frame[order], group[order], np.empty((rows, 5)), np.empty((rows, 5, 5))
    )
    goes_on = np.append(np.diff(trails.track) == 0, False)
    # Each row except the last of its track is smoothed with the next one, which is already final.
    for t in range(len(history) - 1, -1, -1):
        row = row_of[first[t] : first[t + 1]]
        present = row >= 0
        row = row[present]
        mean, covariance = history[t].mean[present], history[t].covariance[present]
        early = goes_on[row]
        if early.any():
            A, Q = transition(motion, float(time[t + 1] - time[t]))
            predicted = A @ covariance[early] @ A.T + Q
            G = covariance[early] @ A.T @ np.linalg.inv(predicted)
            next_row = row[early] + 1
            more_mean = trails.mean[next_row] - mean[early] @ A.T
            more_cov = trails.covariance[next_row] - predicted
            mean[early] += np.einsum("tij,tj->ti", G, more_mean)
            covariance[early] += G @ more_cov @ G.transpose(0, 2, 1)
        trails.mean[row], trails.covariance[row] = mean, covariance
    return trails, order


def no_trails() -> Trails:
    """Return an empty set of tracks."""
    return unlinked(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def unlinked(frame: np.ndarray, state: np.ndarray, covariance: np.ndarray) -> Trails:
    """Make each group (frame (H,), state (H, 3), covariance (H, 3, 3)) a track without velocity."""
    number = np.arange(len(frame))
    mean, around = np.full((len(frame), 5), np.nan), np.full((len(frame), 5, 5), np.nan)
    mean[:, :3], around[:, :3, :3] = state, covariance
    return Trails(number, frame, number, mean, around)
