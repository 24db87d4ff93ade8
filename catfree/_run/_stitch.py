"""Join fragments of one person's track across gaps by appearance and motion.

All parameters are learned from the sequence: the appearance distance between the two halves of a
track and between people present at the same time, and the displacement per number of frames.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from catfree.types import Detections, Localization, Tracks

LEAST_PAIRS = 8  # of each kind of pair needed to use appearance
EVIDENCE_LIMIT = 8.0  # log-odds: appearance never claims less than one error in three thousand


class Pieces(eqx.Module):
    """Track fragments before they are joined, in order of identity.

    Attributes:
        identity: (K,) track ids.
        first: (K,) first frame.
        last: (K,) last frame.
        begin: (K, 2) first position.
        end: (K, 2) last position.
        begin_sigma: (K,) uncertainty of the first position.
        end_sigma: (K,) uncertainty of the last position.
        looks: (K, D) mean unit embedding, zero without any box.
        halves: (K, 2, D) the same for the earlier and the later half.
    """

    identity: Int[np.ndarray, " k"]
    first: Int[np.ndarray, " k"]
    last: Int[np.ndarray, " k"]
    begin: Float[np.ndarray, "k 2"]
    end: Float[np.ndarray, "k 2"]
    begin_sigma: Float[np.ndarray, " k"]
    end_sigma: Float[np.ndarray, " k"]
    looks: Float[np.ndarray, "k d"]
    halves: Float[np.ndarray, "k 2 d"]

    def __len__(self) -> int:
        return len(self.identity)


def stitch_tracks(localization: Localization, detections: Detections) -> Localization:
    """Give the fragments of each person one identity.

    Args:
        localization: the result of a method.
        detections: the detections that it was made from; without embeddings only motion is used.

    Returns:
        The same result with joined identities; of two fragments that overlap for a few frames, the
        earlier one ends where the later one begins.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    localization.require_detections(detections)
    tracks = localization.tracks
    if len(np.unique(tracks.track_id)) < 2:
        return localization
    pieces = collect_pieces(tracks, detections, localization.identity)
    follower = link_pieces(pieces, tracks)
    return eqx.tree_at(lambda result: result.tracks, localization, join(tracks, pieces, follower))


def collect_pieces(tracks: Tracks, detections: Detections, shown: Int[np.ndarray, " n"]) -> Pieces:
    """Collect start, end and appearance of each track.

    Args:
        tracks: positions sorted by frame.
        detections: person boxes.
        shown: (N,) track id of each box, or -1.
    """
    identity = np.unique(tracks.track_id)
    rows = [np.flatnonzero(tracks.track_id == one) for one in identity]
    looks, halves = [], []
    embedding = detections.embedding
    for one, track_rows in zip(identity, rows, strict=True):
        if embedding is None:
            looks.append(np.zeros(1))
            halves.append(np.zeros((2, 1)))
            continue
        boxes = np.flatnonzero(shown == one)
        middle = np.median(tracks.frame[track_rows])
        early = detections.frame[boxes] < middle
        looks.append(_mean_look(embedding[boxes]))
        halves.append([_mean_look(embedding[boxes[early]]), _mean_look(embedding[boxes[~early]])])
    return Pieces(
        identity=identity,
        first=np.array([tracks.frame[own[0]] for own in rows]),
        last=np.array([tracks.frame[own[-1]] for own in rows]),
        begin=np.array([tracks.ground_xy[own[0]] for own in rows]),
        end=np.array([tracks.ground_xy[own[-1]] for own in rows]),
        begin_sigma=np.array([tracks.sigma[own[0]] for own in rows]),
        end_sigma=np.array([tracks.sigma[own[-1]] for own in rows]),
        looks=np.array(looks, np.float64),
        halves=np.array(halves, np.float64),
    )


def link_pieces(pieces: Pieces, tracks: Tracks) -> Int[np.ndarray, " k"]:
    """Find the fragment that continues each one, or -1.

    The log-odds of a link compare "the same person" with "a new person": the likelihood of the
    later start given the earlier end, against the density of starts anywhere, and the similarity of
    appearance. A one-to-one assignment maximizes the sum of the log-odds.

    Args:
        pieces: the fragments.
        tracks: the positions that they consist of.
    """
    gap = pieces.first[None, :] - pieces.last[:, None]
    length = pieces.last - pieces.first + 1
    shorter = np.minimum(length[:, None], length[None, :])
    # Short overlaps occur where one fragment ends after the next has begun.
    possible = (gap > -0.5 * shorter) & (pieces.first[None, :] > pieces.first[:, None])
    np.fill_diagonal(possible, False)
    odds = _motion_odds(pieces, tracks, np.maximum(gap, 1)) + _look_odds(pieces)
    odds = np.where(possible, odds, -np.inf)
    before, after = linear_sum_assignment(-np.maximum(odds, 0))
    follower = np.full(len(pieces), -1)
    good = odds[before, after] > 0
    follower[before[good]] = after[good]
    return follower


def join(tracks: Tracks, pieces: Pieces, follower: Int[np.ndarray, " k"]) -> Tracks:
    """Give the fragments of each chain one identity, numbered as by `Tracks.renumbered`.

    Args:
        tracks: the positions.
        pieces: the fragments that they consist of.
        follower: (K,) the result of `link_pieces`.
    """
    chain = np.arange(len(pieces))
    keep = np.ones(len(tracks), bool)
    at = np.searchsorted(pieces.identity, tracks.track_id)
    for piece in np.argsort(pieces.first, kind="stable"):
        after = follower[piece]
        if after >= 0:
            chain[after] = chain[piece]
            keep &= ~((at == piece) & (tracks.frame >= pieces.first[after]))
    return eqx.tree_at(lambda table: table.track_id, tracks, chain[at])[keep].renumbered()


def _motion_odds(
    pieces: Pieces, tracks: Tracks, gap: Int[np.ndarray, "k k"]
) -> Float[np.ndarray, "k k"]:
    """Log-odds of a link by the end and start positions."""
    spread = squared_displacement(tracks)
    variance = spread[np.minimum(gap, len(spread) - 1)]
    # Beyond the longest observed lag the variance grows linearly with time, as in a random walk.
    variance = variance * np.maximum(gap / (len(spread) - 1), 1)
    # Tracks break where the person was poorly visible, which sigma quantifies.
    variance = variance + pieces.end_sigma[:, None] ** 2 + pieces.begin_sigma[None, :] ** 2
    square = ((pieces.begin[None, :] - pieces.end[:, None]) ** 2).sum(-1)
    frames = int(tracks.frame.max() - tracks.frame.min()) + 1
    area = np.prod(np.maximum(np.ptp(tracks.ground_xy, axis=0), 1e-12))
    begins = len(pieces) / (frames * area)
    continued = -np.log(2 * np.pi * variance) - square / (2 * variance) - np.log(frames)
    return continued - np.log(begins)


def squared_displacement(tracks: Tracks) -> Float[np.ndarray, " lag"]:
    """Compute the mean squared displacement per coordinate for each number of frames.

    Args:
        tracks: positions with identities.

    Returns:
        (L,) scene units squared; entry 0 repeats that of one frame.
    """
    total, count = np.zeros(len(tracks) + 2), np.zeros(len(tracks) + 2)
    for one in np.unique(tracks.track_id):
        is_member = tracks.track_id == one
        frame, place = tracks.frame[is_member], tracks.ground_xy[is_member]
        for step in range(1, len(frame)):
            lag = frame[step:] - frame[:-step]
            square = ((place[step:] - place[:-step]) ** 2).mean(-1)
            usable = lag < len(total)
            np.add.at(total, lag[usable], square[usable])
            np.add.at(count, lag[usable], 1)
    enough = np.flatnonzero(count >= LEAST_PAIRS)
    longest = int(enough.max()) if len(enough) else 1
    mean = total[: longest + 1] / np.maximum(count[: longest + 1], 1)
    # Displacement does not decrease with the lag, and no position is exact.
    floor = float(np.median(tracks.sigma**2)) + 1e-12
    mean = np.maximum.accumulate(np.maximum(mean, floor))
    mean[0] = mean[min(1, longest)]
    return mean


def _look_odds(pieces: Pieces) -> Float[np.ndarray, "k k"]:
    """Log-odds of a link by appearance, linear in the logarithm of the embedding distance."""
    distance = _distances(pieces.looks, pieces.looks)
    known = (pieces.looks**2).sum(-1) > 0
    neutral = np.zeros((len(pieces), len(pieces)))
    together = (pieces.first[:, None] <= pieces.last[None, :]) & (
        pieces.first[None, :] <= pieces.last[:, None]
    )
    others = distance[np.triu(together & known[:, None] & known[None, :], 1)]
    halved = ((pieces.halves**2).sum(-1) > 0).all(-1)
    within = 1 - (pieces.halves[halved, 0] * pieces.halves[halved, 1]).sum(-1)
    if min(len(within), len(others)) < LEAST_PAIRS:
        return neutral
    same, other = np.log(np.maximum(within, 1e-6)), np.log(np.maximum(others, 1e-6))
    # With one variance for both, the odds decrease monotonically with the distance.
    variance = max((same.var() + other.var()) / 2, 1e-6)
    slope = (same.mean() - other.mean()) / variance
    if slope >= 0:
        return neutral
    odds = slope * (np.log(np.maximum(distance, 1e-6)) - (same.mean() + other.mean()) / 2)
    odds = np.clip(odds, -EVIDENCE_LIMIT, EVIDENCE_LIMIT)
    return np.where(known[:, None] & known[None, :], odds, 0.0)


def _distances(
    one: Float[np.ndarray, "a d"], two: Float[np.ndarray, "b d"]
) -> Float[np.ndarray, "a b"]:
    return np.clip(1 - one @ two.T, 0, 2)


def _mean_look(embedding: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
    """Normalized median embedding, robust against boxes that also show another person."""
    if len(embedding) == 0:
        return np.zeros(embedding.shape[1])
    middle = np.median(embedding.astype(np.float64), axis=0)
    return middle / max(float(np.linalg.norm(middle)), 1e-12)
