"""Fit the people's cameras and a map frame to measurements.

The covariance of the cameras is known; nothing is known about the map frame. Each linear step is
solved in the space of the measurements, so measurements may be exact.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Bool, Float

from catfree.calibration.people.anchors._measurements import Linearized, Stated, linearize

ROUNDS = 20  # of linearization; a fit takes four
CONVERGED = 1e-9  # meters, radians and relative


class MixedFit(NamedTuple):
    """Cameras and map frame that fit the measurements in use; NaN or huge if the fit diverges.

    Attributes:
        cameras: (C, 7) in the frame of the people.
        frame: (4,) the map frame.
        covariance: (7C + 4, 7C + 4) of both.
        compared: all measurements, compared with the fit.
        information: (3n, 3n) inverse covariance of stated minus predicted numbers; 0 for numbers
            not in use.
        error: (3n,) `information` times stated minus predicted, linearized to the people's cameras.
        misfit: sum of squares of the standardized residuals.
    """

    cameras: Float[Array, "cam 7"]
    frame: Float[Array, "4"]
    covariance: Float[Array, "k k"]
    compared: Linearized
    information: Float[Array, "m m"]
    error: Float[Array, " m"]
    misfit: Float[Array, ""]


@jax.jit
def fit_mixed_model(
    stated: Stated,
    used: Bool[Array, " n"],
    cameras: Float[Array, "cam 7"],
    prior: Float[Array, "p p"],
    start: Float[Array, "4"],
    free: Bool[Array, "4"],
) -> MixedFit:
    """Fit cameras and map frame to measurements.

    Args:
        stated: (n,) measurements.
        used: (n,) those to fit.
        cameras: (C, 7) cameras from the people.
        prior: (7C, 7C) their covariance.
        start: (4,) the map frame to start from.
        free: (4,) mask of its entries that the measurements determine; the others stay.

    Source:
        Gauss-Newton for observations with unknown and with random parameters ("mixed model").
    """
    rows = (stated.present & used[:, None]).ravel()
    size = cameras.size

    def masked_inverse(matrix: Array, keep: Array) -> Array:
        """Invert the block of the rows to keep; the others are 0."""
        block = keep[:, None] & keep[None, :]
        identity = jnp.eye(len(keep), dtype=matrix.dtype)
        return jnp.where(block, jnp.linalg.inv(jnp.where(block, matrix, identity)), 0)

    def solve(at: Array, frame: Array) -> tuple[Linearized, Array, Array, Array, Array, Array]:
        """Linearize at an estimate.

        Returns:
            The comparison, its slopes by the cameras, what is off at the people's cameras, the
            gains of cameras and frame, and the information about what is off.
        """
        compared = linearize(stated, at, frame)
        J = compared.slopes.reshape(len(rows), -1)
        A, G = J[:, :size], jnp.where(free[None, :], J[:, size:], 0)
        noise = block_diag(*compared.noise)
        W = masked_inverse(A @ prior @ A.T + noise, rows)
        H = masked_inverse(G.T @ W @ G, free) @ G.T @ W
        M = W - W @ G @ H
        off = compared.off.ravel() + A @ (at - cameras).ravel()
        return compared, A, off, prior @ A.T @ M, H, M

    def improve(unknowns: Any, _: Any) -> Any:
        at, frame = unknowns
        _, _, off, K, H, _ = solve(at, frame)
        return cameras + (K @ off).reshape(at.shape), frame + H @ off

    solver = optx.FixedPointIteration(rtol=CONVERGED, atol=CONVERGED, norm=optx.max_norm)
    solution = optx.fixed_point(improve, solver, (cameras, start), max_steps=ROUNDS, throw=False)
    at, frame = solution.value
    compared, A, off, K, H, M = solve(at, frame)
    # The error of cameras and frame, by those of the people's cameras and of the measurements: a
    # covariance in this form is positive definite even where measurements are exact.
    by_people = jnp.concatenate([jnp.eye(size, dtype=A.dtype) - K @ A, -H @ A])
    by_noise = jnp.concatenate([K, H])
    covariance = by_people @ prior @ by_people.T
    covariance += by_noise @ block_diag(*compared.noise) @ by_noise.T
    return MixedFit(at, frame, covariance, compared, M, M @ off, off @ M @ off)
