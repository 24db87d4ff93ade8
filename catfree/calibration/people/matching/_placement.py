"""Pairs of cameras: where the second one must stand for both to see the same people.

Two metric ground maps differ by a heading and a translation. Every pair of boxes of one instant
votes for all of them that would make it one person; the truth collects one vote for every person
whom both cameras see, chance spreads its votes thinly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people.cameras._camera_model import PAN, X, Z
from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.settings import CalibrationSettings

NEAREST_PEOPLE = 24  # people of a frame that vote: the nearest, whose positions are sharpest


@dataclass(frozen=True)
class Placement:
    """A rigid motion of the ground: `x_world = rotation(angle) x_local + translation`.

    Attributes:
        angle: heading in radians.
        translation: (2,) metres.
        score: votes above chance, in units of the square root of the chance votes.
    """

    angle: float
    translation: Float[np.ndarray, "2"]
    score: float

    def place(self, parameters: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        """A camera of the local frame moved into the world frame."""
        placed = parameters.copy()
        placed[PAN] += self.angle
        placed[X:Z] = turn(parameters[X:Z], self.angle) + self.translation
        return placed


def turn(xy: Float[np.ndarray, "*n 2"], angle: float) -> Float[np.ndarray, "*n 2"]:
    """Points (..., 2) turned about the origin by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], -1)


def moved_map(people: GroundMap, placement: Placement) -> GroundMap:
    """A local map in world coordinates."""
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
    """The best placements of one local map in another.

    Args:
        target: (T, N) people of the map that stays.
        source: (T, M) people of the map that moves, same frames.
        settings: constants.
        count: how many distinct placements to return.

    Returns:
        Placements, best first, from votes minus a share of the chance votes, which are counted in
        the same way with one sequence shifted by half its length.
    """
    target, source = _nearest(target), _nearest(source)
    bins = max(8, round(2 * np.pi / settings.voting_angle))
    half = len(source.xy) // 2
    votes = _count(target, source, np.arange(len(source.xy)), bins, settings)
    chance = _count(target, source, np.roll(np.arange(len(source.xy)), half), bins, settings)
    gain = votes - settings.chance_weight * chance
    # In far corners chance is empty; the overall level keeps the ratio honest there.
    level = np.sqrt(np.maximum(chance, chance.mean()) + 1.0)
    score = gain / level
    radius = _reach(target, source, settings)
    found: list[Placement] = []
    best = np.flatnonzero(score > 0.4 * max(score.max(), 1e-9))
    for index in best[np.argsort(-score.flat[best], kind="stable")[: 50 * count]]:
        angle_bin, x_bin, y_bin = np.unravel_index(index, score.shape)
        # A blurred bin collects its own and the next, so its middle is its upper edge.
        angle = (angle_bin + 0.5) * 2 * np.pi / bins
        place = np.array([x_bin + 1.0, y_bin + 1.0]) * settings.voting_cell - radius
        fresh = all(
            np.linalg.norm(place - other.translation) > 2.5 * settings.voting_cell
            or np.cos(angle - other.angle) < np.cos(2.5 * settings.voting_angle)
            for other in found
        )
        if fresh:
            found.append(Placement(angle, place, float(score.flat[index])))
            if len(found) == count:
                break
    return found


def _reach(target: GroundMap, source: GroundMap, settings: CalibrationSettings) -> float:
    """How far two cameras may stand apart, in whole cells: as far as both see people."""
    reach = [
        np.quantile(np.linalg.norm(m.xy[m.valid], axis=-1), 0.9) if m.valid.any() else 0.0
        for m in (target, source)
    ]
    return float(np.ceil(min(settings.voting_radius, sum(reach) + 5 * settings.voting_cell)))


def _nearest(people: GroundMap) -> GroundMap:
    """The sharpest people of each frame."""
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
    """Blurred vote counts (angle, x, y) of all pairs of target frame and given source frame."""
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
    """The rigid motion of the ground that brings points onto others, by least squares.

    Args:
        target: (n, 2) points in metres.
        source: (n, 2) the points that move, in metres.
        weight: (n,) of each pair.

    Returns:
        Heading in radians and translation (2,) in metres, as in `Placement`.

    Source: Umeyama (1991), in the plane and without scale.
    """
    total = weight.sum()
    mt, ms = weight @ target / total, weight @ source / total
    a, b = target - mt, source - ms
    cosine = (weight * (a * b).sum(1)).sum()
    sine = (weight * (a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1])).sum()
    angle = float(np.arctan2(sine, cosine))
    return angle, mt - turn(ms, angle)
