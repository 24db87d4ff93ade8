"""One point from several rays: weighted least squares and its robust Huber version.

The objective is the paper's `sum_i w_i rho_delta(|(I - d_i d_iᵀ)(x - o_i)|)`. Coordinates are
centered on the weighted mean of the present camera centers before anything is solved, so float32
keeps its digits in scenes far from the origin. Derivatives are those of the minimizer (implicit
function theorem), not of the iterations that found it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Real

from catfree.errors import InvalidInputError
from catfree.geometry import _symmetric3 as symmetric3
from catfree.geometry._arrays import Scalar, float_arrays, require_rays
from catfree.geometry._symmetric3 import Triangle
from catfree.geometry._triangulation._huber_search import search_minimizer
from catfree.geometry._triangulation._ray_distances import (
    batch_last,
    entries,
    gradient_of,
    hessian_of,
    huber_weights,
    norm,
    present_rays,
    residuals_of,
    solve_regularized,
)
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import is_traced, require_shape


class Triangulation(eqx.Module):
    """A triangulated position, its distance to each ray, and the rays near it.

    Attributes:
        position: (3,) in the world frame, scene units.
        distances: (C,) perpendicular distance of the position to each ray's line in scene units;
            0 for absent rays.
        inliers: (C,) bool, the rays within `outlier_factor` deltas of the first fit.
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
    """Find the point that best fits the rays of one person, robust to a few wrong rays.

    Minimizes the Huber loss from the weighted least-squares start to convergence. If some rays are
    then farther than `outlier_factor * huber_scale` and at least two are not, solves again with
    the near ones only.

    Args:
        origins: (C, 3) camera centers in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent ray, whose values are ignored.
        huber_scale: () delta in scene units; distances beyond it count linearly.
        refit: solve again without the outliers.
        outlier_factor: rays farther than this many deltas are outliers.

    Returns:
        Triangulation. Differentiable in origins, directions and weights; `inliers` is piecewise
        constant. If the rays do not determine a point (one ray, parallel rays), it is the solution
        nearest to the weighted mean of the camera centers, so one ray gives its own origin.
        Without any present ray the position is the zero vector.

    Raises:
        InvalidInputError: if shapes do not fit, a present direction is not of length 1, or
            huber_scale is not one number, 0 or more.

    Source: paper, Sec. "Robust 3D position estimation"; Huber (1964) for the loss.
    """
    arrays = float_arrays(
        origins=origins,
        directions=directions,
        weights=weights,
        huber_scale=huber_scale,
        outlier_factor=outlier_factor,
    )
    require_rays(*arrays[:3])
    delta = arrays[3]
    require_shape(delta, (), "huber_scale")
    require_shape(arrays[4], (), "outlier_factor")
    if not is_traced(delta) and not delta >= 0:
        raise InvalidInputError(f"huber_scale is {delta}; it must be a length, 0 or more.")
    return _triangulate(*arrays, jnp.asarray(refit))


@jax.jit
def _triangulate(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> Triangulation:
    """Compiled body of `triangulate`: uncompiled, every call would trace its loops again."""
    # Lambdas, because optimistix takes only functions without closures, and jaxtyping's import hook
    # wraps every named function.
    position, roles = ADJOINT.apply(
        lambda inputs: search_minimizer(*inputs[:-1]),
        lambda position, roles, inputs: _half_gradient(position, roles.used, *inputs[:4]),
        (origins, directions, weights, delta, factor, refit),
        frozenset(),
    )
    rays, center = present_rays(origins, directions, weights)
    distances = norm(residuals_of(rays, entries(position)))
    distances = jnp.where(rays.weights > 0, distances, 0)
    return Triangulation(center + position, distances, roles.inliers)


def _half_gradient(
    position: Array, used: Array, origins: Array, directions: Array, weights: Array, delta: Array
) -> Array:
    """Compute half the gradient of the used rays' Huber loss: zero at its minimizer."""
    rays, _ = present_rays(origins, directions, weights)
    residuals = residuals_of(rays, entries(position))
    weights = jnp.where(used, rays.weights, 0) * huber_weights(norm(residuals), delta)
    return jnp.stack(gradient_of(weights, residuals))


def triangulate_least_squares(
    origins: Real[HostOrDevice, "cam 3"],
    directions: Real[HostOrDevice, "cam 3"],
    weights: Real[HostOrDevice, " cam"],
) -> Float[Array, "3"]:
    """Find the point with the smallest weighted sum of squared distances to the rays' lines.

    Args:
        origins: (C, 3) camera centers in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent ray, whose values are ignored.

    Returns:
        (3,) position in scene units; degenerate rays are treated as in `triangulate`.

    Raises:
        InvalidInputError: if shapes do not fit, or a present direction is not of length 1.

    Source: paper, Sec. "Robust 3D position estimation", with rho the square.
    """
    arrays = float_arrays(origins=origins, directions=directions, weights=weights)
    require_rays(*arrays)
    return _triangulate_least_squares(*arrays)


@jax.jit
def _triangulate_least_squares(origins: Array, directions: Array, weights: Array) -> Array:
    position, _ = ADJOINT.apply(
        lambda inputs: _solve_normal_equations(*inputs[:3]),
        lambda position, used, inputs: _half_gradient(position, used, *inputs[:4]),
        (origins, directions, weights, jnp.full((), jnp.inf, weights.dtype)),
        frozenset(),
    )
    _, center = present_rays(origins, directions, weights)
    return center + position


@batch_last
def _solve_normal_equations(
    origins: Array, directions: Array, weights: Array
) -> tuple[Array, Array]:
    """Solve weighted least squares; also return the present rays.

    Refined with residuals, which are more accurate than the matrix.
    """
    rays, _ = present_rays(origins, directions, weights)
    zero = jnp.zeros_like(rays.weights)
    matrix = hessian_of(rays, rays.weights, zero, (zero, zero, zero))

    def refine(_: Any, position: Array) -> Array:
        gradient = gradient_of(rays.weights, residuals_of(rays, entries(position)))
        return position - jnp.stack(solve_regularized(matrix, gradient))

    return jax.lax.fori_loop(
        0, 3, refine, jnp.zeros((3, *zero.shape[1:]), zero.dtype)
    ), rays.weights > 0


class _SymmetricSolver(lx.AbstractLinearSolver[Triangle]):
    """The closed form for the Hessian of a loss of rays, finite where the rays are degenerate."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Triangle:
        matrix = operator.as_matrix()
        return symmetric3.lower_triangle((matrix + matrix.T) / 2)

    def compute(
        self, state: Triangle, vector: Array, options: dict[str, Any]
    ) -> tuple[Array, lx.RESULTS, dict[str, Any]]:
        return jnp.stack(solve_regularized(state, entries(vector))), lx.RESULTS.successful, {}

    def transpose(
        self, state: Triangle, options: dict[str, Any]
    ) -> tuple[Triangle, dict[str, Any]]:
        return state, options  # symmetric

    def conj(self, state: Triangle, options: dict[str, Any]) -> tuple[Triangle, dict[str, Any]]:
        return state, options  # real

    def assume_full_rank(self) -> bool:
        return True


ADJOINT = optx.ImplicitAdjoint(_SymmetricSolver())
