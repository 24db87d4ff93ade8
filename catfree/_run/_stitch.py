"""Join fragments of one person's track across gaps by appearance and motion.

All parameters are learned from the sequence: the appearance distance between the two halves of a
track and between people present at the same time, and the displacement per number of frames.
Everything learned is a sum over fragments, so long recordings can be learned in parts.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from catfree.types import Detections, Localization, Tracks
from catfree.types._sampling import expand_ranges

LEAST_PAIRS = 8  # number of each kind of pair needed to use appearance
EVIDENCE_LIMIT = 8.0  # log-odds: appearance never claims less than one error in three thousand
PAIRS_AT_A_TIME = 1 << 20  # 200 MB


class Fragments(eqx.Module):
    """Track fragments before they are joined, in order of identity.

    Attributes:
        identity: (K,) track ids.
        first: (K,) first frame.
        last: (K,) last frame.
        begin: (K, 2) first position.
        end: (K, 2) last position.
        begin_sigma: (K,) uncertainty of the first position.
        end_sigma: (K,) uncertainty of the last position.
        boxes: (K,) number of boxes with an embedding.
        looks: (K, D) normalized median embedding, zero without boxes.
    """

    identity: Int[np.ndarray, " k"]
    first: Int[np.ndarray, " k"]
    last: Int[np.ndarray, " k"]
    begin: Float[np.ndarray, "k 2"]
    end: Float[np.ndarray, "k 2"]
    begin_sigma: Float[np.ndarray, " k"]
    end_sigma: Float[np.ndarray, " k"]
    boxes: Int[np.ndarray, " k"]
    looks: Float[np.ndarray, "k d"]

    def __len__(self) -> int:
        return len(self.identity)


class Habits(eqx.Module):
    """Statistics of motion and appearance of a recording, as sums that add up over its parts.

    Attributes:
        square: (L,) sums of squared displacements per coordinate, by number of frames.
        pairs: (L,) numbers of displacements, by number of frames.
        variance: () sum over parts of positions times their median squared sigma.
        rows: () number of positions.
        low: (2,) smallest ground coordinates.
        high: (2,) largest ground coordinates.
        frames: () number of frames.
        longest: () number of frames of the longest part.
        fragments: () number of fragments.
        alike: (3,) number, sum and sum of squares of the logarithms of the appearance distance
            between the halves of a fragment.
        unlike: (3,) the same, between fragments present at the same time.
    """

    square: Float[np.ndarray, " lag"]
    pairs: Float[np.ndarray, " lag"]
    variance: float
    rows: int
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    frames: int
    longest: int
    fragments: int
    alike: Float[np.ndarray, "3"]
    unlike: Float[np.ndarray, "3"]


def stitch_tracks(localization: Localization, detections: Detections) -> Localization:
    """Give the fragments of each person one identity.

    Args:
        localization: the result of a method.
        detections: the localized detections; without embeddings, only motion is used.

    Returns:
        The same result with joined identities. Where fragments overlap for a few frames, the
        earlier one ends where the later one begins.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    localization.require_detections(detections)
    tracks = localization.tracks
    fragments, habits = learn_fragments(tracks, detections, localization.identity)
    chain, stop = link_fragments(fragments, habits)
    at = np.searchsorted(fragments.identity, tracks.track_id)
    joined = eqx.tree_at(lambda table: table.track_id, tracks, chain[at])
    joined = joined[tracks.frame < stop[at]].renumbered()
    return eqx.tree_at(lambda result: result.tracks, localization, joined)


def learn_fragments(
    tracks: Tracks, detections: Detections, shown: Int[np.ndarray, " n"]
) -> tuple[Fragments, Habits]:
    """Collect start, end and appearance of each track, and the habits of the tracks.

    Args:
        tracks: positions of one part of a recording, sorted by frame.
        detections: person boxes.
        shown: (N,) track id of each box, or -1.
    """
    identity = np.unique(tracks.track_id)
    rows = [np.flatnonzero(tracks.track_id == track) for track in identity]
    boxes, looks, halves = [], [], []
    embedding = detections.embedding
    if embedding is None:
        embedding, shown = np.zeros((len(shown), 1)), np.full_like(shown, -1)
    width = embedding.shape[1]
    for track, track_rows in zip(identity, rows, strict=True):
        members = np.flatnonzero(shown == track)
        middle = np.median(tracks.frame[track_rows])
        early = detections.frame[members] < middle
        boxes.append(len(members))
        looks.append(_mean_look(embedding[members]))
        parts = (members[early], members[~early])
        halves.append([_mean_look(embedding[part]) for part in parts])
    first, last = ([member_rows[end] for member_rows in rows] for end in (0, -1))
    fragments = Fragments(
        identity=identity,
        first=tracks.frame[first],
        last=tracks.frame[last],
        begin=tracks.ground_xy[first],
        end=tracks.ground_xy[last],
        begin_sigma=tracks.sigma[first],
        end_sigma=tracks.sigma[last],
        boxes=np.array(boxes, np.int64),
        looks=np.array(looks, np.float64).reshape(len(identity), width),
    )
    square, pairs = squared_displacement(tracks)
    any_row = len(tracks) > 0
    frames = int(tracks.frame.max() - tracks.frame.min()) + 1 if any_row else 0
    alike, unlike = _look_distances(
        fragments, np.array(halves, np.float64).reshape(len(identity), 2, width)
    )
    habits = Habits(
        square=square,
        pairs=pairs,
        variance=len(tracks) * float(np.median(tracks.sigma**2)) if any_row else 0.0,
        rows=len(tracks),
        low=tracks.ground_xy.min(0, initial=np.inf),
        high=tracks.ground_xy.max(0, initial=-np.inf),
        frames=frames,
        longest=frames,
        fragments=len(fragments),
        alike=_moments(alike),
        unlike=_moments(unlike),
    )
    return fragments, habits


def add_habits(parts: Sequence[Habits]) -> Habits:
    """Add up the habits of the parts of a recording.

    Args:
        parts: at least one.
    """

    def total(lags: list[np.ndarray]) -> np.ndarray:
        length = max(map(len, lags))
        return np.sum([np.pad(lag, (0, length - len(lag))) for lag in lags], axis=0)

    return Habits(
        square=total([part.square for part in parts]),
        pairs=total([part.pairs for part in parts]),
        variance=sum(part.variance for part in parts),
        rows=sum(part.rows for part in parts),
        low=np.min([part.low for part in parts], axis=0),
        high=np.max([part.high for part in parts], axis=0),
        frames=sum(part.frames for part in parts),
        longest=max(part.longest for part in parts),
        fragments=sum(part.fragments for part in parts),
        alike=np.sum([part.alike for part in parts], axis=0),
        unlike=np.sum([part.unlike for part in parts], axis=0),
    )


def link_fragments(
    fragments: Fragments, habits: Habits
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Link each person's fragments to a chain.

    The log-odds of a link compare "the same person" with "a new person": the likelihood of the
    later start given the earlier end, against the density of starts anywhere, and the similarity of
    appearance. A one-to-one assignment maximizes the sum of the log-odds.

    Args:
        fragments: the fragments.
        habits: the habits of their recording.

    Returns:
        (K,) first fragment of each fragment's chain, and (K,) the frame before which the fragment
        ends because its follower begins there.
    """
    chain = np.arange(len(fragments))
    stop = np.full(len(fragments), np.iinfo(np.int64).max)
    if len(fragments) < 2:
        return chain, stop
    spread = displacement_variance(habits)
    by_start = np.argsort(fragments.first, kind="stable")
    starts = fragments.first[by_start]
    reach = _longest_gap(fragments, habits, spread)
    low = np.searchsorted(starts, fragments.first, side="right")
    high = np.searchsorted(starts, fragments.last + reach, side="right")
    earlier, later, odds = [], [], []
    for block in _blocks(np.maximum(high - low, 0)):
        row, start_rank = expand_ranges(low[block], high[block])
        one, two = block[row], by_start[start_rank]
        gap = fragments.first[two] - fragments.last[one]
        length = fragments.last - fragments.first + 1
        # Short overlaps occur where one fragment ends after the next has begun.
        possible = gap > -0.5 * np.minimum(length[one], length[two])
        one, two = one[possible], two[possible]
        value = _motion_odds(fragments, one, two, habits, spread) + _look_odds(
            fragments, one, two, habits
        )
        likely = value > 0
        earlier.append(one[likely])
        later.append(two[likely])
        odds.append(value[likely])
    one, two, value = map(np.concatenate, (earlier, later, odds))
    before, after = best_assignment(one, two, value, len(fragments))
    stop[before] = fragments.first[after]
    in_time = np.argsort(fragments.first[before], kind="stable")
    for fragment, follower in zip(before[in_time], after[in_time], strict=True):
        chain[follower] = chain[fragment]
    return chain, stop


def best_assignment(
    one: Int[np.ndarray, " p"],
    two: Int[np.ndarray, " p"],
    gain: Float[np.ndarray, " p"],
    count: int,
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Choose pairs, each index at most once per side, that maximize the sum of gains.

    Args:
        one: (P,) first index of each possible pair.
        two: (P,) second index.
        gain: (P,) positive gains.
        count: number of indices on either side.

    Returns:
        The two indices of each chosen pair, in order of the first.
    """
    # Each index may instead stay alone. Adding one to every edge changes no choice.
    alone = np.arange(count)
    ends = (np.concatenate([one, alone]), np.concatenate([two, count + alone]))
    edges = coo_array((np.concatenate([1 + gain, np.ones(count)]), ends), shape=(count, 2 * count))
    before, after = min_weight_full_bipartite_matching(edges, maximize=True)
    paired = after < count
    return before[paired], after[paired]


def squared_displacement(
    tracks: Tracks,
) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]:
    """Sum the squared displacement per coordinate for each number of frames.

    Args:
        tracks: positions with identities.

    Returns:
        (L,) sums in scene units squared, and (L,) numbers of displacements; entry 0 is unused.
    """
    longer = len(tracks) + 2  # longer lags are counted together and left out
    total, count = np.zeros(longer + 1), np.zeros(longer + 1)
    for track in np.unique(tracks.track_id):
        is_member = tracks.track_id == track
        frame, (x, y) = tracks.frame[is_member], tracks.ground_xy[is_member].T.copy()
        for step in range(1, len(frame)):
            lag = np.minimum(frame[step:] - frame[:-step], longer)
            square = (x[step:] - x[:-step]) ** 2 + (y[step:] - y[:-step]) ** 2
            np.add.at(total, lag, square / 2)
            np.add.at(count, lag, 1)
    return total[:-1], count[:-1]


def displacement_variance(habits: Habits) -> Float[np.ndarray, " lag"]:
    """Compute the variance per coordinate of the displacement for each number of frames.

    Args:
        habits: the habits of the recording.

    Returns:
        (L,) scene units squared; entry 0 repeats the value for one frame.
    """
    enough = np.flatnonzero(habits.pairs >= LEAST_PAIRS)
    longest = int(enough.max()) if len(enough) else 1
    mean = habits.square[: longest + 1] / np.maximum(habits.pairs[: longest + 1], 1)
    # Displacement does not decrease with the lag, and no position is exact.
    floor = habits.variance / max(habits.rows, 1) + 1e-12
    mean = np.maximum.accumulate(np.maximum(mean, floor))
    mean[0] = mean[min(1, longest)]
    return mean


def _spread_after(
    gap: Int[np.ndarray, " p"], spread: Float[np.ndarray, " lag"]
) -> Float[np.ndarray, " p"]:
    gap = np.maximum(gap, 1)
    variance = spread[np.minimum(gap, len(spread) - 1)]
    # Beyond the longest observed lag the variance grows linearly with time, as in a random walk.
    return variance * np.maximum(gap / (len(spread) - 1), 1)


def _density(habits: Habits) -> float:
    """Compute the density of starts of fragments per frame and squared scene unit."""
    area = np.prod(np.maximum(habits.high - habits.low, 1e-12))
    return float(habits.fragments / (habits.frames * area))


def _motion_odds(
    fragments: Fragments,
    one: Int[np.ndarray, " p"],
    two: Int[np.ndarray, " p"],
    habits: Habits,
    spread: Float[np.ndarray, " lag"],
) -> Float[np.ndarray, " p"]:
    """Compute the log-odds of links from end and start positions."""
    variance = _spread_after(fragments.first[two] - fragments.last[one], spread)
    # Tracks break where the person was hardly visible, as sigma shows.
    variance = variance + fragments.end_sigma[one] ** 2 + fragments.begin_sigma[two] ** 2
    square = ((fragments.begin[two] - fragments.end[one]) ** 2).sum(-1)
    # A person may reappear at any time within the longest part.
    continued = -np.log(2 * np.pi * variance) - square / (2 * variance) - np.log(habits.longest)
    return continued - np.log(_density(habits))


def _longest_gap(fragments: Fragments, habits: Habits, spread: Float[np.ndarray, " lag"]) -> int:
    """Find the number of frames beyond which no fragments are joined, however alike they look."""
    widest = np.exp(EVIDENCE_LIMIT) / (2 * np.pi * habits.longest * _density(habits))
    if widest <= spread[-1]:
        return int(np.searchsorted(spread, widest))
    return int(min(widest / spread[-1] * (len(spread) - 1), np.ptp(fragments.first))) + 1


def _look_odds(
    fragments: Fragments, one: Int[np.ndarray, " p"], two: Int[np.ndarray, " p"], habits: Habits
) -> Float[np.ndarray, " p"]:
    """Compute the log-odds of links from appearance, linear in the log embedding distance."""
    neutral = np.zeros(len(one))
    if min(habits.alike[0], habits.unlike[0]) < LEAST_PAIRS:
        return neutral
    (same, same_variance), (other, other_variance) = map(
        _mean_and_variance, (habits.alike, habits.unlike)
    )
    # With a common variance, the odds decrease monotonically with the distance.
    slope = (same - other) / max((same_variance + other_variance) / 2, 1e-6)
    if slope >= 0:
        return neutral
    distance = _log_distance(np.einsum("pd,pd->p", fragments.looks[one], fragments.looks[two]))
    odds = slope * (distance - (same + other) / 2)
    known = (fragments.boxes[one] > 0) & (fragments.boxes[two] > 0)
    return np.where(known, np.clip(odds, -EVIDENCE_LIMIT, EVIDENCE_LIMIT), 0.0)


def _look_distances(
    fragments: Fragments, halves: Float[np.ndarray, "k 2 d"]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute log distances between halves of a fragment and between simultaneous fragments."""
    halved = ((halves**2).sum(-1) > 0).all(-1)
    alike = (halves[halved, 0] * halves[halved, 1]).sum(-1)
    known = np.flatnonzero(fragments.boxes > 0)
    looks, first, last = fragments.looks[known], fragments.first[known], fragments.last[known]
    together = (first[:, None] <= last[None, :]) & (first[None, :] <= last[:, None])
    unlike = (looks @ looks.T)[np.triu(together, 1)]
    return _log_distance(alike), _log_distance(unlike)


def _log_distance(cosine: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    return np.log(np.clip(1 - cosine, 1e-6, 2))


def _moments(value: Float[np.ndarray, " p"]) -> Float[np.ndarray, "3"]:
    return np.array([len(value), value.sum(), (value**2).sum()])


def _mean_and_variance(moments: Float[np.ndarray, "3"]) -> tuple[float, float]:
    count, total, square = moments
    return total / count, max(square / count - (total / count) ** 2, 0.0)


def _blocks(count: Int[np.ndarray, " k"]) -> list[Int[np.ndarray, " b"]]:
    """Split indices into groups of consecutive ones with a bounded sum of counts."""
    block = np.cumsum(count) // PAIRS_AT_A_TIME
    return np.split(np.arange(len(count)), np.flatnonzero(np.diff(block)) + 1)


def _mean_look(embedding: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
    """Compute the normalized median embedding, which is robust to boxes with another person."""
    if len(embedding) == 0:
        return np.zeros(embedding.shape[1])
    middle = np.median(embedding.astype(np.float64), axis=0)
    return middle / max(float(np.linalg.norm(middle)), 1e-12)
