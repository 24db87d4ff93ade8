"""One point from several rays: weighted least squares and its robust Huber version.

The objective is the paper's `sum_i w_i rho_delta(|(I - d_i d_iᵀ)(x - o_i)|)`. Coordinates are
centred on the weighted mean of the present camera centres before anything is solved, so float32
keeps its digits in scenes far from the origin. Derivatives are those of the minimizer (implicit
function theorem), not of the iterations that found it.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Real

from catfree.geometry import symmetric3
from catfree.geometry.arrays import HostOrDevice, Scalar, epsilon, float_arrays, safe_norm

# Bounds the work: over half a million random problems of 2 to 7 rays with up to 30 % wrong ones,
# the mean was at most 9 steps and the largest number 51.
MAXIMUM_STEPS = 60
# After so many steps a predicted gain below the rounding of the loss is taken for noise (float32
# pairs whose loss is almost flat).
PATIENT_STEPS = 20


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


class _Rays(NamedTuple):
    """Present rays in centred coordinates; absent rows hold harmless numbers and weight 0."""

    origins: Float[Array, "cam 3"]
    directions: Float[Array, "cam 3"]
    weights: Float[Array, " cam"]


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
    return _triangulate(*arrays, refit=refit)


@functools.partial(jax.jit, static_argnames="refit")
def _triangulate(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, *, refit: bool
) -> Triangulation:
    """`triangulate`, compiled: without, each single call would trace its loops anew."""
    rays, center = _present_rays(origins, directions, weights)
    present = rays.weights > 0
    position = _minimize(rays, delta)
    distances = safe_norm(_residuals(rays, position))
    inliers = present & (distances <= factor * delta)
    if refit:
        useful = (jnp.sum(inliers) >= 2) & jnp.any(present & ~inliers)
        # Without weights the second search ends at once, so only those who need it pay for it.
        kept = rays._replace(weights=jnp.where(inliers & useful, rays.weights, 0))
        position = jnp.where(useful, _minimize(kept, delta), position)
        distances = safe_norm(_residuals(rays, position))
    return Triangulation(center + position, jnp.where(present, distances, 0), inliers)


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
    solution = jax.lax.custom_root(
        lambda x: _gradient(rays, x, None),
        jnp.zeros_like(center),
        lambda _, start: _least_squares(rays),
        _tangent_solve,
    )
    return center + solution


def _present_rays(origins: Array, directions: Array, weights: Array) -> tuple[_Rays, Array]:
    """Rays in coordinates centred on the weighted mean of the present origins, and that mean."""
    present = weights > 0  # false for NaN too
    weights = jnp.where(present, weights, 0)
    # The double where: NaN of absent rows must reach neither the value nor the gradient.
    origins = jnp.where(present[:, None], origins, 0)
    forward = jnp.zeros_like(directions).at[:, 2].set(1)
    directions = jnp.where(present[:, None], directions, forward)
    total = jnp.sum(weights)
    center = jnp.sum(weights[:, None] * origins, axis=0) / jnp.where(total > 0, total, 1)
    return _Rays(origins - center[None, :], directions, weights), center


def _residuals(rays: _Rays, position: Array) -> Array:
    """(C, 3) perpendicular vectors from each line to the position.

    Projected twice: the first leaves rounding errors along the ray, as long as the viewing
    distance times epsilon, that would dominate what nearly parallel rays say about depth.
    """
    residual = position[None, :] - rays.origins
    for _ in range(2):
        along = jnp.sum(residual * rays.directions, axis=-1, keepdims=True)
        residual = residual - along * rays.directions
    return residual


def _huber_weights(distances: Array, delta: Array) -> Array:
    """`min(1, delta / distance)`: what turns Huber's loss into weighted least squares."""
    far = distances > delta
    return jnp.where(far, delta / jnp.where(far, distances, 1), 1)


def _gradient(rays: _Rays, position: Array, delta: Array | None) -> Array:
    """(3,) gradient of the objective; delta None stands for least squares."""
    residuals = _residuals(rays, position)
    weights = rays.weights
    if delta is not None:
        weights = weights * _huber_weights(safe_norm(residuals), delta)
    return jnp.sum(weights[:, None] * residuals, axis=0)


def _loss(weights: Array, distances: Array, delta: Array) -> Array:
    """Twice Huber's loss."""
    far = distances > delta
    linear = jnp.where(far, delta, distances)
    return jnp.sum(weights * linear * (2 * distances - linear))


def _symmetric_sum(weights: Array, vectors: Array) -> Array:
    """(3, 3) `sum_i weights_i vectors_i vectors_iᵀ` without a small batched matrix product."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    wx, wy, wz = weights * x, weights * y, weights * z
    xx, xy, xz = jnp.sum(wx * x), jnp.sum(wx * y), jnp.sum(wx * z)
    yy, yz, zz = jnp.sum(wy * y), jnp.sum(wy * z), jnp.sum(wz * z)
    return jnp.stack([jnp.stack([xx, xy, xz]), jnp.stack([xy, yy, yz]), jnp.stack([xz, yz, zz])])


def _normal_matrix(rays: _Rays, weights: Array) -> Array:
    """(3, 3) `sum_i weights_i (I - d_i d_iᵀ)`."""
    identity = jnp.eye(3, dtype=weights.dtype)
    return jnp.sum(weights) * identity - _symmetric_sum(weights, rays.directions)


def _regularized(matrix: Array) -> Array:
    """The matrix plus a few epsilons of its trace: bounds what degenerate rays leave open.

    Rounding the matrix's own entries changes the solution of a well-posed problem as much.
    """
    scale = 4 * epsilon(matrix.dtype) * jnp.trace(matrix)
    return matrix + jnp.where(scale > 0, scale, 1) * jnp.eye(3, dtype=matrix.dtype)


def _least_squares(rays: _Rays) -> Array:
    """Weighted least squares, refined with residuals that are more exact than the matrix."""
    factor = symmetric3.cholesky(_regularized(_normal_matrix(rays, rays.weights)))
    position = jnp.zeros_like(rays.origins[0])
    for _ in range(3):
        gradient = _gradient(rays, position, None)
        position = position - symmetric3.solve_factored(factor, gradient)
    return position


def _tangent_solve(linear: Any, right_side: Array) -> Array:
    """Solve `linear(x) = right_side` for the symmetric Hessian of the objective."""
    hessian = jax.vmap(linear)(jnp.eye(3, dtype=right_side.dtype))
    hessian = (hessian + hessian.T) / 2
    return symmetric3.solve_factored(symmetric3.cholesky(_regularized(hessian)), right_side)


def _minimize(rays: _Rays, delta: Array) -> Array:
    """The minimizer of the Huber objective, with the derivatives of a minimizer."""
    return jax.lax.custom_root(
        lambda x: _gradient(rays, x, delta),
        jnp.zeros_like(rays.origins[0]),
        lambda _, start: _iterate(rays, delta),
        _tangent_solve,
    )


class _Model(NamedTuple):
    """Twice the objective around a position: loss + 2 gradient·m + mᵀ(bound - curvature)m.

    Rounding alone changes the loss by about `rounding`: distances are differences of lengths.
    """

    loss: Float[Array, ""]
    rounding: Float[Array, ""]
    gradient: Float[Array, "3"]
    bound: Float[Array, "3 3"]
    curvature: Float[Array, "3 3"]


class _State(NamedTuple):
    position: Float[Array, "3"]
    model: _Model
    damping: Float[Array, ""]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]


def _model(rays: _Rays, position: Array, delta: Array) -> _Model:
    residuals = _residuals(rays, position)
    distances = safe_norm(residuals)
    far = distances > delta
    weights = rays.weights * _huber_weights(distances, delta)
    outward = residuals / jnp.where(far, distances, 1)[:, None]
    error = 4 * epsilon(delta.dtype) * safe_norm(position[None, :] - rays.origins)
    return _Model(
        loss=_loss(rays.weights, distances, delta),
        rounding=jnp.sum(weights * error * (2 * distances + error)),
        gradient=jnp.sum(weights[:, None] * residuals, axis=0),
        bound=_normal_matrix(rays, weights),
        curvature=_symmetric_sum(jnp.where(far, weights, 0), outward),
    )


def _iterate(rays: _Rays, delta: Array) -> Array:
    """Reweighted least squares that turns into Newton's method as far as that proves itself.

    A reweighted step solves with `A = sum_i w_i c_i (I - d_i d_iᵀ)`, c_i = min(1, delta / r_i),
    and never raises the loss, but converges only linearly, and arbitrarily slowly where two rays
    of nearly equal weight are both far (thousands of steps). The Hessian is
    `A - sum_far w_i c_i r̂_i r̂_iᵀ`. Solving with `A - (1 - damping) sum_far ...` spans both: damping
    falls while the loss falls as predicted, and rises towards the plain step where it does not.
    """
    dtype = delta.dtype
    unit = epsilon(dtype)

    def step(state: _State) -> _State:
        model = state.model
        matrix = _regularized(model.bound - (1 - state.damping) * model.curvature)
        move = symmetric3.solve_factored(symmetric3.cholesky(matrix), model.gradient)
        proposal = state.position - move
        proposed = _model(rays, proposal, delta)
        gain = model.loss - proposed.loss + model.rounding
        predicted = jnp.sum(model.gradient * move)
        better = gain >= 0
        damping = jnp.where(
            gain >= 0.5 * predicted,
            state.damping / 10,
            jnp.where(gain >= 0.1 * predicted, state.damping, state.damping * 5),
        )
        resolution = 1e-2 * unit**0.5 * delta + 8 * unit * safe_norm(state.position)
        return _State(
            position=jnp.where(better, proposal, state.position),
            model=jax.tree.map(lambda new, old: jnp.where(better, new, old), proposed, model),
            # The floor keeps the matrix regular where the loss is flat (two far rays of equal
            # weight).
            damping=jnp.clip(damping, unit**0.5, 1),
            converged=(safe_norm(move) <= resolution)
            | (~better & (state.damping >= 1))  # only rounding stops a plain step
            | ((state.steps >= PATIENT_STEPS) & (predicted <= model.rounding)),
            steps=state.steps + 1,
        )

    start = _least_squares(rays)
    state = _State(
        position=start,
        model=_model(rays, start, delta),
        damping=jnp.ones((), dtype),
        converged=jnp.zeros((), bool),
        steps=jnp.zeros((), jnp.int32),
    )
    final = jax.lax.while_loop(
        lambda state: ~state.converged & (state.steps < MAXIMUM_STEPS), step, state
    )
    return final.position
