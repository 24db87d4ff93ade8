"""Precision of a position from rays: information matrix, ground covariance and sigma."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Real

from catfree.geometry import _symmetric3 as symmetric3
from catfree.geometry._arrays import (
    Scalar,
    epsilon,
    float_arrays,
    require_rays,
    require_vectors,
    safe_norm,
    tiny,
)
from catfree.types import Plane
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import require_instance, require_shape

# Below this many epsilons the reciprocal condition of a matrix is rounding noise.
SINGULAR_EPSILONS = 8.0


def information(
    position: Real[HostOrDevice, "3"],
    origins: Real[HostOrDevice, "cam 3"],
    directions: Real[HostOrDevice, "cam 3"],
    weights: Real[HostOrDevice, " cam"],
    sigma_theta: Scalar,
) -> Float[Array, "3 3"]:
    """Compute the Fisher information of a position seen along rays with angular noise.

    Args:
        position: (3,) in scene units.
        origins: (C, 3) camera centers in scene units.
        directions: (C, 3) unit vectors in the world frame.
        weights: (C,) reliability of each ray; 0 marks an absent ray, whose values are ignored.
        sigma_theta: () standard deviation in radians of each of the two angular components of a
            ray of weight 1.

    Returns:
        (3, 3) Lambda in 1 / scene units². A ray whose origin is the position carries no
        information and is left out.

    Raises:
        InvalidInputError: if shapes do not fit, or a present direction is not of length 1.

    Source: paper, Eq. sigma.
    """
    position, origins, directions, weights, sigma_theta = float_arrays(
        position=position,
        origins=origins,
        directions=directions,
        weights=weights,
        sigma_theta=sigma_theta,
    )
    require_vectors(3, position=position)
    require_rays(origins, directions, weights)
    require_shape(sigma_theta, (), "sigma_theta")
    present = weights > 0  # false for NaN too
    sight = jnp.where(present[:, None], position[None, :] - origins, 0)
    spread = sigma_theta * safe_norm(sight)
    used = present & (spread * spread > tiny(spread.dtype))
    precision = jnp.where(used, weights, 0) / jnp.where(used, spread, 1) ** 2
    directions = jnp.where(used[:, None], directions, 0)
    outer = directions[:, :, None] * directions[:, None, :]
    total = jnp.sum(precision[:, None, None] * outer, axis=0)
    return jnp.sum(precision) * jnp.eye(3, dtype=total.dtype) - total


def ground_covariance(information: Real[HostOrDevice, "3 3"], plane: Plane) -> Float[Array, "2 2"]:
    """Compute the covariance of a position along the ground, with its height unknown.

    Args:
        information: (3, 3) Lambda in 1 / scene units².
        plane: the ground; only its basis P is used.

    Returns:
        (2, 2) `Pᵀ Λ⁻¹ P` in scene units² along the axes of `plane.basis`; infinite variances and
        zero covariance where Lambda is not invertible.

    Raises:
        InvalidInputError: if plane is not a `Plane`, or information not of shape (3, 3).

    Source: paper, Eq. sigma.
    """
    require_instance(plane, Plane, "plane")
    covariance, singular = _covariance(*float_arrays(information=information, basis=plane.basis))
    infinite = jnp.where(jnp.eye(2, dtype=bool), jnp.inf, 0).astype(covariance.dtype)
    return jnp.where(singular, infinite, covariance)


def ground_sigma(information: Real[HostOrDevice, "3 3"], plane: Plane) -> Float[Array, ""]:
    """Compute the standard deviation of a position along the ground, averaged over directions.

    Args:
        information: (3, 3) Lambda in 1 / scene units².
        plane: the ground; only its basis P is used.

    Returns:
        () `sqrt(tr(Pᵀ Λ⁻¹ P) / 2)` in scene units; infinity with gradient 0 where Lambda is not
        invertible (fewer than two rays, or parallel ones).

    Raises:
        InvalidInputError: if plane is not a `Plane`, or information not of shape (3, 3).

    Source: paper, Eq. sigma.
    """
    require_instance(plane, Plane, "plane")
    covariance, singular = _covariance(*float_arrays(information=information, basis=plane.basis))
    variance = (covariance[0, 0] + covariance[1, 1]) / 2
    return jnp.where(singular, jnp.inf, jnp.sqrt(jnp.where(singular, 1, variance)))


@jax.jit
def _covariance(matrix: Array, basis: Array) -> tuple[Array, Array]:
    """(2, 2) `Pᵀ Λ⁻¹ P` and whether Lambda is singular, in which case the first is arbitrary."""
    require_shape(matrix, (3, 3), "information")
    scale = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    usable = (scale > tiny(matrix.dtype)) & jnp.isfinite(scale)
    scale = jnp.where(usable, scale, 1)
    # Trace 1: the pivots neither overflow nor vanish in float32, whatever the scene's unit.
    matrix = jnp.where(usable, matrix, jnp.eye(3, dtype=matrix.dtype)) / scale
    # The pivots are bounded, so value and gradient are finite even if the matrix is singular.
    inverted = symmetric3.inverse(matrix)
    condition = symmetric3.reciprocal_condition(matrix, inverted)
    singular = ~usable | ~(condition > SINGULAR_EPSILONS * epsilon(matrix.dtype))
    return basis.T @ (inverted / scale) @ basis, singular
