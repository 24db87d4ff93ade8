"""Symmetric positive definite 3x3 systems in elementwise operations.

Batched LAPACK calls on 3x3 matrices cost far more in overhead than in arithmetic on a CPU. These
closed forms vectorize under `jax.vmap` instead, differentiate, and stay finite on singular input.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from catfree.geometry._arrays import epsilon

# Pivots below this many epsilons of the trace are rounding noise of a singular matrix.
PIVOT_EPSILONS = 4.0

Vector = tuple[Array, Array, Array]
# The lower triangle by rows: entries 00, 10, 11, 20, 21, 22, each of any common shape.
Triangle = tuple[Array, Array, Array, Array, Array, Array]


def lower_triangle(matrix: Float[Array, "3 3"]) -> Triangle:
    """Return the six entries on and below the diagonal of one matrix."""
    m = matrix
    return m[0, 0], m[1, 0], m[1, 1], m[2, 0], m[2, 1], m[2, 2]


def factorize(matrix: Triangle) -> tuple[Vector, Vector]:
    """Factorize `matrix = L D Lᵀ`, with the pivots D kept above rounding noise.

    Args:
        matrix: lower triangle of a symmetric positive semi-definite matrix, or of many.

    Returns:
        The entries 10, 20, 21 of L, whose diagonal is 1, and the diagonal of D⁻¹. A singular matrix
        is factored as if its vanishing pivots were a few epsilons of its trace, the zero matrix as
        if it were the identity.
    """
    a00, a10, a11, a20, a21, a22 = matrix
    trace = a00 + a11 + a22
    floor = jnp.where(trace > 0, PIVOT_EPSILONS * epsilon(trace.dtype) * trace, 1)
    r0 = 1 / jnp.maximum(a00, floor)
    l10, l20 = a10 * r0, a20 * r0
    r1 = 1 / jnp.maximum(a11 - l10 * a10, floor)
    reduced = a21 - l20 * a10
    l21 = reduced * r1
    r2 = 1 / jnp.maximum(a22 - l20 * a20 - l21 * reduced, floor)
    return (l10, l20, l21), (r0, r1, r2)


def solve_triangle(matrix: Triangle, vector: Vector) -> Vector:
    """Solve `matrix x = vector` by entries, for one system or many of any common shape.

    Args:
        matrix: lower triangles of symmetric positive semi-definite matrices.
        vector: right-hand sides.

    Returns:
        The solutions, as accurate as the matrix's condition allows; finite but meaningless along
        the null space of a singular matrix.
    """
    (l10, l20, l21), (r0, r1, r2) = factorize(matrix)
    y0, y1, y2 = vector
    y1 = y1 - l10 * y0
    y2 = y2 - l20 * y0 - l21 * y1
    x2 = r2 * y2
    x1 = r1 * y1 - l21 * x2
    x0 = r0 * y0 - l10 * x1 - l20 * x2
    return x0, x1, x2


def inverse(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Invert a symmetric positive definite matrix.

    Args:
        matrix: (3, 3) symmetric positive semi-definite; only the lower triangle is read.

    Returns:
        (3, 3) inverse; finite and very large along the null space where the matrix is singular
        (see `reciprocal_condition`).
    """
    (l10, l20, l21), (r0, r1, r2) = factorize(lower_triangle(matrix))
    # With M = L⁻¹, whose entries below the diagonal are -l10, m20, -l21, A⁻¹ = Mᵀ D⁻¹ M.
    m20 = l10 * l21 - l20
    a02, a12 = m20 * r2, -l21 * r2
    a01 = -l10 * r1 - l21 * a02
    a00, a11 = r0 + l10 * l10 * r1 + m20 * a02, r1 - l21 * a12
    return jnp.stack([a00, a01, a02, a01, a11, a12, a02, a12, r2]).reshape(3, 3)


def reciprocal_condition(
    matrix: Float[Array, "3 3"], inverted: Float[Array, "3 3"]
) -> Float[Array, ""]:
    """Compute `1 / (tr(A) tr(A⁻¹))`: the inverse condition number, or down to a ninth of it.

    Args:
        matrix: (3, 3) symmetric positive semi-definite A.
        inverted: (3, 3) the result of `inverse(matrix)`.

    Returns:
        () in [0, 1/9]; a few epsilons or less where the matrix is numerically singular.
    """
    product = (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]) * (
        inverted[0, 0] + inverted[1, 1] + inverted[2, 2]
    )
    return jnp.where(product > 0, 1 / jnp.where(product > 0, product, 1), 0)
