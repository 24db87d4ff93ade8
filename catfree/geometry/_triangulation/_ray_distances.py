"""Distances of a position to rays, with the first and second derivatives of their squares.

The axes are coordinates, cameras, then an optional batch, so that the short sums over coordinates
and cameras vectorize along the batch.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from catfree.geometry import _symmetric3 as symmetric3
from catfree.geometry._arrays import epsilon
from catfree.geometry._symmetric3 import Triangle, Vector


class CenteredRays(NamedTuple):
    """Present rays in centered coordinates; absent rows hold finite values and weight 0.

    Each coordinate is an array of its own, because slices of one array would be copied.
    """

    origins: Vector
    directions: Vector
    weights: Float[Array, "cam *batch"]


def present_rays(
    origins: Float[Array, "cam 3 *batch"],
    directions: Float[Array, "cam 3 *batch"],
    weights: Float[Array, "cam *batch"],
) -> tuple[CenteredRays, Float[Array, "3 *batch"]]:
    """Center present rays on the weighted mean of their origins; also return that mean."""
    present = weights > 0  # false for NaN too
    weights = jnp.where(present, weights, 0)

    def coordinates(vectors: Array) -> Vector:
        # Double where: NaN in absent rows must reach neither the value nor the gradient.
        x, y, z = (jnp.where(present, vectors[:, axis], 0) for axis in range(3))
        return x, y, z

    from_world = coordinates(origins)
    total = jnp.sum(weights, axis=0)
    total = jnp.where(total > 0, total, 1)
    cx, cy, cz = (jnp.sum(weights * each, axis=0) / total for each in from_world)
    x, y, z = from_world
    centered = x - cx[None], y - cy[None], z - cz[None]
    return CenteredRays(centered, coordinates(directions), weights), jnp.stack([cx, cy, cz])


def batch_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make `jax.vmap` add its axis last, where it is contiguous, instead of first."""
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _(size: int, in_batch: list[Any], *arguments: Any) -> tuple[Any, Any]:
        def last(a: Array, mapped: bool) -> Array:
            if mapped:
                return jnp.moveaxis(a, 0, -1)
            return jnp.broadcast_to(a[..., None], (*a.shape, size))

        moved = jax.tree.map(last, arguments, tuple(in_batch))
        results = jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), batched(*moved))
        return results, jax.tree.map(lambda _: True, results)

    return batched


def dot(a: Vector, b: Vector) -> Array:
    """Compute inner products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def norm(vector: Vector) -> Array:
    """Compute lengths, with gradient 0 (not NaN) at the zero vector."""
    squared = dot(vector, vector)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def entries(vector: Array) -> Vector:
    """Return the three coordinates along the first axis of an array."""
    return vector[0], vector[1], vector[2]


def residuals_of(rays: CenteredRays, position: Vector) -> Vector:
    """Compute perpendicular vectors from each line to the position, (C, ...) per coordinate.

    Projects twice: the first projection leaves rounding errors along the ray of about the viewing
    distance times epsilon, which would dominate the depth information of nearly parallel rays.
    """
    x, y, z = (p[None] - o for p, o in zip(position, rays.origins, strict=True))
    u, v, w = rays.directions
    for _ in range(2):
        along = x * u + y * v + z * w
        x, y, z = x - along * u, y - along * v, z - along * w
    return x, y, z


def huber_weights(distances: Array, delta: Array) -> Array:
    """Compute `min(1, delta / distance)`, which turns Huber's loss into least squares."""
    far = distances > delta
    return jnp.where(far, delta / jnp.where(far, distances, 1), 1)


def gradient_of(weights: Array, residuals: Vector) -> Vector:
    """Compute half the gradient of the weighted sum of squared distances over cameras."""
    x, y, z = residuals
    return jnp.sum(weights * x, 0), jnp.sum(weights * y, 0), jnp.sum(weights * z, 0)


def hessian_of(rays: CenteredRays, weights: Array, bend: Array, residuals: Vector) -> Triangle:
    """Compute the lower triangle of `sum_i weights_i (I - d_i d_iᵀ) - bend_i r_i r_iᵀ`."""
    (u, v, w), (x, y, z) = rays.directions, residuals
    return (
        jnp.sum(weights * (1 - u * u) - bend * x * x, 0),
        -jnp.sum(weights * v * u + bend * y * x, 0),
        jnp.sum(weights * (1 - v * v) - bend * y * y, 0),
        -jnp.sum(weights * w * u + bend * z * x, 0),
        -jnp.sum(weights * w * v + bend * z * y, 0),
        jnp.sum(weights * (1 - w * w) - bend * z * z, 0),
    )


def solve_regularized(matrix: Triangle, vector: Vector) -> Vector:
    """Solve with the matrix plus a few epsilons of its trace.

    This bounds the solution where the rays are degenerate, and changes it no more than rounding of
    the matrix where the problem is well-posed.
    """
    a00, a10, a11, a20, a21, a22 = matrix
    scale = 4 * epsilon(a00.dtype) * (a00 + a11 + a22)
    scale = jnp.where(scale > 0, scale, 1)
    return symmetric3.solve_triangle((a00 + scale, a10, a11 + scale, a20, a21, a22 + scale), vector)
