"""The minimizer of the Huber loss over many sets of rays at once, without derivatives."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from catfree.geometry._arrays import epsilon
from catfree.geometry._symmetric3 import Vector
from catfree.geometry._triangulation._ray_distances import (
    CenteredRays,
    batch_last,
    dot,
    gradient_of,
    hessian_of,
    norm,
    present_rays,
    residuals_of,
    solve_regularized,
)

# Bounds the work: over half a million random problems of 2 to 7 rays with up to 30 % wrong ones,
# the mean was at most 9 steps and the maximum 31.
MAXIMUM_STEPS = 60
# After this many steps a predicted gain below the rounding of the loss counts as noise (float32
# pairs whose loss is almost flat).
PATIENT_STEPS = 20
# Maximum number of problems that step together: more would not fit in a core's cache.
BLOCK = 16384
# Factor by which the damping falls after a step that gained as predicted. Any value between 3 and
# 30 performs about the same.
FALL = 10
# Most problems converge in 5 steps; the slowest of a block takes 13. So the unconverged quarter
# continues in a smaller array, repeatedly, down to this many problems, where a step costs little
# more than its function calls.
FEW = 64
# With fewer problems, XLA sums over rays one problem after the other, which takes longer.
WIDE = 1024


class Roles(NamedTuple):
    """The role of each ray in a fit.

    Attributes:
        inliers: (C,) bool, the rays within `factor * delta` of the first fit.
        used: (C,) bool, the rays whose loss the position minimizes.
    """

    inliers: Array
    used: Array


@batch_last
def search_minimizer(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> tuple[Array, Roles]:
    """Fit a position to (C, 3) origins and directions, without derivatives.

    Returns the position relative to the weighted mean of the present camera centers, and the roles.
    If at least two rays but not all are inliers, a second round uses the inliers only.
    """
    shape, size = delta.shape, delta.size
    blocks = max(1, -(-size // BLOCK))
    length = -(-size // blocks)
    length = max(length, WIDE) if length > FEW else length

    def cut(array: Array) -> Array:
        flat = array.reshape(*array.shape[: array.ndim - len(shape)], size)
        spare = [(0, 0)] * (flat.ndim - 1) + [(0, blocks * length - size)]
        # Padding has weight 0: it has converged before it starts.
        return jnp.moveaxis(jnp.pad(flat, spare).reshape(*flat.shape[:-1], blocks, length), -2, 0)

    def join(array: Array) -> Array:
        flat = jnp.moveaxis(array, 0, -2).reshape(*array.shape[1:-1], blocks * length)
        return flat[..., :size].reshape(*array.shape[1:-1], *shape)

    cut_up = tuple(cut(a) for a in (origins, directions, weights, delta, factor, refit))
    return jax.tree.map(join, jax.lax.map(lambda block: _search_block(*block), cut_up))


def _search_block(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> tuple[Array, Roles]:
    """Do `search_minimizer` for one block of problems that step together."""
    rays, _ = present_rays(origins, directions, weights)
    present = rays.weights > 0

    def total(rays: Array) -> Array:
        # XLA sums floats several times as fast as flags.
        return jnp.sum(rays.astype(delta.dtype), 0)

    def search(start: _Start, _: None) -> tuple[_Start, tuple[Array, ...]]:
        kept = rays._replace(weights=jnp.where(start.kept, rays.weights, 0))
        position = _iterate(kept, delta, start)
        distances = norm(residuals_of(rays, position))
        inliers = present & (distances <= (factor * delta)[None])
        remaining = total(inliers)
        again = refit & (remaining >= 2) & (remaining < total(present))
        # Without rays the second search ends at once, so only problems that need it pay for it. The
        # loss is convex: starting at the first result only shortens the second search.
        again_from = _Start(inliers & again[None], position, full / FALL, jnp.ones((), jnp.int32))
        return again_from, (jnp.stack(position), inliers, again)

    zero, full = jnp.zeros_like(delta), jnp.ones_like(delta)
    start = _Start(present, (zero, zero, zero), full, jnp.zeros((), jnp.int32))
    _, (position, inliers, again) = jax.lax.scan(search, start, length=2)
    position = jnp.where(again[:1], position[1], position[0])
    used = jnp.where(again[:1], inliers[0], present)
    return position, Roles(inliers[0], used)


class _Start(NamedTuple):
    """Rays of a search, its starting point, damping and step count."""

    kept: Array
    position: Vector
    damping: Array
    steps: Array


class _State(NamedTuple):
    """State of a search.

    Attributes:
        position: the best so far.
        loss: twice Huber's loss, infinite before the first step.
        length: length of the last step; 0 if it was the first, which treats every ray as near, or
            did not lower the loss.
        damping: from 0 (Newton's method) to 1 (reweighted least squares).
        converged: whether the search ended.
        steps: number of steps, common to all problems.
    """

    position: Vector
    loss: Array
    length: Array
    damping: Array
    converged: Array
    steps: Array


class _Problem(NamedTuple):
    """Rays and Huber scale of a search; `reach` is each origin's distance from the center."""

    rays: CenteredRays
    delta: Array
    reach: Array


def _iterate(rays: CenteredRays, delta: Array, start: _Start) -> Vector:
    """Minimize the loss from a start: step until all problems have converged."""
    problem = _Problem(rays, delta, norm(rays.origins))
    state = _State(
        position=start.position,
        loss=jnp.full_like(delta, jnp.inf),
        length=jnp.zeros_like(delta),
        damping=start.damping,
        converged=jnp.sum(rays.weights, 0) == 0,
        steps=start.steps,
    )
    return _take_all_steps(problem, state)


def _take_all_steps(problem: _Problem, state: _State) -> Vector:
    """Step until all problems have converged, moving the last ones to ever smaller arrays."""
    width = len(state.converged)
    if width <= FEW:
        return _take_steps(problem, state, until=0).position
    few = width // 4 if width >= 4 * WIDE else FEW
    state = _take_steps(problem, state, until=few)
    (left,) = jnp.nonzero(~state.converged, size=few, fill_value=width)
    problem, remaining = jax.tree.map(
        lambda a: jnp.take(a, left, axis=-1, mode="clip"), (problem, state._replace(steps=()))
    )
    remaining = remaining._replace(steps=state.steps, converged=left == width)
    positions = _take_all_steps(problem, remaining)
    x, y, z = (
        everywhere.at[left].set(some, mode="drop")
        for everywhere, some in zip(state.position, positions, strict=True)
    )
    return x, y, z


def _take_steps(problem: _Problem, state: _State, *, until: int) -> _State:
    """Step until at most `until` problems have not converged."""
    return jax.lax.while_loop(
        lambda state: (jnp.sum(~state.converged) > until) & (state.steps <= MAXIMUM_STEPS),
        partial(_step, problem),
        state,
    )


def _step(problem: _Problem, state: _State) -> _State:
    """Take one step between reweighted least squares and Newton's method.

    A reweighted step solves with `A = sum_i w_i c_i (I - d_i d_iᵀ)`, c_i = min(1, delta / r_i),
    and never raises the loss, but converges only linearly, and arbitrarily slowly where two rays
    of nearly equal weight are both far (thousands of steps). The Hessian is
    `A - sum_far w_i c_i r̂_i r̂_iᵀ`. Solving with `A - (1 - damping) sum_far ...` spans both: damping
    falls while the loss falls as predicted, and rises towards the plain step where it does not.
    """
    rays, delta, reach = problem
    unit = epsilon(delta.dtype)
    first = state.steps == 0
    residuals = residuals_of(rays, state.position)
    distances = norm(residuals)
    # The first step treats every ray as near: it finds the least-squares solution.
    far = (distances > delta[None]) & ~first
    shrink = jnp.where(far, 1 / jnp.where(far, distances, 1), 0)
    weights = rays.weights * jnp.where(far, delta[None] * shrink, 1)
    bend = (1 - state.damping)[None] * weights * shrink * shrink
    gradient = gradient_of(weights, residuals)
    move = solve_regularized(hessian_of(rays, weights, bend, residuals), gradient)
    predicted = dot(gradient, move)
    # Rounding alone changes the loss by this much: distances are differences of lengths.
    error = 4 * unit * (reach + norm(state.position)[None])
    rounding = jnp.sum(weights * error * (distances + (distances + error)), 0)

    x, y, z = state.position
    proposal = (x - move[0], y - move[1], z - move[2])
    distances = norm(residuals_of(rays, proposal))
    linear = jnp.minimum(distances, delta[None])
    loss = jnp.sum(rays.weights * linear * (distances + (distances - linear)), 0)
    gain = state.loss - loss + rounding
    better = ~state.converged & (gain >= 0)
    damping = jnp.where(
        gain >= 0.5 * predicted,
        state.damping / FALL,
        jnp.where(gain >= 0.1 * predicted, state.damping, state.damping * 5),
    )
    resolution = 1e-2 * unit**0.5 * delta + 8 * unit * norm(state.position)
    length = norm(move)
    converged = (
        (length <= resolution)
        # If steps shrink by the same factor from here on, they sum to at most the resolution.
        | (better & (length * length <= resolution * (state.length - length)))
        | (~better & (state.damping >= 1))  # only rounding stops a plain step
        | ((state.steps >= PATIENT_STEPS) & (predicted <= rounding))
    )
    return _State(
        position=jax.tree.map(partial(jnp.where, better), proposal, state.position),
        loss=jnp.where(better, loss, state.loss),
        length=jnp.where(better & ~first, length, 0),
        # The floor keeps the matrix regular where the loss is flat (two far rays of equal
        # weight).
        damping=jnp.clip(damping, unit**0.5, 1),
        converged=state.converged | (converged & ~first),
        steps=state.steps + 1,
    )
