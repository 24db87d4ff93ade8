"""Position errors of people who do not stand exactly on the ground plane.

Cameras on one side of a person share the error: for a foot z above the plane, their positions move
along the same ray by z times distance over camera height. Cameras on all sides cancel it. With
edges linear in the state s and in z, edges = J s + j z + noise, the estimate moves by

    ds / dz = (J'W J + prior)^-1 J'W j

and both sums add over cameras. A smoothed position depends on its neighbors in time, so the median
movement around it is used; a single chance match with another camera must not determine it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import box_edges
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._measurement import Measurements, Noise
from catfree.methods.evidence.observe._views import PEOPLE_BLOCKS, GroundViews
from catfree.methods.evidence.track._tracking import Trails
from catfree.settings import EvidenceSettings


@jax.jit
def _sums(state, member, noise, used, view, matrix):
    """(M, 3, 3) J'W J and (M, 3) J'W j of the boxes of every row."""

    def edges(matrix, extended):
        raised = jnp.asarray(matrix).at[:, 3].add(extended[3] * matrix[:, 2])
        return box_edges(raised, None, extended[:3])

    def one(state, row):
        extended = jnp.append(state, jnp.zeros((), state.dtype))
        at = jnp.maximum(row, 0)
        slopes = jax.jacfwd(edges, argnums=1)(matrix[view[at]], extended)
        weight = jnp.where((row >= 0) & used[at], 1 / noise[at] ** 2, 0.0)
        weighted = slopes[:, :3] * weight[:, None]
        return weighted.T @ slopes

    total = jax.vmap(jax.vmap(one, in_axes=(None, 0)))(state, member).sum(1)
    return total[..., :3], total[..., 3]


def ground_shift(
    trails: Trails,
    groups: Groups,
    measurements: Measurements,
    view: Int[np.ndarray, " box"],
    views: GroundViews,
    noise: Noise,
    settings: EvidenceSettings,
) -> Float[np.ndarray, "node 2"]:
    """Movement of each position per unit that its person stands above the plane.

    Args:
        trails: the tracks.
        groups: the groups of boxes.
        measurements: the boxes as likelihoods.
        view: (N,) the pinhole of each box.
        views: the cameras.
        noise: for the spread of heights.
        settings: `gap` is the number of frames on either side to consider; without
            `uneven_ground` nobody stands above the plane.

    Returns:
        (M, 2) the median (by length) of the neighboring rows, in meters per meter.
    """
    M = len(trails)
    if M == 0 or len(groups) == 0 or not settings.uneven_ground:
        return np.zeros((M, 2))
    has_group = trails.group >= 0
    member = np.where(has_group[:, None], groups.member[trails.group], -1)
    shared = measurements.noise, measurements.used, view, views.matrix
    on_device = tuple(map(jnp.asarray, shared))  # once, not for each block
    normal, cross = in_blocks(
        lambda *rows: _sums(*rows, *on_device),
        (trails.mean[:, :3], member),
        *PEOPLE_BLOCKS,
    )
    normal[:, 2, 2] += 1 / float(noise.spread) ** 2
    scale = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    movement = np.linalg.solve(normal + 1e-9 * scale * np.eye(3), cross[..., None])[:, :2, 0]
    length = np.where(has_group, np.linalg.norm(movement, axis=1), np.nan)
    # Rows of a track are consecutive frames.
    window = np.arange(M)[:, None] + np.arange(-settings.gap, settings.gap + 1)
    inside = (window >= 0) & (window < M)
    window = np.clip(window, 0, M - 1)
    inside &= trails.track[window] == trails.track[:, None]
    around = np.where(inside, length[window], np.nan)
    middle = (np.isfinite(around).sum(1, keepdims=True) - 1) // 2
    chosen = np.take_along_axis(np.argsort(around, axis=1), np.maximum(middle, 0), axis=1)
    return movement[np.take_along_axis(window, chosen, axis=1)[:, 0]]
