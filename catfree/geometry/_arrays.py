"""Conversion of inputs to JAX arrays of one float dtype, and norms differentiable at zero."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real
from numpy.typing import ArrayLike

from catfree.errors import InvalidInputError
from catfree.types._annotations import HostOrDevice
from catfree.types._rig import UNIT_TOLERANCE
from catfree.types._validation import as_boolean, as_float, is_traced, require_shape

# Standard deviation of a zero-mean normal variable over the median of its absolute value.
MEDIAN_TO_DEVIATION = 1.4826

Scalar = float | int | np.number | Real[HostOrDevice, ""]
# Anything that NumPy converts to an array. `ArrayLike` alone is enough for type checkers, but
# excludes tuples at run time.
ArrayInput = ArrayLike | tuple[Any, ...]


def float_arrays(*optional: str, **values: Any) -> tuple[Any, ...]:
    """Convert everything to JAX arrays of one float dtype.

    Args:
        optional: names of the values that may be None; None stays None.
        values: values by name, for messages.

    The dtype is the widest of `as_float` of the arrays of floats, or JAX's default float if there
    are none. Python scalars never widen it.

    Raises:
        InvalidInputError: if a value does not hold real numbers.
    """
    converted = [
        None if value is None and name in optional else as_float(value, name)
        for name, value in values.items()
    ]
    # Whole numbers and scalars, including Python scalars passed through `jax.jit`, do not count.
    floats = [
        jnp.result_type(c)
        for v, c in zip(values.values(), converted, strict=True)
        if c is not None
        and isinstance(v, HostOrDevice)
        and jnp.issubdtype(v.dtype, jnp.floating)
        and not getattr(v, "weak_type", False)
    ]
    dtype = max(floats, key=lambda d: jnp.finfo(d).bits) if floats else jnp.result_type(float)
    return tuple(None if c is None else jnp.asarray(c, dtype) for c in converted)


def as_flags(values: Any, name: str) -> Bool[Array, "..."]:
    """Convert booleans, or 0 and 1, to a JAX array, also while JAX traces."""
    return jnp.asarray(values if is_traced(values) else as_boolean(values, name), bool)


def require_vectors(length: int, **vectors: Any) -> None:
    """Raise unless each array is one vector of this length: several would broadcast unnoticed."""
    for name, vector in vectors.items():
        if np.shape(vector) != (length,):
            raise InvalidInputError(
                f"{name} must have shape ({length},), got {np.shape(vector)}. Use jax.vmap to "
                "apply the function to several at once."
            )


def require_rays(origins: HostOrDevice, directions: HostOrDevice, weights: HostOrDevice) -> None:
    """Raise unless these are rays of one person: equally many, and present ones of length 1.

    Lengths are not known while JAX traces.
    """
    require_shape(weights, (None,), "weights")
    for name, vectors in (("origins", origins), ("directions", directions)):
        require_shape(vectors, (len(weights), 3), name)
    if is_traced(directions, weights):
        return
    with np.errstate(over="ignore"):  # absent rows may hold anything
        length = np.linalg.norm(np.asarray(directions), axis=-1)
    wrong = (np.asarray(weights) > 0) & ~(np.abs(length - 1) <= UNIT_TOLERANCE)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InvalidInputError(
            f"directions[{at}] has length {length[at]:.6g}; divide directions by their lengths."
        )


def safe_norm(vector: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Compute the length along the last axis, with gradient 0 (not NaN) at the zero vector."""
    squared = jnp.sum(vector * vector, axis=-1)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def tiny(dtype: Any) -> float:
    """Return the smallest normal number of a dtype, as a Python float."""
    return float(jnp.finfo(dtype).tiny)


def epsilon(dtype: Any) -> float:
    """Return the machine epsilon of a dtype, as a Python float."""
    return float(jnp.finfo(dtype).eps)
