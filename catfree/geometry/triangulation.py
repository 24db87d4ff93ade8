"""One point from several rays: weighted least squares and its robust Huber version.

The objective is the paper's `sum_i w_i rho_delta(|(I - d_i d_iᵀ)(x - o_i)|)`. Coordinates are
centred on the weighted mean of the present camera centres before anything is solved, so float32
keeps its digits in scenes far from the origin. Derivatives are those of the minimizer (implicit
function theorem), not of the iterations that found it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from catfree.geometry import symmetric3
from catfree.geometry.arrays import HostOrDevice, Scalar, epsilon, float_arrays
from catfree.geometry.symmetric3 import Triangle, Vector

# Bounds the work: over half a million random problems of 2 to 7 rays with up to 30 % wrong ones,
# the mean was at most 8 steps and the largest number 24.
MAXIMUM_STEPS = 60
# After so many steps a predicted gain below the rounding of the loss is taken for noise (float32
# pairs whose loss is almost flat).
PATIENT_STEPS = 20
# Problems that take their steps together: few enough that their arrays stay in a core's cache.
BLOCK = 4096
# When no more than this share of a full block is still at work, it goes on without the others.
# Half the problems converge in 5 steps and four fifths in 6; the slowest of a block takes 13.
STRAGGLERS = 0.25


class Triangulation(eqx.Module):
    """A position from rays, and what each ray had to do with it.

    Attributes:
        position: (3,) in the world frame, scene units.
        distances: (C,) perpendicular distance of the position to each ray's line in scene units;
            0 for absent rays.
        inliers: (C,) bool, the rays that the position rests on.
    """

    position: Float[Array, "3"]
    distances: Float[Array, " cam"]
    inliers: Bool[Array, " cam"]


def triangulate(
    origins: Real[HostOrDevice, "cam 3"],
    directions: Real[HostOrDevice, "cam 3"],
    weights: Real[HostOrDevice, " cam"],
    huber_scale: Scalar,
    *,
    refit: bool = True,
    outlier_factor: float = 3.0,
) -> Triangulation:
    """The point that best fits the rays of one person, whatever a few wrong rays say.

    Minimizes the Huber loss from the weighted least-squares start to convergence; if some rays are
    then farther than `outlier_factor * huber_scale` and at least two are not, solves again for
    those alone.

    Args:
        origins: (C, 3) camera centres in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent one, whose numbers are not used.
        huber_scale: () delta in scene units: distances beyond count linearly.
        refit: solve again without the outliers.
        outlier_factor: a ray is an outlier beyond this many deltas.

    Returns:
        Triangulation. Differentiable in origins, directions and weights; `inliers` is piecewise
        constant. What the rays leave undetermined (one ray, parallel rays) is taken nearest to
        the weighted mean of the camera centres, so one ray gives its own origin; without any
        present ray the position is the zero vector.

    Source: paper, Sec. "Robust 3D position estimation"; Huber (1964) for the loss.
    """
    arrays = float_arrays(origins, directions, weights, huber_scale, outlier_factor)
    return _triangulate(*arrays, jnp.asarray(refit))


@jax.jit
def _triangulate(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> Triangulation:
    """`triangulate`, compiled: without, each single call would trace its loops anew."""
    rays, center = _present_rays(origins, directions, weights)
    found = _search(*jax.lax.stop_gradient((*rays, delta, factor)), refit)
    position, inliers, used = found
    fitted = rays._replace(weights=jnp.where(used, rays.weights, 0))
    position = _attach_derivative(fitted, position, delta)
    distances = _norm(_residuals(rays, _entries(position)))
    return Triangulation(center + position, jnp.where(rays.weights > 0, distances, 0), inliers)


def triangulate_least_squares(
    origins: Real[HostOrDevice, "cam 3"],
    directions: Real[HostOrDevice, "cam 3"],
    weights: Real[HostOrDevice, " cam"],
) -> Float[Array, "3"]:
    """The point with the smallest weighted sum of squared distances to the rays' lines.

    Args:
        origins: (C, 3) camera centres in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent one, whose numbers are not used.

    Returns:
        (3,) position in scene units; degenerate rays are treated as in `triangulate`.
    """
    return _triangulate_least_squares(*float_arrays(origins, directions, weights))


@jax.jit
def _triangulate_least_squares(origins: Array, directions: Array, weights: Array) -> Array:
    rays, center = _present_rays(origins, directions, weights)
    position = _least_squares(*jax.lax.stop_gradient(rays))
    return center + _attach_derivative(rays, position, None)


class _Rays(NamedTuple):
    """Present rays in centred coordinates; absent rows hold harmless numbers and weight 0.

    Here and below the coordinates come first, then the cameras, last a batch if there is one: so
    the short sums over coordinates and cameras run along the batch.
    """

    origins: Float[Array, "3 cam *batch"]
    directions: Float[Array, "3 cam *batch"]
    weights: Float[Array, "cam *batch"]


def _present_rays(origins: Array, directions: Array, weights: Array) -> tuple[_Rays, Array]:
    """Rays in coordinates centred on the weighted mean of the present origins, and that mean."""
    present = weights > 0  # false for NaN too
    weights = jnp.where(present, weights, 0)
    # The double where: NaN of absent rows must reach neither the value nor the gradient.
    origins = jnp.where(present[None, :], origins.T, 0)
    directions = jnp.where(present[None, :], directions.T, 0)
    total = jnp.sum(weights)
    center = jnp.sum(weights[None, :] * origins, axis=1) / jnp.where(total > 0, total, 1)
    return _Rays(origins - center[:, None], directions, weights), center


def _batch_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let `jax.vmap` put its axis behind all others, where it is contiguous, not in front."""
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _(size: int, in_batch: list[bool], *arguments: Array) -> tuple[Any, Any]:
        moved = [
            jnp.moveaxis(a, 0, -1) if mapped else jnp.broadcast_to(a[..., None], (*a.shape, size))
            for a, mapped in zip(arguments, in_batch, strict=True)
        ]
        found = jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), batched(*moved))
        return found, jax.tree.map(lambda _: True, found)

    return batched


def _dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(vector: Vector) -> Array:
    """Length, with gradient 0 (not NaN) at the zero vector."""
    squared = _dot(vector, vector)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def _entries(vector: Array) -> Vector:
    return vector[0], vector[1], vector[2]


def _residuals(rays: _Rays, position: Vector) -> Vector:
    """Perpendicular vectors from each line to the position, (C, ...) each coordinate.

    Projected twice: the first leaves rounding errors along the ray, as long as the viewing
    distance times epsilon, that would dominate what nearly parallel rays say about depth.
    """
    x, y, z = (p[None] - o for p, o in zip(position, rays.origins, strict=True))
    u, v, w = _entries(rays.directions)
    for _ in range(2):
        along = x * u + y * v + z * w
        x, y, z = x - along * u, y - along * v, z - along * w
    return x, y, z


def _huber_weights(distances: Array, delta: Array) -> Array:
    """`min(1, delta / distance)`: what turns Huber's loss into weighted least squares."""
    far = distances > delta
    return jnp.where(far, delta / jnp.where(far, distances, 1), 1)


def _gradient(weights: Array, residuals: Vector) -> Vector:
    x, y, z = residuals
    return jnp.sum(weights * x, 0), jnp.sum(weights * y, 0), jnp.sum(weights * z, 0)


def _hessian(rays: _Rays, weights: Array, bend: Array, residuals: Vector) -> Triangle:
    """Lower triangle of `sum_i weights_i (I - d_i d_iᵀ) - bend_i r_i r_iᵀ`."""
    (u, v, w), (x, y, z) = _entries(rays.directions), residuals
    return (
        jnp.sum(weights * (1 - u * u) - bend * x * x, 0),
        jnp.sum(-weights * v * u - bend * y * x, 0),
        jnp.sum(weights * (1 - v * v) - bend * y * y, 0),
        jnp.sum(-weights * w * u - bend * z * x, 0),
        jnp.sum(-weights * w * v - bend * z * y, 0),
        jnp.sum(weights * (1 - w * w) - bend * z * z, 0),
    )


def _solve(matrix: Triangle, vector: Vector) -> Vector:
    """Solve with the matrix plus a few epsilons of its trace.

    That bounds what degenerate rays leave open; rounding the matrix's own entries changes the
    solution of a well-posed problem as much.
    """
    a00, a10, a11, a20, a21, a22 = matrix
    scale = 4 * epsilon(a00.dtype) * (a00 + a11 + a22)
    scale = jnp.where(scale > 0, scale, 1)
    return symmetric3.solve_triangle((a00 + scale, a10, a11 + scale, a20, a21, a22 + scale), vector)


@_batch_last
def _least_squares(origins: Array, directions: Array, weights: Array) -> Array:
    """Weighted least squares, refined with residuals that are more exact than the matrix."""
    rays = _Rays(origins, directions, weights)
    zero = jnp.zeros_like(weights)
    matrix = _hessian(rays, weights, zero, (zero, zero, zero))

    def refine(_: Any, position: Array) -> Array:
        gradient = _gradient(weights, _residuals(rays, _entries(position)))
        return position - jnp.stack(_solve(matrix, gradient))

    return jax.lax.fori_loop(0, 3, refine, jnp.zeros_like(origins[:, 0]))


def _attach_derivative(rays: _Rays, position: Array, delta: Array | None) -> Array:
    """The given minimizer of the objective with the derivatives of a minimizer.

    delta None stands for least squares.
    """

    def gradient(position: Array) -> Array:
        residuals = _residuals(rays, _entries(position))
        weights = rays.weights
        if delta is not None:
            weights = weights * _huber_weights(_norm(residuals), delta)
        return jnp.stack(_gradient(weights, residuals))

    return jax.lax.custom_root(gradient, position, lambda _, found: found, _solve_tangent)


def _solve_tangent(linear: Any, right_side: Array) -> Array:
    """Solve `linear(x) = right_side` for the symmetric Hessian of the objective."""
    hessian = jax.vmap(linear)(jnp.eye(3, dtype=right_side.dtype))
    triangle = symmetric3.lower_triangle((hessian + hessian.T) / 2)
    return jnp.stack(_solve(triangle, _entries(right_side)))


@_batch_last
def _search(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> tuple[Array, Array, Array]:
    """Position, inliers and the rays it rests on, without derivatives.

    The second of two rounds is for the inliers alone, where they are enough and not all.
    """
    shape = delta.shape
    if delta.size < BLOCK:
        return _search_block(origins, directions, weights, delta, factor, refit)
    blocks = -(-delta.size // BLOCK)

    def cut(array: Array) -> Array:
        flat = array.reshape(*array.shape[: array.ndim - len(shape)], -1)
        spare = [(0, 0)] * (flat.ndim - 1) + [(0, blocks * BLOCK - delta.size)]
        # Padding has weight 0: it has converged before it starts.
        return jnp.moveaxis(jnp.pad(flat, spare).reshape(*flat.shape[:-1], blocks, BLOCK), -2, 0)

    def join(array: Array) -> Array:
        flat = jnp.moveaxis(array, 0, -2).reshape(*array.shape[1:-1], -1)
        return flat[..., : delta.size].reshape(*array.shape[1:-1], *shape)

    cut_up = tuple(cut(a) for a in (origins, directions, weights, delta, factor, refit))
    return jax.tree.map(join, jax.lax.map(lambda block: _search_block(*block), cut_up))


def _search_block(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> tuple[Array, Array, Array]:
    """`_search` of problems that take their steps together."""
    present = weights > 0

    def search(kept: Array, _: None) -> tuple[Array, tuple[Array, Array, Array]]:
        rays = _Rays(origins, directions, jnp.where(kept, weights, 0))
        position = _iterate(rays, delta)
        distances = _norm(_residuals(rays, position))
        inliers = present & (distances <= (factor * delta)[None])
        again = refit & (jnp.sum(inliers, 0) >= 2) & jnp.any(present & ~inliers, 0)
        # Without rays the second search ends at once, so only those who need it pay for it.
        return inliers & again[None], (jnp.stack(position), inliers, again)

    _, (position, inliers, again) = jax.lax.scan(search, present, length=2)
    position = jnp.where(again[0], position[1], position[0])
    return position, inliers[0], jnp.where(again[0], inliers[0], present)


class _State(NamedTuple):
    """Where a search is; `loss` is twice Huber's loss, infinite before the first step."""

    position: Vector
    loss: Array
    damping: Array
    converged: Array
    steps: Array


class _Problem(NamedTuple):
    """What a search minimizes over, and how far the origins are from the middle."""

    rays: _Rays
    delta: Array
    reach: Array


def _iterate(rays: _Rays, delta: Array) -> Vector:
    """The minimizer of the loss from the least-squares start: steps until all have converged."""
    problem = _Problem(rays, delta, _norm(_entries(rays.origins)))
    zero = jnp.zeros_like(delta)
    state = _State(
        position=(zero, zero, zero),
        loss=jnp.full_like(delta, jnp.inf),
        damping=jnp.ones_like(delta),
        converged=~jnp.any(rays.weights > 0, 0),
        steps=jnp.zeros((), jnp.int32),
    )
    if delta.shape != (BLOCK,):  # in a small batch, a step costs little more than its calls
        return _take_steps(problem, state, until=0).position
    few = int(STRAGGLERS * BLOCK)
    state = _take_steps(problem, state, until=few)
    (left,) = jnp.nonzero(~state.converged, size=few, fill_value=BLOCK)
    problem, rest = jax.tree.map(
        lambda a: jnp.take(a, left, axis=-1, mode="clip"), (problem, state._replace(steps=()))
    )
    rest = rest._replace(steps=state.steps, converged=left == BLOCK)
    rest = _take_steps(problem, rest, until=0)
    x, y, z = (
        everywhere.at[left].set(some, mode="drop")
        for everywhere, some in zip(state.position, rest.position, strict=True)
    )
    return x, y, z


def _take_steps(problem: _Problem, state: _State, *, until: int) -> _State:
    """Go on until at most so many problems have not converged."""
    return jax.lax.while_loop(
        lambda state: (jnp.sum(~state.converged) > until) & (state.steps <= MAXIMUM_STEPS),
        partial(_step, problem),
        state,
    )


def _step(problem: _Problem, state: _State) -> _State:
    """Reweighted least squares that turns into Newton's method as far as that proves itself.

    A reweighted step solves with `A = sum_i w_i c_i (I - d_i d_iᵀ)`, c_i = min(1, delta / r_i),
    and never raises the loss, but converges only linearly, and arbitrarily slowly where two rays
    of nearly equal weight are both far (thousands of steps). The Hessian is
    `A - sum_far w_i c_i r̂_i r̂_iᵀ`. Solving with `A - (1 - damping) sum_far ...` spans both: damping
    falls while the loss falls as predicted, and rises towards the plain step where it does not.
    """
    rays, delta, reach = problem
    unit = epsilon(delta.dtype)
    first = state.steps == 0
    residuals = _residuals(rays, state.position)
    distances = _norm(residuals)
    # To the first step every ray is near: it finds the least-squares solution.
    far = (distances > delta[None]) & ~first
    shrink = jnp.where(far, 1 / jnp.where(far, distances, 1), 0)
    weights = rays.weights * jnp.where(far, delta[None] * shrink, 1)
    bend = (1 - state.damping)[None] * weights * shrink * shrink
    gradient = _gradient(weights, residuals)
    move = _solve(_hessian(rays, weights, bend, residuals), gradient)
    predicted = _dot(gradient, move)
    # Rounding alone changes the loss by so much: distances are differences of lengths.
    error = 4 * unit * (reach + _norm(state.position)[None])
    rounding = jnp.sum(weights * error * (2 * distances + error), 0)

    x, y, z = state.position
    proposal = (x - move[0], y - move[1], z - move[2])
    distances = _norm(_residuals(rays, proposal))
    linear = jnp.minimum(distances, delta[None])
    loss = jnp.sum(rays.weights * linear * (2 * distances - linear), 0)
    gain = state.loss - loss + rounding
    better = ~state.converged & (gain >= 0)
    damping = jnp.where(
        gain >= 0.5 * predicted,
        state.damping / 3,
        jnp.where(gain >= 0.1 * predicted, state.damping, state.damping * 5),
    )
    resolution = 1e-2 * unit**0.5 * delta + 8 * unit * _norm(state.position)
    converged = (
        (_norm(move) <= resolution)
        | (~better & (state.damping >= 1))  # only rounding stops a plain step
        | ((state.steps >= PATIENT_STEPS) & (predicted <= rounding))
    )
    return _State(
        position=jax.tree.map(partial(jnp.where, better), proposal, state.position),
        loss=jnp.where(better, loss, state.loss),
        # The floor keeps the matrix regular where the loss is flat (two far rays of equal
        # weight).
        damping=jnp.clip(damping, unit**0.5, 1),
        converged=state.converged | (converged & ~first),
        steps=state.steps + 1,
    )
