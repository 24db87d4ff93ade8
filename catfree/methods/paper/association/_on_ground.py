"""Positions constrained to the ground z = 0: the ablation 'constrained to ground', baseline A."""

import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from catfree.geometry._arrays import Scalar, epsilon

ITERATIONS = 30  # reweighting converges linearly; this reaches float32 rounding
SHALLOWEST_DESCENT = 1e-3  # rays that do not descend meet the ground 1000 heights away


def ground_point(origin: Float[Array, "3"], direction: Float[Array, "3"]) -> Float[Array, "3"]:
    """Intersect a ray with the ground, (3,); far ahead for a ray that does not descend."""
    descent = jnp.maximum(-direction[2], SHALLOWEST_DESCENT)
    return (origin + direction * (origin[2] / descent)) * jnp.array([1, 1, 0], origin.dtype)


def least_squares_on_ground(
    origins: Float[Array, "cam 3"],
    directions: Float[Array, "cam 3"],
    weights: Float[Array, " cam"],
) -> Float[Array, "3"]:
    """Find the ground point with the smallest weighted sum of squared distances to the rays.

    Args:
        origins: (C, 3) camera centers in the canonical frame.
        directions: (C, 3) unit directions.
        weights: (C,) reliabilities, 0 for absent rays.

    Returns:
        (3,) with z = 0; the zero vector without any ray.
    """
    present = weights > 0
    origins = jnp.where(present[:, None], origins, 0)
    directions = jnp.where(present[:, None], directions, 0)
    projector = _projector(directions)
    normal = jnp.einsum("c,cij->ij", weights, projector)[:2, :2]
    right = jnp.einsum("c,cij,cj->i", weights, projector, origins)[:2]
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[1, 0]
    adjugate = jnp.stack(
        [jnp.stack([normal[1, 1], -normal[0, 1]]), jnp.stack([-normal[1, 0], normal[0, 0]])]
    )
    solution = adjugate @ right / jnp.where(determinant > 0, determinant, 1)
    return jnp.pad(jnp.where(determinant > 0, solution, 0), (0, 1))


def triangulate_on_ground(
    origins: Float[Array, "cam 3"],
    directions: Float[Array, "cam 3"],
    weights: Float[Array, " cam"],
    huber_scale: Scalar,
    *,
    refit: bool,
) -> Float[Array, "3"]:
    """Estimate a robust position at height 0, with the loss and refit of the free estimate.

    Args:
        origins: (C, 3) camera centers in the canonical frame.
        directions: (C, 3) unit directions.
        weights: (C,) reliabilities, 0 for absent rays.
        huber_scale: delta as a share of E.
        refit: solve again on the rays within 3 delta.

    Returns:
        (3,) with z = 0.
    """
    present = weights > 0
    scale = jnp.asarray(huber_scale, origins.dtype)

    def distances(point: Float[Array, "3"]) -> Float[Array, " cam"]:
        offset = jnp.where(present[:, None], point[None, :] - origins, 0)
        across = jnp.einsum("cij,cj->ci", _projector(directions), offset)
        return jnp.sqrt((across**2).sum(-1))

    def huber(weights: Float[Array, " cam"]) -> Float[Array, "3"]:
        def reweight(point: Float[Array, "3"], _: None) -> Float[Array, "3"]:
            robust = weights * scale / jnp.maximum(distances(point), scale)
            return least_squares_on_ground(origins, directions, robust)

        start = least_squares_on_ground(origins, directions, weights)
        rounding = epsilon(start.dtype)
        solver = optx.FixedPointIteration(rtol=rounding, atol=rounding)
        return optx.fixed_point(reweight, solver, start, max_steps=ITERATIONS, throw=False).value

    position = huber(weights)
    if not refit:
        return position
    inliers = present & (distances(position) <= 3 * scale)
    return huber(jnp.where(inliers | (inliers.sum() < 2), weights, 0))


def _projector(directions: Float[Array, "cam 3"]) -> Float[Array, "cam 3 3"]:
    """I - d dᵀ of each direction."""
    identity = jnp.eye(3, dtype=directions.dtype)[None]
    return identity - directions[:, :, None] * directions[:, None, :]
