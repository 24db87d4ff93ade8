"""A wrong lens model, as residuals that grow with the distance from the middle of the image.

Errors of a camera's pose, focal length and principal point move the image affinely, to first order.
What a wrong lens adds begins with the third power of the distance, along the radius.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from catfree.geometry._least_squares import (
    NormalEquations,
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    huber,
    minimize,
    robust,
)

HUBER = 1.345  # standard deviations; 95 % efficient where all errors are normal
CONVERGED = 1e-6  # relative decrease of the cost that ends the iteration
PARAMETERS = 7  # shift (2), linear map (2 by 2), radial


class LensPattern(NamedTuple):
    """Radial residuals of each camera.

    Attributes:
        strength: (C,) coefficient of offset * |offset|² in the residual, as in Brown-Conrady's k1.
        deviation: (C,) its standard deviation if residuals are independent; 1 without residuals.
    """

    strength: Float[Array, " cam"]
    deviation: Float[Array, " cam"]


def lens_pattern(
    residual: Float[Array, "cam n 2"],
    offset: Float[Array, "cam n 2"],
    precision: Float[Array, "cam n 2"],
) -> LensPattern:
    """Fit what a wrong lens leaves to the residuals of each camera, beside an affine map.

    Args:
        residual: (C, n, 2) observed minus predicted image points, in focal lengths; n > 0.
        offset: (C, n, 2) the points, relative to the principal point, in focal lengths.
        precision: (C, n, 2) inverse standard deviations of the residuals; 0 for none.

    Returns:
        The pattern of each camera, by Huber's loss on each coordinate.

    Source:
        Brown, "Close-range camera calibration" (1971), for the first radial coefficient.
    """
    x, y = offset[..., 0], offset[..., 1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    square = x**2 + y**2
    columns = jnp.stack([one, zero, x, y, zero, zero, x * square], -1)
    rows = jnp.stack([zero, one, zero, zero, x, y, y * square], -1)
    design = jnp.stack([columns, rows], -2) * precision[..., None]
    cameras, n = x.shape
    start = Unknowns(jnp.zeros((cameras, PARAMETERS), x.dtype), jnp.zeros((n, 0), x.dtype))
    solution = minimize(
        _problem,
        start,
        (jnp.zeros(0, x.dtype), (design, residual * precision)),
        SchurLevenbergMarquardt(CONVERGED, 0.0),
    )
    equations: NormalEquations = solution.stats["equations"]
    variance = jnp.diagonal(equations.covariance(jnp.zeros((0, 0), x.dtype)))
    last = jnp.arange(1, cameras + 1) * PARAMETERS - 1
    return LensPattern(solution.value.view[:, -1], jnp.sqrt(jnp.maximum(variance[last], 0)))


def _problem(
    unknowns: Unknowns,
    args: tuple[Float[Array, "0"], tuple[Float[Array, "cam n 2 7"], Float[Array, "cam n 2"]]],
) -> tuple[Residuals, Residuals]:
    design, target = args[1]
    left = target - jnp.einsum("cnkp,cp->cnk", design, unknowns.view)
    nothing = jnp.zeros(0, left.dtype), jnp.zeros((left.shape[1], 0), left.dtype)
    return robust(Residuals(left[..., None], *nothing), partial(huber, width=HUBER))
