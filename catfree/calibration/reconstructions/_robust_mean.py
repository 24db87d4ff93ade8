"""Robust averages of rotations and positions."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

ITERATIONS = 30  # Weiszfeld's method converges linearly; 30 steps reach 1/1000 of the spread
SETTLED = 1e-6  # step, as a fraction of the largest distance, that ends the iteration
COINCIDENT = 1e-9  # fraction of the largest distance within which a value equals the median


def geometric_median(
    points: Float[np.ndarray, "n *batch 3"], present: Bool[np.ndarray, "n *batch"]
) -> Float[np.ndarray, "*batch 3"]:
    """Find the point with the smallest sum of distances to given points.

    Args:
        points: (N, ..., 3).
        present: (N, ...) whether the point counts; other points may have any value.

    Returns:
        (..., 3) medians along the first axis, NaN if no point counts.

    Source:
        Weiszfeld (1937), "Sur le point pour lequel la somme des distances de n points donnés est
        minimum".
    """
    used = np.where(present[..., None], points, np.nan)
    counted = np.asarray(present.any(axis=0))[..., None]
    median = np.nanmedian(np.where(counted, used, 0.0), axis=0)
    offset = np.where(present[..., None], points - median, 0.0)
    unit = np.maximum(np.linalg.norm(offset, axis=-1).max(axis=0), np.finfo(float).tiny)
    for _ in range(ITERATIONS):
        offset = np.where(present[..., None], points - median, 0.0)
        step = _weiszfeld_step(offset / unit[..., None], present) * unit[..., None]
        median = median + step
        if (np.linalg.norm(step, axis=-1) <= SETTLED * unit).all():
            break
    return np.where(counted, median, np.nan)


def _weiszfeld_step(offset: np.ndarray, present: np.ndarray) -> np.ndarray:
    """(..., 3) step from the current estimate, given the (N, ..., 3) offsets of the values.

    An estimate that coincides with values moves only if the other values outweigh them.

    Source:
        Vardi and Zhang (2000).
    """
    distance = np.linalg.norm(offset, axis=-1)
    away = present & (distance > COINCIDENT)
    weight = np.where(away, 1 / np.where(away, distance, 1.0), 0.0)
    pull = (weight[..., None] * offset).sum(axis=0)
    strength = np.linalg.norm(pull, axis=-1)
    holding = (present & ~away).sum(axis=0)
    share = np.maximum(1 - holding / np.where(strength > 0, strength, 1.0), 0.0)
    total = np.where(away.any(axis=0), weight.sum(axis=0), 1.0)
    return (share / total)[..., None] * pull


def median_rotation(
    rotations: Float[np.ndarray, "n *batch 3 3"], present: Bool[np.ndarray, "n *batch"]
) -> Float[np.ndarray, "*batch 3 3"]:
    """Find the rotation with the smallest sum of angles to given rotations.

    Args:
        rotations: (N, ..., 3, 3).
        present: (N, ...) whether the rotation counts; other rotations may have any value.

    Returns:
        (..., 3, 3) medians along the first axis, NaN if no rotation counts.

    Source:
        Hartley, Aftab and Trumpf (2011), "L1 rotation averaging using the Weiszfeld algorithm".
    """
    used = np.where(present[..., None, None], rotations, np.eye(3))
    # Start at the member with the smallest sum of angles, which is robust to outliers.
    between = angle(used[:, None], used[None])
    cost = np.where(present[:, None] & present[None], between, 0.0).sum(axis=1)
    best = np.where(present, cost, np.inf).argmin(axis=0)
    median = np.take_along_axis(used, best[None, ..., None, None], axis=0)[0]
    for _ in range(ITERATIONS):
        away = _rotation_vector(used @ np.swapaxes(median, -1, -2))
        step = _weiszfeld_step(away, present)
        turn = Rotation.from_rotvec(step.reshape(-1, 3)).as_matrix().reshape(median.shape)
        median = turn @ median
        largest = np.where(present, np.linalg.norm(away, axis=-1), 0.0).max(axis=0)
        if (np.linalg.norm(step, axis=-1) <= SETTLED * largest).all():
            break
    counted = np.asarray(present.any(axis=0))
    return np.where(counted[..., None, None], median, np.nan)


def angle(
    first: Float[np.ndarray, "*batch 3 3"], second: Float[np.ndarray, "*other 3 3"]
) -> Float[np.ndarray, "*result"]:
    """Angles between rotations in radians, with broadcasting."""
    # Unlike the trace, the chord is accurate for small angles.
    chord = np.linalg.norm(first - second, axis=(-1, -2)) / np.sqrt(8)
    return 2 * np.arcsin(np.minimum(chord, 1.0))


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(rotation.shape[:-1])
