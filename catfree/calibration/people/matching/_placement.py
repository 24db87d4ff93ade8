"""Place the second camera of a pair by voting, so that both see the same people.

Two metric ground maps differ by a heading and a translation. Every pair of boxes of one instant
votes for all placements that would make it one person. The true placement collects one vote per
person seen by both cameras; chance votes are spread thinly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people.cameras._camera_model import PAN, X, Z
from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.settings import CalibrationSettings

NEAREST_PEOPLE = 24  # people per frame that vote: those with the most precise positions


@dataclass(frozen=True)
class Placement:
    """A rigid motion of the ground: `x_world = rotation(angle) x_local + translation`.

    Attributes:
        angle: heading in radians.
        translation: (2,) meters.
        score: votes above chance, in units of the square root of the chance votes.
    """

    angle: float
    translation: Float[np.ndarray, "2"]
    score: float

    def place(self, parameters: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        """Transform a camera from the local frame to the world frame."""
        placed = parameters.copy()
        placed[PAN] += self.angle
        placed[X:Z] = turn(parameters[X:Z], self.angle) + self.translation
        return placed


def turn(xy: Float[np.ndarray, "*n 2"], angle: float) -> Float[np.ndarray, "*n 2"]:
    """Rotate points (..., 2) about the origin by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], -1)


def moved_map(people: GroundMap, placement: Placement) -> GroundMap:
    """Transform a local map to world coordinates."""
    c, s = np.cos(placement.angle), np.sin(placement.angle)
    R = np.array([[c, -s], [s, c]])
    return GroundMap(
        people.xy @ R.T + placement.translation,
        R @ people.covariance @ R.T,
        people.height,
        people.height_sd,
        people.valid,
    )


def vote(
    target: GroundMap, source: GroundMap, settings: CalibrationSettings, count: int
) -> list[Placement]:
    """Find the best placements of one local map in another.

    Args:
        target: (T, N) people of the fixed map.
        source: (T, M) people of the moving map, same frames.
        settings: constants.
        count: maximum number of distinct placements.

    Returns:
        Placements, best first, from votes minus a fraction of the chance votes, which are counted
        in the same way with one sequence shifted by half its length.
    """
    target, source = _nearest(target), _nearest(source)
    bins = max(8, round(2 * np.pi / settings.voting_angle))
    half = len(source.xy) // 2
    votes = _count(target, source, np.arange(len(source.xy)), bins, settings)
    chance = _count(target, source, np.roll(np.arange(len(source.xy)), half), bins, settings)
    gain = votes - settings.chance_weight * chance
    # Far corners have no chance votes; the mean level bounds the ratio there.
    level = np.sqrt(np.maximum(chance, chance.mean()) + 1.0)
    score = gain / level
    radius = _reach(target, source, settings)
    placements: list[Placement] = []
    best = np.flatnonzero(score > 0.4 * max(score.max(), 1e-9))
    for index in best[np.argsort(-score.flat[best], kind="stable")[: 50 * count]]:
        angle_bin, x_bin, y_bin = np.unravel_index(index, score.shape)
        # A blurred bin sums itself and the next one, so its center is its upper edge.
        angle = (angle_bin + 0.5) * 2 * np.pi / bins
        place = np.array([x_bin + 1.0, y_bin + 1.0]) * settings.voting_cell - radius
        is_distinct = all(
            np.linalg.norm(place - other.translation) > 2.5 * settings.voting_cell
            or np.cos(angle - other.angle) < np.cos(2.5 * settings.voting_angle)
            for other in placements
        )
        if is_distinct:
            placements.append(Placement(angle, place, float(score.flat[index])))
            if len(placements) == count:
                break
    return placements


def _reach(target: GroundMap, source: GroundMap, settings: CalibrationSettings) -> float:
    """Largest distance between two cameras that see the same people, in whole cells."""
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
    return GroundMap(
        people.xy[frames, pick],
        people.covariance[frames, pick],
        people.height[frames, pick],
        people.height_sd[frames, pick],
        people.valid[frames, pick],
    )


def _count(
    target: GroundMap,
    source: GroundMap,
    source_frames: Int[np.ndarray, " frame"],
    bins: int,
    settings: CalibrationSettings,
) -> Float[np.ndarray, "{bins} x y"]:
    """Count votes (angle, x, y) of all pairs of target and given source frames, blurred."""
    both = target.valid[:, :, None] & source.valid[source_frames][:, None, :]
    time, slot, other = np.nonzero(both)
    p = target.xy[time, slot].astype(np.float32)
    q = source.xy[source_frames[time], other].astype(np.float32)
    spread = target.covariance[time, slot].trace(axis1=1, axis2=2) + source.covariance[
        source_frames[time], other
    ].trace(axis1=1, axis2=2)
    weight = 1 / np.sqrt(np.maximum(spread, settings.voting_cell**2))
    radius, cell = _reach(target, source, settings), settings.voting_cell
    side = int(2 * radius / cell)
    votes = np.empty((bins, side, side))
    p = (p + np.float32(radius)) / np.float32(cell)
    q = q / np.float32(cell)
    for index in range(bins):
        angle = np.float32(index * 2 * np.pi / bins)
        c, s = np.cos(angle), np.sin(angle)
        x = (p[:, 0] - (c * q[:, 0] - s * q[:, 1])).astype(np.int32)
        y = (p[:, 1] - (s * q[:, 0] + c * q[:, 1])).astype(np.int32)
        inside = (x > 0) & (x < side) & (y > 0) & (y < side)
        flat = np.where(inside, x * side + y, 0)
        layer = np.bincount(flat, weights=weight, minlength=side * side)
        layer[0] = 0
        votes[index] = layer.reshape(side, side)
    votes = votes + np.roll(votes, -1, axis=0)
    votes[:, :-1] += votes[:, 1:]
    votes[:, :, :-1] += votes[:, :, 1:]
    return votes


def align_rigidly(
    target: Float[np.ndarray, "n 2"],
    source: Float[np.ndarray, "n 2"],
    weight: Float[np.ndarray, " n"],
) -> tuple[float, Float[np.ndarray, "2"]]:
    """Fit the rigid motion of the ground that maps source points to target points.

    Args:
        target: (n, 2) points in meters.
        source: (n, 2) the moving points in meters.
        weight: (n,) of each pair.

    Returns:
        Heading in radians and translation (2,) in meters, as in `Placement`.

    Source: Umeyama (1991), in the plane and without scale.
    """
    total = weight.sum()
    mt, ms = weight @ target / total, weight @ source / total
    a, b = target - mt, source - ms
    cosine = (weight * (a * b).sum(1)).sum()
    sine = (weight * (a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1])).sum()
    angle = float(np.arctan2(sine, cosine))
    return angle, mt - turn(ms, angle)
