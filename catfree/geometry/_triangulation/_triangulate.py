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
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from catfree.geometry import _symmetric3 as symmetric3
from catfree.geometry._arrays import Scalar, float_arrays
from catfree.geometry._symmetric3 import Vector
from catfree.geometry._triangulation._huber_search import Fit, search_minimizer
from catfree.geometry._triangulation._ray_distances import (
    Rays,
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

    Source: paper, Sec. "Robust 3D position estimation"; Huber (1964) for the loss.
    """
    arrays = float_arrays(origins, directions, weights, huber_scale, outlier_factor)
    return _triangulate(*arrays, jnp.asarray(refit))


@jax.jit
def _triangulate(
    origins: Array, directions: Array, weights: Array, delta: Array, factor: Array, refit: Array
) -> Triangulation:
    """Compiled body of `triangulate`: uncompiled, every call would trace its loops again."""
    fit = _fit(origins, directions, weights, delta, factor, refit)
    return Triangulation(fit.center + fit.position, fit.distances, fit.inliers)


_fit = jax.custom_jvp(search_minimizer)


@_fit.defjvp
def _differentiate_fit(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Fit, Fit]:
    """The fit and its tangent with respect to rays, weights and delta, for fixed inliers."""
    fit = _fit(*primals)

    def moving(
        origins: Array, directions: Array, weights: Array, delta: Array
    ) -> tuple[Array, Array, Array]:
        rays, center = present_rays(origins, directions, weights)
        fitted = rays._replace(weights=jnp.where(fit.used, rays.weights, 0))
        position = _attach_derivative(fitted, fit.position, delta)
        distances = norm(residuals_of(rays, entries(position)))
        return center, position, jnp.where(rays.weights > 0, distances, 0)

    _, moved = jax.jvp(moving, primals[:4], tangents[:4])
    fixed = np.zeros(fit.used.shape, jax.dtypes.float0)
    return fit, Fit(*moved, inliers=fixed, used=fixed)  # pyright: ignore[reportArgumentType]


def triangulate_least_squares(
    origins: Real[HostOrDevice, "cam 3"],
    directions: Real[HostOrDevice, "cam 3"],
    weights: Real[HostOrDevice, " cam"],
) -> Float[Array, "3"]:
    """The point with the smallest weighted sum of squared distances to the rays' lines.

    Args:
        origins: (C, 3) camera centers in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent ray, whose values are ignored.

    Returns:
        (3,) position in scene units; degenerate rays are treated as in `triangulate`.

    Source: paper, Sec. "Robust 3D position estimation", with rho the square.
    """
    return _triangulate_least_squares(*float_arrays(origins, directions, weights))


@jax.jit
def _triangulate_least_squares(origins: Array, directions: Array, weights: Array) -> Array:
    rays, center = present_rays(origins, directions, weights)
    position = _least_squares(*jax.lax.stop_gradient(rays))
    return center + _attach_derivative(rays, position, None)


@batch_last
def _least_squares(origins: Vector, directions: Vector, weights: Array) -> Array:
    """Weighted least squares, refined with residuals that are more accurate than the matrix."""
    rays = Rays(origins, directions, weights)
    zero = jnp.zeros_like(weights)
    matrix = hessian_of(rays, weights, zero, (zero, zero, zero))

    def refine(_: Any, position: Array) -> Array:
        gradient = gradient_of(weights, residuals_of(rays, entries(position)))
        return position - jnp.stack(solve_regularized(matrix, gradient))

    return jax.lax.fori_loop(0, 3, refine, jnp.stack([jnp.zeros_like(weights[0])] * 3))


def _attach_derivative(rays: Rays, position: Array, delta: Array | None) -> Array:
    """Attach the derivatives of the minimizer to its value; delta None means least squares."""

    def gradient(position: Array) -> Array:
        residuals = residuals_of(rays, entries(position))
        weights = rays.weights
        if delta is not None:
            weights = weights * huber_weights(norm(residuals), delta)
        return jnp.stack(gradient_of(weights, residuals))

    return jax.lax.custom_root(gradient, position, lambda _, start: start, _solve_tangent)


def _solve_tangent(linear: Any, right_side: Array) -> Array:
    """Solve `linear(x) = right_side` for the symmetric Hessian of the objective."""
    hessian = jax.vmap(linear)(jnp.eye(3, dtype=right_side.dtype))
    triangle = symmetric3.lower_triangle((hessian + hessian.T) / 2)
    return jnp.stack(solve_regularized(triangle, entries(right_side)))
