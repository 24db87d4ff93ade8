"""Closed-form 3x3 systems, compared with LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from catfree.geometry import _symmetric3 as symmetric3

invert = jax.jit(symmetric3.inverse)

entries = hnp.arrays(np.float64, (3, 3), elements=st.floats(-1, 1))
vectors = hnp.arrays(np.float64, 3, elements=st.floats(-1, 1, allow_subnormal=False))


@jax.jit
def solve(matrix, vector):
    triangle = symmetric3.lower_triangle(matrix)
    return jnp.stack(symmetric3.solve_triangle(triangle, (vector[0], vector[1], vector[2])))


solve_jacobian = jax.jit(jax.jacrev(solve))


def with_eigenvalues(entries: np.ndarray, values: np.ndarray) -> np.ndarray:
    rotation, _ = np.linalg.qr(entries + 1.5 * np.eye(3))
    matrix = (rotation * values) @ rotation.T
    return (matrix + matrix.T) / 2


@pytest.mark.slow
@given(entries, vectors, st.floats(-5, 0), st.floats(-5, 0), st.floats(-9, 9))
def test_solve_and_inverse_agree_with_lapack(x64, entries, vector, first, second, scale):
    matrix = with_eigenvalues(entries, 10.0 ** np.array([scale, scale + first, scale + second]))
    condition = np.linalg.cond(matrix)
    expected = np.linalg.solve(matrix, vector)
    found = solve(jnp.asarray(matrix), jnp.asarray(vector))
    tolerance = 1e-14 * condition
    np.testing.assert_allclose(found, expected, atol=tolerance * (np.abs(expected).max() + 1e-300))
    inverse = np.linalg.inv(matrix)
    found = np.asarray(invert(jnp.asarray(matrix)))
    np.testing.assert_allclose(found, inverse, atol=tolerance * np.abs(inverse).max())
    np.testing.assert_allclose(found, found.T, rtol=1e-12)


@given(entries, vectors, st.floats(-4, 0))
def test_float32_error_is_backward_stable(entries, vector, exponent):
    matrix = with_eigenvalues(entries, np.array([1, 10**exponent, 10**exponent])).astype(np.float32)
    vector = vector.astype(np.float32)
    expected = np.linalg.solve(matrix.astype(np.float64), vector.astype(np.float64))
    found = solve(jnp.asarray(matrix), jnp.asarray(vector))
    assert found.dtype == jnp.float32
    tolerance = 1e-6 * np.linalg.cond(matrix.astype(np.float64)) * (np.abs(expected).max() + 1e-30)
    np.testing.assert_allclose(found, expected, atol=tolerance)


@pytest.mark.slow
@given(entries, st.floats(-5, 0))
def test_reciprocal_condition_brackets_the_eigenvalue_ratio(x64, entries, exponent):
    matrix = with_eigenvalues(entries, np.array([1, 10 ** (exponent / 2), 10**exponent]))
    array = jnp.asarray(matrix)
    found = symmetric3.reciprocal_condition(array, invert(array))
    ratio = 1 / np.linalg.cond(matrix)
    assert ratio / 9 * (1 - 1e-6) <= found <= ratio * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "matrix",
    [np.zeros((3, 3)), np.diag([1.0, 1, 0]), np.ones((3, 3)), np.diag([0.0, 0, 1e-3])],
)
def test_singular_matrices_stay_finite(x64, matrix, dtype):
    array = jnp.asarray(matrix, dtype)
    one = jnp.ones(3, dtype)
    assert np.isfinite(solve(array, one)).all()
    inverse = invert(array)
    assert np.isfinite(inverse).all()
    assert np.isfinite(solve_jacobian(array, one)).all()
    if np.trace(matrix) > 0:
        condition = symmetric3.reciprocal_condition(array, inverse)
        assert condition <= 8 * np.finfo(dtype).eps
