"""Inversion of a lens's map of the plane, and its invertible region."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from catfree.geometry._arrays import safe_norm

# Newton's method converges quadratically from the distorted point; ten steps reach float64
# precision for every lens whose distortion is invertible in its image.
STEPS = 10
# Longest Newton step in units of 1 + radius: keeps points outside the invertible disc finite.
TRUST = 0.3
# Beyond the fold of the lens the determinant is not positive: there the step is along the error.
REGULAR = 1e-3

PlaneMap = Callable[[Float[Array, "2"]], Float[Array, "2"]]


def invert(lens: PlaneMap, target: Float[Array, "2"]) -> Float[Array, "2"]:
    """Find the point that a lens maps to `target`, by a fixed number of Newton steps.

    `optimistix.root_find` needs 3 to 20 times as long for thousands of points, and its Newton
    method has no bound on the step, without which points beyond the fold of the lens diverge.

    Args:
        lens: map of the plane, near the identity at the origin.
        target: (2,) point to invert.

    Returns:
        (2,) finite but arbitrary where no point is mapped there.
    """

    def newton_step(estimate: Array, _: None) -> tuple[Array, None]:
        error = lens(estimate) - target
        jacobian = jax.jacfwd(lens)(estimate)
        a, b, c, d = jacobian[0, 0], jacobian[0, 1], jacobian[1, 0], jacobian[1, 1]
        determinant = a * d - b * c
        regular = determinant > REGULAR
        scale = 1 / jnp.where(regular, determinant, 1)
        newton = scale * jnp.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]])
        step = jnp.where(regular, newton, error)
        length = safe_norm(step)
        longest = TRUST * (1 + safe_norm(estimate))
        shrink = jnp.where(length > longest, longest / jnp.where(length > longest, length, 1), 1)
        return estimate - shrink * step, None

    return jax.lax.scan(newton_step, target, None, length=STEPS)[0]


def inside_fold(lens: PlaneMap, path: Float[Array, "step 2"]) -> Bool[Array, ""]:
    """Return whether a lens keeps its orientation along a path from the center to a point.

    Beyond the first place where it does not, a second point is mapped to the same pixel.

    Args:
        lens: map of the plane.
        path: (S, 2) points between the center and the point, including the point.
    """
    jacobian = jax.vmap(jax.jacfwd(lens))(path)
    determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    return (determinant > 0).all()
