"""Collision avoidance of walkers: with each other, and with obstacles in their path."""

import numpy as np
from jaxtyping import Float, Int

PERSONAL_SPACE = 0.55  # meters between two body axes below which strangers clearly move apart
FALL_OFF = 0.25  # meters over which that speed falls by a factor e
YIELD_SPEED = 1.5  # m/s away from another person at the edge of personal space
COMPANION_SHARE = 0.6  # factor on YIELD_SPEED between members of one group
BODY_RADIUS = 0.25  # meters
LOOK_AHEAD = 1.5  # meters from an obstacle at which walkers begin to pass it


def avoidance(
    position: Float[np.ndarray, "p 2"], group: Int[np.ndarray, " p"]
) -> Float[np.ndarray, "p 2"]:
    """Compute the velocity (P, 2) in m/s away from others, stronger for nearer ones."""
    offset = position[:, None] - position[None]
    distance = np.sqrt(np.einsum("pqi,pqi->pq", offset, offset) + 1e-9)
    strength = YIELD_SPEED * np.exp((PERSONAL_SPACE - distance) / FALL_OFF)
    strength[group[:, None] == group[None]] *= COMPANION_SHARE
    np.fill_diagonal(strength, 0.0)
    total = np.einsum("pq,pqi->pi", strength / distance, offset)
    # Half of it is added to the right: two people who meet pass instead of stopping.
    return total + 0.5 * np.stack([total[:, 1], -total[:, 0]], -1)


def around_obstacles(
    points: Float[np.ndarray, "p 2"],
    velocity: Float[np.ndarray, "p 2"],
    obstacles: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "p 2"]:
    """Compute sideways velocities (P, 2) in m/s past obstacles (x, y, radius) in the path."""
    if not len(obstacles) or not len(points):
        return np.zeros_like(points)
    ahead = unit(velocity)
    to_obstacle = obstacles[None, :, :2] - points[:, None]
    along = np.einsum("pki,pi->pk", to_obstacle, ahead)
    leftwards = to_obstacle[..., 1] * ahead[:, None, 0] - to_obstacle[..., 0] * ahead[:, None, 1]
    reach = obstacles[None, :, 2] + 2 * BODY_RADIUS
    meets = (along > -BODY_RADIUS) & (along < reach + LOOK_AHEAD) & (np.abs(leftwards) < reach)
    # Pass on the nearer side; the push is stronger the more central the path meets the obstacle.
    side = np.where(leftwards >= 0, -1, 1)
    push = np.where(meets, side * (1 - np.abs(leftwards) / reach), 0).sum(1)
    speed = np.linalg.norm(velocity, axis=-1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    return left * (1.5 * push * speed)[:, None]


def outside_obstacles(
    points: Float[np.ndarray, "p 2"],
    obstacles: Float[np.ndarray, "k 3"],
    clearance: float = BODY_RADIUS,
) -> Float[np.ndarray, "p 2"]:
    """Move points within `clearance` of an obstacle straight out of it."""
    for x, y, radius in obstacles:
        offset = points - [x, y]
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        reach = radius + clearance
        outward = np.where(distance > 1e-6, offset / np.maximum(distance, 1e-6), [1.0, 0.0])
        points = np.where(distance < reach, [x, y] + outward * reach, points)
    return points


def unit(vectors: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Normalize vectors to length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-9), 0.0)


def limited(vectors: Float[np.ndarray, "n 2"], longest: float) -> Float[np.ndarray, "n 2"]:
    """Shorten vectors longer than `longest` to that length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, longest / np.maximum(length, 1e-9))
