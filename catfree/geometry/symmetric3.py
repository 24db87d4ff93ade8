"""Symmetric positive definite 3x3 systems in elementwise operations.

Batched LAPACK calls on 3x3 matrices cost far more in overhead than in arithmetic on a CPU. These
closed forms vectorize under `jax.vmap` instead, differentiate, and stay finite on singular input.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from catfree.geometry.arrays import epsilon

# Pivots below this many epsilons of the trace are rounding noise of a singular matrix.
PIVOT_EPSILONS = 4.0


def cholesky(matrix: Float[Array, "3 3"]) -> tuple[Float[Array, ""], ...]:
    """The six entries of the lower Cholesky factor, pivots kept above rounding noise.

    Args:
        matrix: (3, 3) symmetric positive semi-definite; only the lower triangle is read.

    Returns:
        l00, l10, l11, l20, l21, l22. A singular matrix is factored as if its vanishing pivots were
        a few epsilons of its trace, the zero matrix as if it were the identity.
    """
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    floor = jnp.where(trace > 0, PIVOT_EPSILONS * epsilon(matrix.dtype) * trace, 1)
    l00 = jnp.sqrt(jnp.maximum(matrix[0, 0], floor))
    l10 = matrix[1, 0] / l00
    l20 = matrix[2, 0] / l00
    l11 = jnp.sqrt(jnp.maximum(matrix[1, 1] - l10 * l10, floor))
    l21 = (matrix[2, 1] - l20 * l10) / l11
    l22 = jnp.sqrt(jnp.maximum(matrix[2, 2] - l20 * l20 - l21 * l21, floor))
    return l00, l10, l11, l20, l21, l22


def solve_factored(
    factor: tuple[Float[Array, ""], ...], vector: Float[Array, "3"]
) -> Float[Array, "3"]:
    """Solve `L Lᵀ x = vector` with the factor of `cholesky`."""
    l00, l10, l11, l20, l21, l22 = factor
    y0 = vector[0] / l00
    y1 = (vector[1] - l10 * y0) / l11
    y2 = (vector[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    return jnp.stack([x0, x1, x2])


def solve(matrix: Float[Array, "3 3"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """Solve `matrix x = vector` for a symmetric positive definite matrix.

    Args:
        matrix: (3, 3) symmetric positive semi-definite.
        vector: (3,) right-hand side.

    Returns:
        (3,) the solution, as exact as the matrix's condition allows; finite, and of no meaning
        along the null space, where the matrix is singular.
    """
    return solve_factored(cholesky(matrix), vector)


def inverse(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Inverse of a symmetric positive definite matrix.

    Args:
        matrix: (3, 3) symmetric positive semi-definite.

    Returns:
        (3, 3) inverse; finite and very large along the null space where the matrix is singular
        (see `reciprocal_condition`).
    """
    l00, l10, l11, l20, l21, l22 = cholesky(matrix)
    # Inverse of the factor, M = L⁻¹ (lower triangular); the inverse is Mᵀ M.
    m00, m11, m22 = 1 / l00, 1 / l11, 1 / l22
    m10 = -l10 * m00 * m11
    m21 = -l21 * m11 * m22
    m20 = -(l20 * m00 + l21 * m10) * m22
    a01, a02, a12 = m10 * m11 + m20 * m21, m20 * m22, m21 * m22
    a00 = m00 * m00 + m10 * m10 + m20 * m20
    a11, a22 = m11 * m11 + m21 * m21, m22 * m22
    return jnp.stack(
        [jnp.stack([a00, a01, a02]), jnp.stack([a01, a11, a12]), jnp.stack([a02, a12, a22])]
    )


def reciprocal_condition(
    matrix: Float[Array, "3 3"], inverted: Float[Array, "3 3"]
) -> Float[Array, ""]:
    """`1 / (tr(A) tr(A⁻¹))`: between a ninth of smallest over largest eigenvalue and that ratio.

    Args:
        matrix: (3, 3) symmetric positive semi-definite A.
        inverted: (3, 3) what `inverse` made of it.

    Returns:
        () in [0, 1/9]; a few epsilons or less where the matrix is numerically singular.
    """
    product = jnp.trace(matrix) * jnp.trace(inverted)
    return jnp.where(product > 0, 1 / jnp.where(product > 0, product, 1), 0)
