"""Link groups over time: Kalman filter, assignment by evidence, smoothing."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from catfree.methods.evidence._gaussian import (
    Information,
    determinant_and_form,
    log_evidence,
    mean_and_covariance,
)
from catfree.methods.evidence.group._appearance import Looks
from catfree.methods.evidence.group._groups import Groups
from catfree.settings import EvidenceSettings

JITTER = 0.03  # H0 per frame: steps and sway not explained by a velocity
HEIGHT_JITTER = 0.005  # H0 per frame: people bend and straighten
USUAL_SPEED = 0.4  # H0 per frame and axis, without enough data: strolling at 2 frames per second
MEMORY = 0.85  # correlation of the velocity over one frame: people turn within a few steps
SPEED_RANGE = (
    0.05,
    1.0,
)  # H0 per frame: standing at video rate, walking fast at 2 frames per second
CONSECUTIVE = 1.5  # usual steps: frames farther apart are not used for the speed
LINKS_AT_A_TIME = 1 << 18  # pairs of a track and a group: 100 MB
FEWEST_STEPS = 10  # below which USUAL_SPEED is assumed


class Motion(eqx.Module):
    """Motion model of the people of a sequence.

    Attributes:
        speed: () standard deviation of a velocity component, H0 per frame.
        memory: () correlation of the velocity over one frame.
    """

    speed: float
    memory: float


class Trails(eqx.Module):
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
        return Trails(
            self.track[rows], self.frame[rows], self.group[rows], self.mean[rows],
            self.covariance[rows],
        )  # fmt: skip


def estimate_motion(position: np.ndarray, frame: np.ndarray, time: np.ndarray) -> Motion:
    """Estimate the speed from mutual nearest neighbors in consecutive frames.

    Args:
        position: (H, 2) trusted positions in H0.
        frame: (H,) frame index, sorted.
        time: (F,) time of each frame in usual steps.
    """
    steps = []
    bounds = np.searchsorted(frame, np.arange(len(time) + 1))
    for t in range(len(time) - 1):
        a, b = position[bounds[t] : bounds[t + 1]], position[bounds[t + 1] : bounds[t + 2]]
        if len(a) == 0 or len(b) == 0 or time[t + 1] - time[t] > CONSECUTIVE:
            continue
        _, ab = KDTree(b).query(a)
        _, ba = KDTree(a).query(b)
        mutual = np.asarray(ba)[ab] == np.arange(len(a))
        steps.append((b[ab] - a)[mutual])
    if not steps or sum(map(len, steps)) < FEWEST_STEPS:
        return Motion(USUAL_SPEED, MEMORY)
    step = np.concatenate(steps)
    speed = np.sqrt(np.mean(np.minimum(step**2, SPEED_RANGE[1] ** 2)))
    return Motion(float(np.clip(speed, *SPEED_RANGE)), MEMORY)


def transition(motion: Motion, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (5, 5) and noise (5, 5) of y1, y2, H, v1, v2 over some usual steps."""
    decay = motion.memory**dt
    A = np.eye(5)
    A[0, 3] = A[1, 4] = dt
    A[3, 3] = A[4, 4] = decay
    q = (1 - decay**2) * motion.speed**2
    Q = np.diag([JITTER**2 * dt] * 2 + [HEIGHT_JITTER**2 * dt] + [q] * 2)
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


def _link_gain(mean, covariance, info: Information, alone, center, around, gate):
    """(T, K) log evidence that a group continues a track rather than being a new person.

    `alone` (K,), `center` (K, 3) and `around` (K, 3, 3) are what each group says without a track.
    """
    precision = np.linalg.inv(covariance)
    pull = np.einsum("tij,tj->ti", precision, mean)
    matrix = precision[:, None] + info.matrix[None]
    vector = pull[:, None] + info.vector[None]
    det, form = determinant_and_form(matrix, vector)
    prior_det = np.linalg.det(precision)
    prior_form = np.einsum("ti,ti->t", mean, pull)
    value = (
        0.5 * np.log(prior_det)[:, None]
        - 0.5 * np.log(det)
        - 0.5 * (prior_form[:, None] + info.constant[None] - form)
    )
    gain = value - alone[None]
    m2, _ = distances(mean[:, :2], covariance[:, :2, :2], center[:, :2], around[:, :2, :2])
    return np.where(m2 < gate, gain, -np.inf)


def follow(
    groups: Groups,
    log_odds: np.ndarray,
    time: np.ndarray,
    motion: Motion,
    density: float,
    spread: float,
    settings: EvidenceSettings,
    looks: Looks | None = None,
) -> Trails:
    """Link groups into tracks and smooth them.

    Args:
        groups: sorted by frame.
        log_odds: (H,) of existence.
        time: (F,) time of each frame in usual steps.
        motion: the motion model.
        density: people per H0².
        spread: of heights in H0.
        settings: constants.
        looks: appearance of the groups, if available.

    Returns:
        All tracks, including gaps but not beyond their first and last group.
    """
    bounds = np.searchsorted(groups.frame, np.arange(len(time) + 1))
    mean, cov = np.zeros((0, 5)), np.zeros((0, 5, 5))
    track, gap = np.zeros(0, int), np.zeros(0, int)
    look, boxes = np.zeros((0, 0)), np.zeros(0, int)  # sum and number of each track's embeddings
    if looks is not None:
        look, boxes = looks.total[:0], looks.count[:0]
    count = 0
    history = []
    alone = log_evidence(groups.info, density, spread)
    center, around = mean_and_covariance(groups.info, spread)
    for t in range(len(time)):
        if t:
            A, Q = transition(motion, float(time[t] - time[t - 1]))
            mean, cov = mean @ A.T, A @ cov @ A.T + Q
        predicted = (mean, cov)
        candidates = np.arange(bounds[t], bounds[t + 1])
        candidates = candidates[log_odds[candidates] > -settings.evidence_limit / 2]
        info = groups.info[candidates]
        assigned = np.full(len(track), -1)
        if len(track) and len(candidates):
            step = max(1, LINKS_AT_A_TIME // len(candidates))
            gain = np.concatenate([
                _link_gain(
                    mean[i : i + step, :3], cov[i : i + step, :3, :3], info,
                    alone[candidates], center[candidates], around[candidates], settings.gate,
                )
                for i in range(0, len(track), step)
            ])  # fmt: skip
            gain = gain - settings.gap_penalty * gap[:, None]
            if looks is not None:
                gain = gain + looks.ratio(look, boxes, candidates)
            rows, columns = linear_sum_assignment(-np.maximum(gain, 0))
            good = gain[rows, columns] > 0
            assigned[rows[good]] = columns[good]
        hit = np.flatnonzero(assigned >= 0)
        if len(hit):
            precision = np.linalg.inv(cov[hit])
            vector = np.einsum("tij,tj->ti", precision, mean[hit])
            precision[:, :3, :3] += info.matrix[assigned[hit]]
            vector[:, :3] += info.vector[assigned[hit]]
            mean, cov = mean.copy(), cov.copy()
            cov[hit] = np.linalg.inv(precision)
            mean[hit] = np.einsum("tij,tj->ti", cov[hit], vector)
        gap = np.where(assigned >= 0, 0, gap + 1)
        fresh = np.setdiff1d(np.arange(len(candidates)), assigned)
        first = candidates[fresh]
        new_mean = np.pad(center[first], ((0, 0), (0, 2)))
        new_cov = np.zeros((len(fresh), 5, 5))
        new_cov[:, :3, :3] = around[first]
        new_cov[:, 3, 3] = new_cov[:, 4, 4] = motion.speed**2
        linked = candidates[assigned] if len(candidates) else -1
        linked = np.where(assigned >= 0, linked, -1)
        group = np.concatenate([linked, candidates[fresh]]).astype(int)
        mean, cov = np.concatenate([mean, new_mean]), np.concatenate([cov, new_cov])
        track = np.concatenate([track, count + np.arange(len(fresh))])
        gap = np.concatenate([gap, np.zeros(len(fresh), int)])
        count += len(fresh)
        alive = gap <= settings.gap
        if looks is not None:
            look[hit] += looks.total[candidates[assigned[hit]]]
            boxes[hit] += looks.count[candidates[assigned[hit]]]
            look = np.concatenate([look, looks.total[candidates[fresh]]])[alive]
            boxes = np.concatenate([boxes, looks.count[candidates[fresh]]])[alive]
        predicted = (
            np.concatenate([predicted[0], new_mean]),
            np.concatenate([predicted[1], new_cov]),
        )
        history.append((track, group, mean, cov, *predicted))
        mean, cov, track, gap = mean[alive], cov[alive], track[alive], gap[alive]
    return _smooth(history, time, motion)


def _smooth(history, time, motion: Motion) -> Trails:
    """Rauch-Tung-Striebel smoothing, all tracks of a frame at once."""
    last = {}
    rows = []
    later = None
    for t in range(len(history) - 1, -1, -1):
        track, group, mean, cov, _, _ = history[t]
        mean, cov = mean.copy(), cov.copy()
        if later is not None:
            A, _ = transition(motion, float(time[t + 1] - time[t]))
            next_track, next_mean, next_cov = later
            _, rows_now, rows_next = np.intersect1d(track, next_track, return_indices=True)
            if len(rows_now):
                ntrack, _, _, _, pm, pc = history[t + 1]
                at = np.searchsorted(ntrack, track[rows_now])
                G = cov[rows_now] @ A.T @ np.linalg.inv(pc[at])
                mean[rows_now] += np.einsum("tij,tj->ti", G, next_mean[rows_next] - pm[at])
                cov[rows_now] += G @ (next_cov[rows_next] - pc[at]) @ G.transpose(0, 2, 1)
        keep = group >= 0
        for i in np.flatnonzero(keep):
            last.setdefault(track[i], t)
        keep |= np.array([last.get(k, -1) > t for k in track], bool)
        rows.append((track[keep], np.full(keep.sum(), t), group[keep], mean[keep], cov[keep]))
        later = (track[keep], mean[keep], cov[keep])
    columns = [np.concatenate(x) for x in zip(*rows, strict=True)]
    order = np.lexsort((columns[1], columns[0]))
    return Trails(*(x[order] for x in columns))


def unlinked(frame: np.ndarray, state: np.ndarray, covariance: np.ndarray) -> Trails:
    """Every group (frame (H,), state (H, 3), covariance (H, 3, 3)) as a track without velocity."""
    number = np.arange(len(frame))
    mean, around = np.full((len(frame), 5), np.nan), np.full((len(frame), 5, 5), np.nan)
    mean[:, :3], around[:, :3, :3] = state, covariance
    return Trails(number, frame, number, mean, around)
