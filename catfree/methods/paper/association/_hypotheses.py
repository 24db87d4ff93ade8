"""Position hypotheses: the 3-D point of each group of rays, its support and uncertainty.

All functions work in the canonical frame: ground z = 0, E = 1.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from catfree.filters import support
from catfree.geometry import (
    angular_residual,
    ground_covariance,
    ground_sigma,
    information,
    triangulate,
)
from catfree.geometry._arrays import Scalar
from catfree.geometry._buckets import in_blocks, padded_length
from catfree.methods.paper.association._observe import Observations
from catfree.methods.paper.association._on_ground import ground_point, triangulate_on_ground
from catfree.settings import TriangulationSettings
from catfree.types import Plane, Rays

HYPOTHESIS_BLOCK = 4096  # hypotheses per call; fixed to avoid recompilation
RESIDUALS_AT_ONCE = 1 << 21  # bounds the memory of the recount in crowded frames
MINIMUM_RAYS_PER_CELL = 16

GROUND = Plane(np.array([0.0, 0.0, 1.0]), np.array(0.0))


class RayTable(NamedTuple):
    """Rays by frame, camera and index within this cell, padded with weight 0.

    Attributes:
        origin: (C, 3) camera centers.
        direction: (F, C, D, 3) unit directions.
        weight: (F, C, D) reliability, 0 for padding.
        cell_start: (F, C) observation of the first ray of each cell.
    """

    origin: Float[np.ndarray, "cam 3"]
    direction: Float[np.ndarray, "f cam d 3"]
    weight: Float[np.ndarray, "f cam d"]
    cell_start: Int[np.ndarray, "f cam"]


class Support(NamedTuple):
    """Camera support of positions, and their uncertainty.

    Attributes:
        member: (H, C) supporting observation of each camera, or -1.
        residual: (H, C) angular residual of the supporting rays in radians, NaN where absent.
        sigma: (H,) ground uncertainty (Eq. sigma), inf below two cameras.
        covariance: (H, 2, 2) on the ground, inf below two cameras.
        weight: (H,) sum of the reliabilities of the supporting rays.
    """

    member: Int[np.ndarray, "h cam"]
    residual: Float[np.ndarray, "h cam"]
    sigma: Float[np.ndarray, " h"]
    covariance: Float[np.ndarray, "h 2 2"]
    weight: Float[np.ndarray, " h"]

    @property
    def cameras(self) -> Int[np.ndarray, " h"]:
        """(H,) number of supporting cameras."""
        return (self.member >= 0).sum(axis=1)


def ray_table(
    observations: Observations, rays: Rays, centers: Float[np.ndarray, "cam 3"]
) -> RayTable:
    """Arrange the rays by frame and camera, to be indexed by hypotheses."""
    frames, cameras = len(observations.frames), observations.camera_count
    starts = observations.cell_start[:-1]
    longest = int(np.diff(observations.cell_start).max(initial=0))
    depth = padded_length(longest, MINIMUM_RAYS_PER_CELL)
    place = np.arange(len(observations)) - starts[observations.cell]
    direction = np.zeros((frames * cameras, depth, 3), rays.direction.dtype)
    weight = np.zeros((frames * cameras, depth), rays.direction.dtype)
    direction[observations.cell, place] = rays.direction
    weight[observations.cell, place] = rays.weight
    return RayTable(
        centers.astype(direction.dtype),
        direction.reshape(frames, cameras, depth, 3),
        weight.reshape(frames, cameras, depth),
        starts.reshape(frames, cameras),
    )


def _gather(
    rays: Rays, member: Int[np.ndarray, "h cam"]
) -> tuple[
    Float[np.ndarray, "h cam 3"],
    Float[np.ndarray, "h cam 3"],
    Float[np.ndarray, "h cam"],
]:
    """Rays of each row's members; absent members have weight 0."""
    weight = np.where(member >= 0, rays.weight[member], 0)
    return np.asarray(rays.origin)[member], np.asarray(rays.direction)[member], weight


def triangulate_groups(
    rays: Rays,
    groups: Int[np.ndarray, "h cam"],
    settings: TriangulationSettings,
    *,
    sigma_theta: float,
) -> tuple[Float[np.ndarray, "h 3"], Float[np.ndarray, "h cam"]]:
    """Triangulate each group of rays, and measure the angular residual of each ray.

    Args:
        rays: ray of each observation in the canonical frame.
        groups: (H, C) observation of each camera, or -1.
        settings: the estimator.
        sigma_theta: angular noise in radians; only the best-pair baseline needs it.

    Returns:
        (H, 3) positions and (H, C) residuals in radians, NaN for rays that were not used.

    Source:
        Sec. "Robust 3D position estimation"; Table "baselines" for the other estimators.
    """

    def block(member: Int[np.ndarray, "h cam"]) -> tuple[Array, Array]:
        return _triangulate_block(
            *_gather(rays, member),
            settings.huber_scale,
            sigma_theta,
            refit=settings.refit_inliers,
            estimator=settings.estimator,
            constrained=settings.constrain_to_ground,
        )

    position, residual = in_blocks(block, (groups,), HYPOTHESIS_BLOCK)
    return position, np.where(groups >= 0, residual, np.nan)


@partial(jax.jit, static_argnames=("refit", "estimator", "constrained"))
def _triangulate_block(
    origin: Float[Array, "h cam 3"],
    direction: Float[Array, "h cam 3"],
    weight: Float[Array, "h cam"],
    huber_scale: Scalar,
    sigma_theta: Scalar,
    *,
    refit: bool,
    estimator: Literal["rays", "best_pair", "single_ray"],
    constrained: bool,
) -> tuple[Float[Array, "h 3"], Float[Array, "h cam"]]:
    def place(o: Array, d: Array, w: Array) -> tuple[Float[Array, "3"], Float[Array, " cam"]]:
        if estimator == "best_pair":
            w = _best_pair(o, d, w, sigma_theta)
        elif estimator == "single_ray":
            w = jnp.where(jnp.arange(len(w)) == jnp.argmax(w), w, 0)
        if estimator == "single_ray":
            position = ground_point(o[jnp.argmax(w)], d[jnp.argmax(w)])
        elif constrained:
            position = triangulate_on_ground(o, d, w, huber_scale, refit=refit)
        else:
            position = triangulate(o, d, w, huber_scale, refit=refit).position
        angle = jax.vmap(angular_residual, (None, 0, 0))(position, o, d)
        return position, jnp.where(w > 0, angle, jnp.nan)

    return jax.vmap(place)(origin, direction, weight)


def _best_pair(
    origins: Float[Array, "cam 3"],
    directions: Float[Array, "cam 3"],
    weights: Float[Array, " cam"],
    sigma_theta: Scalar,
) -> Float[Array, " cam"]:
    """Weights that keep only the pair of rays with the smallest sigma (baseline B)."""
    pairs = jnp.asarray(np.stack(np.triu_indices(len(origins), k=1), axis=-1))

    def uncertainty(pair: Int[Array, "2"]) -> Float[Array, ""]:
        o, d, w = origins[pair], directions[pair], weights[pair]
        point = triangulate(o, d, w, 1.0, refit=False).position
        sigma = ground_sigma(information(point, o, d, w, sigma_theta), GROUND)
        return jnp.where(jnp.all(w > 0), sigma, jnp.inf)

    best = pairs[jnp.argmin(jax.vmap(uncertainty)(pairs))]
    return jnp.zeros_like(weights).at[best].set(weights[best])


def find_support(
    table: RayTable,
    frame_index: Int[np.ndarray, " h"],
    position: Float[np.ndarray, "h 3"],
    *,
    radius: float,
) -> Int[np.ndarray, "h cam"]:
    """Find the ray of each camera that supports each position: the most reliable in the radius.

    Args:
        table: all rays.
        frame_index: (H,) frame of each position.
        position: (H, 3) canonical positions.
        radius: support radius in radians.

    Returns:
        (H, C) observation, or -1. Support is shared: one ray may support several positions.

    Source:
        Sec. "Selecting pedestrian positions", support recount.
    """
    cameras, depth = table.weight.shape[1:]
    block = HYPOTHESIS_BLOCK
    while block > 64 and block * cameras * depth > RESIDUALS_AT_ONCE:
        block //= 2
    index = in_blocks(
        lambda frame, points: _find_block(
            points, table.origin, table.direction[frame], table.weight[frame], radius
        ),
        (frame_index, position),
        block,
    )
    return np.where(index >= 0, index + table.cell_start[frame_index], -1)


_find_block = jax.jit(jax.vmap(support, (0, None, 0, 0, None)))


def measure_support(
    rays: Rays,
    member: Int[np.ndarray, "h cam"],
    position: Float[np.ndarray, "h 3"],
    *,
    sigma_theta: float,
) -> Support:
    """Measure how well the supporting rays determine each position.

    Args:
        rays: ray of each observation in the canonical frame.
        member: (H, C) supporting observation of each camera, or -1.
        position: (H, 3) canonical positions.
        sigma_theta: angular noise in radians.

    Returns:
        The support with its uncertainty.

    Source:
        Eq. sigma.
    """
    sigma, covariance, weight, residual = in_blocks(
        lambda member, position: _measure_block(*_gather(rays, member), position, sigma_theta),
        (member, position.astype(rays.direction.dtype)),
        HYPOTHESIS_BLOCK,
    )
    return Support(member, np.where(member >= 0, residual, np.nan), sigma, covariance, weight)


@jax.jit
def _measure_block(
    origins: Float[Array, "h cam 3"],
    directions: Float[Array, "h cam 3"],
    weights: Float[Array, "h cam"],
    position: Float[Array, "h 3"],
    sigma_theta: Scalar,
) -> tuple[Array, Array, Array, Array]:
    def measure(o: Array, d: Array, w: Array, position: Array) -> tuple[Array, Array, Array, Array]:
        precision = information(position, o, d, w, sigma_theta)
        covariance = ground_covariance(precision, GROUND)
        enough = (w > 0).sum() >= 2
        sigma = jnp.where(enough, jnp.sqrt(jnp.trace(covariance) / 2), jnp.inf)
        angle = jax.vmap(angular_residual, (None, 0, 0))(position, o, d)
        return sigma, jnp.where(enough, covariance, jnp.inf), w.sum(), angle

    return jax.vmap(measure)(origins, directions, weights, position)


def exclusive_support(support: Support) -> Int[np.ndarray, "h cam"]:
    """Assign each ray only to the position that it passes closest (lineage K), (H, C)."""
    present = support.member >= 0
    nearest = np.full(int(support.member.max(initial=0)) + 1, np.inf, support.residual.dtype)
    np.minimum.at(nearest, support.member[present], support.residual[present])
    return np.where(present & (support.residual <= nearest[support.member]), support.member, -1)
