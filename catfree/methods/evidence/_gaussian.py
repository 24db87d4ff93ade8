"""Gaussian evidence in information form, which adds over the cameras that see one person.

A camera's box edges z with noise covariance W⁻¹ are linear in the state s = (y1, y2, H) near the
person: z = z0 + J (s - s0) + noise. Up to a factor that does not depend on s, the likelihood is

    L(s) = exp(-(s' I s - 2 b' s + k) / 2),   I = J'WJ,  b = J'W r,  k = r'W r,  r = z - z0 + J s0.

Products of likelihoods are sums of (I, b, k), so the evidence of any group of boxes follows from
three sums. With people at density rho on the plane and heights N(1, sH²) (lengths in units of H0),

    Z = rho ∫ N(H; 1, sH²) L(s) ds
    log Z = log rho - log(2 pi sH²) / 2 + 3/2 log 2 pi - log|I*| / 2 - (k* - b*' I*⁻¹ b*) / 2

where the starred sums include the height prior once.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from catfree.types._annotations import HostOrDevice

LOG_2PI = float(np.log(2 * np.pi))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Information:
    """A Gaussian likelihood of (y1, y2, H), up to a factor; sums are joint likelihoods.

    Attributes:
        matrix: (..., 3, 3) I.
        vector: (..., 3) b.
        constant: (...) k.
    """

    matrix: Float[HostOrDevice, "*n 3 3"]
    vector: Float[HostOrDevice, "*n 3"]
    constant: Float[HostOrDevice, "*n"]

    def __getitem__(self, rows) -> "Information":
        return Information(self.matrix[rows], self.vector[rows], self.constant[rows])

    def summed(self, member: Int[np.ndarray, "group m"]) -> "Information":
        """Sum the rows of each group; -1 stands for no row."""
        rows, present = np.maximum(member, 0), member >= 0
        return Information(
            np.where(present[..., None, None], self.matrix[rows], 0.0).sum(1),
            np.where(present[..., None], self.vector[rows], 0.0).sum(1),
            np.where(present, self.constant[rows], 0.0).sum(1),
        )


def with_height_prior(info: Information, spread: Any) -> tuple[Any, Any, Any]:
    """Matrix, vector and constant with the prior H ~ N(1, spread²), added once."""
    precision = 1.0 / spread**2
    axis = np.array([0.0, 0.0, 1.0], info.matrix.dtype)
    matrix = info.matrix + precision * np.diag(axis)
    return matrix, info.vector + precision * axis, info.constant + precision


def _cofactors(matrix: Any) -> tuple[tuple[Any, ...], Any]:
    """The cofactors 00, 01, 02, 11, 12, 22 of symmetric 3x3 matrices, and the determinant."""
    a, b, c = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2]
    d, e, f = matrix[..., 1, 1], matrix[..., 1, 2], matrix[..., 2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    return (A, B, C, D, E, F), a * A + b * B + c * C


def determinant_and_form(matrix: Any, vector: Any) -> tuple[Any, Any]:
    """Determinant |M| and form v' M⁻¹ v of symmetric 3x3 matrices in closed form, for speed.

    Args:
        matrix: (..., 3, 3) symmetric positive definite.
        vector: (..., 3).

    Returns:
        (...) determinant and (...) quadratic form.
    """
    (A, B, C, D, E, F), det = _cofactors(matrix)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    form = A * x * x + D * y * y + F * z * z + 2 * (B * x * y + C * x * z + E * y * z)
    return det, form / det


def log_evidence(info: Information, density: Any, spread: Any) -> Any:
    """Log evidence log Z that a group of boxes shows one person, up to the omitted factor.

    Args:
        info: (...) summed information without the height prior.
        density: () people per H0².
        spread: () standard deviation of heights in H0.

    Returns:
        (...) log Z.
    """
    xp = np if isinstance(info.matrix, np.ndarray) else jnp
    matrix, vector, constant = with_height_prior(info, spread)
    det, form = determinant_and_form(matrix, vector)
    det = xp.maximum(det, 1e-300)
    return xp.log(density) - xp.log(spread) + LOG_2PI - 0.5 * xp.log(det) - 0.5 * (constant - form)


def invert_symmetric(matrix: Any) -> Any:
    """Invert symmetric 3x3 matrices in closed form; (..., 3, 3) -> (..., 3, 3)."""
    xp = np if isinstance(matrix, np.ndarray) else jnp
    (A, B, C, D, E, F), det = _cofactors(matrix)
    rows = [xp.stack(r, axis=-1) for r in ((A, B, C), (B, D, E), (C, E, F))]
    return xp.stack(rows, axis=-2) / det[..., None, None]


def symmetrized(matrix: Float[np.ndarray, "*n d d"]) -> Float[np.ndarray, "*n d d"]:
    """Symmetrize matrices that are symmetric up to rounding."""
    return (matrix + np.swapaxes(matrix, -1, -2)) / 2


def mean_and_covariance(info: Information, spread: Any) -> tuple[Any, Any]:
    """Most likely state and its covariance, height prior included; (..., 3) and (..., 3, 3)."""
    matrix, vector, _ = with_height_prior(info, spread)
    covariance = invert_symmetric(matrix)
    return (covariance * vector[..., None, :]).sum(-1), covariance


def probability_within(
    covariance: Float[np.ndarray, "n 2 2"], radius: float
) -> Float[np.ndarray, " n"]:
    """Probability that a Gaussian error is at most a radius in the same unit."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 1e-12))
    # Integrate over the disc in polar coordinates of the whitened plane: radially in closed form,
    # numerically over the angle; one quadrant suffices by symmetry.
    angle = (np.arange(16) + 0.5) * (np.pi / 32)
    stretch = (values[:, :1] * np.cos(angle)) ** 2 + (values[:, 1:] * np.sin(angle)) ** 2
    return (1 - np.exp(-0.5 * radius**2 / stretch)).mean(1)
