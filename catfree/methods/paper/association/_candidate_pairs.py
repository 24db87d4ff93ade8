"""Pairs of detections in two cameras that may be one person, in merging order."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.methods.paper.association._observe import (
    Observations,
    appearance_distance,
)
from catfree.settings import AssociationSettings
from catfree.types import Rays
from catfree.types._sampling import expand_ranges

PAIR_BLOCK = 65536  # pairs per call; fixed to avoid recompilation
PAIRS_AT_ONCE = 1 << 20  # pairs held in memory, a bound for crowded frames


class CandidatePairs(NamedTuple):
    """Pairs of observations in the order in which the partition tries to merge them.

    Attributes:
        first: (P,) observation.
        second: (P,) observation of another camera in the same frame.
        singletons_only: (P,) whether the pair qualifies only by its uniqueness, so that both
            detections must still be ungrouped when it is tried.
    """

    first: Int[np.ndarray, " p"]
    second: Int[np.ndarray, " p"]
    singletons_only: Bool[np.ndarray, " p"]


def pair_residual(
    origins: Float[Array, "2 3"], directions: Float[Array, "2 3"], weights: Float[Array, "2"]
) -> Float[Array, ""]:
    """Compute the larger angular residual of two rays at their weighted least-squares point.

    The weighted least-squares point lies on the common perpendicular of the two lines and divides
    it in the inverse ratio of the weights, so no linear system is needed.

    Args:
        origins: (2, 3) camera centers.
        directions: (2, 3) unit directions.
        weights: (2,) positive reliabilities.

    Returns:
        Radians in [0, pi]; pi for parallel rays, pi/2 where they meet in a camera center, above
        pi/2 where the lines meet behind a camera.
    """
    baseline = origins[1] - origins[0]
    normal = jnp.cross(directions[0], directions[1])
    sine_squared = normal @ normal
    parallel = sine_squared <= jnp.finfo(origins.dtype).tiny
    safe = jnp.where(parallel, 1, sine_squared)
    depth = jnp.stack(
        [
            jnp.cross(baseline, directions[1]) @ normal / safe,
            jnp.cross(baseline, directions[0]) @ normal / safe,
        ]
    )
    gap = jnp.abs(baseline @ normal) / jnp.sqrt(safe)
    share = weights[::-1] / weights.sum()
    # At the camera center (two cameras in one place) the angle is undefined: never a match.
    at_center = (depth == 0) & (gap * share == 0)
    angle = jnp.where(at_center, jnp.pi / 2, jnp.arctan2(gap * share, depth)).max()
    return jnp.where(parallel, jnp.asarray(jnp.pi, origins.dtype), angle)


@jax.jit
def _residuals(
    origins: Float[Array, "n 3"],
    directions: Float[Array, "n 3"],
    weights: Float[Array, " n"],
    first: Int[Array, " p"],
    second: Int[Array, " p"],
) -> Float[Array, " p"]:
    ends = jnp.stack([first, second], axis=-1)
    return jax.vmap(pair_residual)(origins[ends], directions[ends], weights[ends])


def pair_residuals(
    rays: Rays, first: Int[np.ndarray, " p"], second: Int[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Compute `pair_residual` of many pairs, in blocks of fixed size."""
    of_rays = tuple(map(jnp.asarray, (rays.origin, rays.direction, rays.weight)))
    return in_blocks(lambda *pair: _residuals(*of_rays, *pair), (first, second), PAIR_BLOCK)


def candidate_pairs(
    observations: Observations,
    rays: Rays,
    frames: tuple[int, int],
    *,
    sigma_theta: float,
    settings: AssociationSettings,
) -> CandidatePairs:
    """Find pairs that may merge in the frames `frames[0] <= index < frames[1]`, in merging order.

    A pair qualifies when its residual is at most `residual_factor * sigma_theta` and its appearance
    distance is at most the threshold, or when it is unique: its residual is at most
    `uniqueness_ratio` times that of the best alternative of either detection in the other's camera.
    Pairs are ordered by appearance distance, then residual; without embeddings only by residual.

    Args:
        observations: detections in canonical order.
        rays: the rays of those frames' observations, followed by padding.
        frames: first frame index and one past the last.
        sigma_theta: angular noise in radians.
        settings: thresholds.

    Returns:
        The pairs, with indices into `rays`.

    Source:
        Sec. "Matching pedestrians across cameras".
    """
    begin, end = observations.frame_start(np.asarray(frames))
    members = np.arange(begin, end)
    cell_end = observations.cell_start[observations.cell[members] + 1]
    frame_end = observations.frame_start(observations.frame_index[members] + 1)
    limit = settings.residual_factor * sigma_theta
    uniqueness = _Uniqueness(observations.kept.camera[members], observations.camera_count)
    near: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for rows in _slices_of_work(frame_end - cell_end, PAIRS_AT_ONCE):
        # All observations of the frame after the detection's cell belong to later cameras.
        first, second = expand_ranges(cell_end[rows] - begin, frame_end[rows] - begin)
        first = first + rows.start
        residual = pair_residuals(rays, first, second)
        if observations.appearance is not None:
            uniqueness.add(first, second, residual)
        close = residual <= limit
        near.append((first[close], second[close], residual[close]))
    first, second, residual = (np.concatenate(column) for column in zip(*near, strict=True))
    if observations.appearance is None:
        order = np.argsort(residual, kind="stable")
        return CandidatePairs(first[order], second[order], np.zeros(len(order), bool))
    distance = appearance_distance(observations.appearance[members], first, second)
    similar = distance <= settings.appearance_threshold
    alternative = uniqueness.best_alternative(first, second, residual)
    keep = np.flatnonzero(similar | (residual <= settings.uniqueness_ratio * alternative))
    order = keep[np.lexsort([residual[keep], distance[keep]])]
    return CandidatePairs(first[order], second[order], ~similar[order])


def _slices_of_work(work: Int[np.ndarray, " n"], most: int) -> list[slice]:
    """Split rows into slices of at most `most` total work, or of one row; at least one slice."""
    total = np.concatenate([[0], np.cumsum(work)])
    slices, first = [], 0
    while first < len(work) or not slices:
        last = int(np.searchsorted(total, total[first] + most, side="right")) - 1
        slices.append(slice(first, min(max(last, first + 1), len(work))))
        first = slices[-1].stop
    return slices


class _Uniqueness:
    """The two smallest residuals of every detection with each other camera.

    Two are enough: the best alternative is the second best for the best pair, and the best for any
    other pair.
    """

    def __init__(self, camera: Int[np.ndarray, " n"], camera_count: int) -> None:
        self._camera = camera
        self._camera_count = camera_count
        self._smallest = np.full((2, len(camera) * camera_count), np.inf)

    def _keys(
        self, first: Int[np.ndarray, " p"], second: Int[np.ndarray, " p"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """The (detection, other camera) cells of both ends of each pair."""
        cameras, camera = self._camera_count, self._camera
        return first * cameras + camera[second], second * cameras + camera[first]

    def add(
        self,
        first: Int[np.ndarray, " p"],
        second: Int[np.ndarray, " p"],
        residual: Float[np.ndarray, " p"],
    ) -> None:
        """Add pairs; each pair must be added once."""
        best, runner_up = self._smallest
        for key in self._keys(first, second):
            new_best, new_runner_up = np.full_like(self._smallest, np.inf)
            np.minimum.at(new_best, key, residual)
            leading = residual == new_best[key]
            np.minimum.at(new_runner_up, key[~leading], residual[~leading])
            tied = np.bincount(key[leading], minlength=len(best)) > 1
            new_runner_up[tied] = new_best[tied]
            runner_up[:] = np.minimum(np.maximum(best, new_best), runner_up)
            runner_up[:] = np.minimum(runner_up, new_runner_up)
            best[:] = np.minimum(best, new_best)

    def best_alternative(
        self,
        first: Int[np.ndarray, " p"],
        second: Int[np.ndarray, " p"],
        residual: Float[np.ndarray, " p"],
    ) -> Float[np.ndarray, " p"]:
        """Smallest residual of another pair of either detection in the other's camera, or inf."""
        best, runner_up = self._smallest
        one, other = (
            np.where(residual == best[key], runner_up[key], best[key])
            for key in self._keys(first, second)
        )
        return np.minimum(one, other)
