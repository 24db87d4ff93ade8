"""Placement of a camera by voting, so that it sees the same people as another camera or a rig.

Two metric ground maps differ by a heading and a translation. Every pair of boxes of one instant
votes for all placements that would make them one person. The true placement collects one vote per
person seen by both cameras; chance votes are spread thinly. Two standing people vote for the same
placements at every instant: the longer both stay, the less each of these votes weighs.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import maximum_filter

from catfree.calibration.people.cameras._camera_model import PAN, X, Z
from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.settings import CalibrationSettings

FINER = 4  # narrow bins per bin
SHARPENED = 2  # bins around a placement where narrow bins vote: those blurred into it
NEAR_BINS = 2.5  # bins of the vote; nearer placements count as one
VOTES_AT_A_TIME = 2**16  # fits a cache
LONGEST_ABSENCE = 3  # voting frames; after more, a pair in the same places is a new stay
CANDIDATES = 4  # placements of a vote to compare by their evidence
NEAREST_PEOPLE = 24  # people per frame that vote, those with the most precise positions


@dataclass(frozen=True)
class Placement:
    """A rigid motion of the ground: `x_world = rotation(angle) x_local + translation`.

    Attributes:
        angle: heading in radians.
        translation: (2,) meters.
    """

    angle: float
    translation: Float[np.ndarray, "2"]

    def place(self, parameters: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        """Transform a camera from the local frame to the world frame."""
        placed = parameters.copy()
        placed[PAN] += self.angle
        placed[X:Z] = turn(parameters[X:Z], self.angle) + self.translation
        return placed

    def is_near(self, other: "Placement", settings: CalibrationSettings) -> bool:
        """Return whether the bins of two placements touch, so that refinement would merge them."""
        apart = np.linalg.norm(self.translation - other.translation) / settings.voting_cell
        turned = np.cos(self.angle - other.angle)
        return bool(apart <= NEAR_BINS and turned >= np.cos(NEAR_BINS * settings.voting_angle))


def turn(xy: Float[np.ndarray, "*n 2"], angle: float) -> Float[np.ndarray, "*n 2"]:
    """Rotate points (..., 2) about the origin by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], -1)


def moved_map(people: GroundMap, placement: Placement) -> GroundMap:
    """Transform a local map to world coordinates."""
    c, s = np.cos(placement.angle), np.sin(placement.angle)
    R = np.array([[c, -s], [s, c]])
    xy = people.xy @ R.T + placement.translation
    return replace(people, xy=xy, covariance=R @ people.covariance @ R.T)


def vote(
    target: GroundMap, source: GroundMap, settings: CalibrationSettings, count: int
) -> list[tuple[float, Placement]]:
    """Find the best placements of one local map in another.

    The bins are as wide as the errors of single views, so that the votes of all people meet. Near
    each placement, the same pairs vote again with narrower bins, because a placement that is off by
    half the distance between people matches everybody with a neighbor.

    Args:
        target: (T, N) people of the fixed map.
        source: (T, M) people of the moving map in the same frames.
        settings: constants.
        count: maximum number of distinct placements.

    Returns:
        Placements and the scores of their narrow bins, best first: votes minus a fraction of the
        chance votes, in units of the square root of the latter. Chance votes are counted in the
        same way with one sequence shifted by half its length.
    """
    target, source = _nearest(target), _nearest(source)
    turns = max(8, round(2 * np.pi / settings.voting_angle))
    heading = np.arange(turns + 1) * 2 * np.pi / turns
    bins = _Bins(heading, settings.voting_cell, _reach(target, source, settings))
    score = _score(target, source, bins, settings)
    score -= np.linspace(0, 1e-9, score.size).reshape(score.shape)  # the first of equal bins
    peaks = score == maximum_filter(score, size=round(2 * NEAR_BINS), mode="wrap")
    best = np.flatnonzero(peaks & (score > 0))
    best = best[np.argsort(-score.flat[best], kind="stable")[:count]]
    placements = [bins.placement(score.shape, int(index)) for index in best]
    sharpened = [_sharpened(target, source, placement, settings) for placement in placements]
    return sorted(sharpened, key=lambda item: -item[0])


class _Bins(NamedTuple):
    """Bins of a vote. Votes are blurred over each bin and the next one.

    Attributes:
        heading: (n,) ascending angles in radians.
        cell: side of a bin in meters.
        radius: largest coordinate of a translation in meters.
    """

    heading: Float[np.ndarray, " n"]
    cell: float
    radius: float

    def placement(self, shape: tuple[int, ...], index: int) -> Placement:
        """Return the upper edge of a bin, which is the center of the votes blurred into it."""
        at, *place = np.unravel_index(index, shape)
        translation = (np.array(place) + 1.0) * self.cell - self.radius
        return Placement(float(self.heading[at : at + 2].mean()), translation)


def _sharpened(
    target: GroundMap, source: GroundMap, placement: Placement, settings: CalibrationSettings
) -> tuple[float, Placement]:
    """Vote with narrow bins around a placement; return the best score and placement."""
    moved = moved_map(source, placement)
    center = moved.xy[moved.valid].mean(0)
    target, moved = (replace(people, xy=people.xy - center) for people in (target, moved))
    steps = np.arange(-SHARPENED * FINER, SHARPENED * FINER + 1)
    cell = settings.voting_cell
    bins = _Bins(steps * settings.voting_angle / FINER, cell / FINER, SHARPENED * cell)
    score = _score(target, moved, bins, settings)
    best = int(score.argmax())
    change = bins.placement(score.shape, best)
    shift = turn(placement.translation - center, change.angle) + center + change.translation
    return float(score.flat[best]), Placement(placement.angle + change.angle, shift)


def _score(
    target: GroundMap, source: GroundMap, bins: _Bins, settings: CalibrationSettings
) -> Float[np.ndarray, "angle x y"]:
    """Votes above chance of each bin, as `vote` returns them."""
    votes = _count(target, source, bins)
    chance = _count(target, source.rolled(len(source.xy) // 2), bins)
    # Far corners have no chance votes, where the mean level bounds the ratio.
    level = np.maximum(chance, chance.mean())
    level += 1.0
    chance *= settings.chance_weight
    votes -= chance
    return np.divide(votes, np.sqrt(level, out=level), out=votes)


def _reach(target: GroundMap, source: GroundMap, settings: CalibrationSettings) -> float:
    """Largest distance between two cameras that can see the same people, in whole cells."""
    reach = [
        np.quantile(np.linalg.norm(m.xy[m.valid], axis=-1), 0.9) if m.valid.any() else 0.0
        for m in (target, source)
    ]
    return float(np.ceil(min(settings.voting_radius, sum(reach) + 5 * settings.voting_cell)))


def _nearest(people: GroundMap) -> GroundMap:
    """Select the people with the most precise positions in each frame."""
    if people.valid.shape[1] <= NEAREST_PEOPLE:
        return people
    spread = np.where(people.valid, people.covariance.trace(axis1=2, axis2=3), np.inf)
    pick = np.argsort(spread, axis=1, kind="stable")[:, :NEAREST_PEOPLE]
    frames = np.arange(len(pick))[:, None]
    return GroundMap(*(part[frames, pick] for part in vars(people).values()))


def _count(target: GroundMap, source: GroundMap, bins: _Bins) -> Float[np.ndarray, "angle x y"]:
    """Count the blurred votes (angle, x, y) of all pairs of people in each frame.

    Args:
        target: (T, N) people of the fixed map.
        source: (T, M) people of the moving map.
        bins: where to count.
    """
    cell, radius = bins.cell, bins.radius
    frame, slot, other = np.nonzero(target.valid[:, :, None] & source.valid[:, None, :])
    p, q = target.xy[frame, slot], source.xy[frame, other]
    # No heading brings other pairs within the radius.
    near = np.abs(np.linalg.norm(p, axis=1) - np.linalg.norm(q, axis=1)) < np.sqrt(2) * radius
    frame, slot, other, p, q = frame[near], slot[near], other[near], p[near], q[near]
    spread = target.covariance[frame, slot].trace(axis1=1, axis2=2)
    spread += source.covariance[frame, other].trace(axis1=1, axis2=2)
    weight = 1 / np.sqrt(np.maximum(spread, cell**2))
    # The votes of a stay are correlated; with this weight, they vary like independent ones.
    weight /= np.sqrt(_length_of_stay(frame, np.floor(np.hstack([p, q]) / cell)))
    p = (p.astype(np.float32) + np.float32(radius)) / np.float32(cell)
    q = q.astype(np.float32) / np.float32(cell)
    by_x, by_y = (np.vstack([p[:, axis], q.T]) for axis in (0, 1))
    side = int(2 * radius / cell)
    angle = bins.heading.astype(np.float32)[:, None]
    votes, last = np.empty((len(angle), side, side)), np.zeros((side, side))
    step = max(1, VOTES_AT_A_TIME // max(len(weight), 1))
    for first in range(0, len(angle), step):
        headings = angle[first : first + step]
        c, s, one = np.cos(headings), np.sin(headings), np.ones_like(headings)
        layer = np.arange(1, len(headings) + 1, dtype=np.int32)[:, None]
        x = (np.hstack([one, -c, s]) @ by_x).astype(np.int32)
        y = (np.hstack([one, -s, -c]) @ by_y).astype(np.int32)
        # Votes out of range go to the first and to an additional row or column.
        at = (layer * (side + 1) + x.clip(0, side)) * (side + 1) + y.clip(0, side)
        count = np.bincount(
            at.ravel(), np.tile(weight, len(headings)), (len(headings) + 1) * (side + 1) ** 2
        ).reshape(-1, side + 1, side + 1)[:, :side, :side]
        count[:, 0] = count[:, :, 0] = 0
        count[0], last = last, count[-1]
        blurred = np.add(count[:-1], count[1:], out=votes[first : first + step])
        blurred[:, :-1] += blurred[:, 1:]
        blurred[:, :, :-1] += blurred[:, :, 1:]
    return votes[1:]


def _length_of_stay(
    frame: Int[np.ndarray, " n"], cells: Float[np.ndarray, "n 4"]
) -> Int[np.ndarray, " n"]:
    """Count the votes of each pair's stay, the time that both spend in the same cells.

    Args:
        frame: (n,) frame of each pair.
        cells: (n, 4) integer cells of the two people.
    """
    place = cells.astype(np.int16).view(np.int64).ravel()
    order = np.lexsort((frame, place))
    moved, later = np.diff(place[order]) != 0, np.diff(frame[order])
    stay = np.zeros(len(order), np.int64)
    stay[order[1:]] = np.cumsum(moved | (later > LONGEST_ABSENCE))
    return np.bincount(stay)[stay]
