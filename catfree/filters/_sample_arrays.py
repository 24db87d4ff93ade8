"""Conversion of the filters' arguments from NumPy or JAX arrays to JAX arrays of one float type."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.errors import InvalidInputError, quoted
from catfree.geometry._arrays import as_flags
from catfree.types._validation import as_float, is_traced, require_shape


def as_floating(values: jax.typing.ArrayLike, name: str) -> Float[Array, "..."]:
    """Convert to a JAX array of the input's float type, or the default float for other numbers.

    Raises:
        InvalidInputError: if these are not real numbers.
    """
    return jnp.asarray(as_float(values, name))


def as_sample(values: jax.typing.ArrayLike) -> Float[Array, " n"]:
    """Convert a flat array as `as_floating`; use `jax.vmap` for a batch of samples."""
    array = as_floating(values, "values")
    if array.ndim != 1:
        raise InvalidInputError(
            f"values must have shape (n), got {array.shape}. Flatten it, or use jax.vmap."
        )
    return array


def as_mask(values: jax.typing.ArrayLike, shape: tuple[int, ...], name: str) -> Bool[Array, "..."]:
    """Convert to a boolean JAX array of this shape."""
    mask = as_flags(values, name)
    require_shape(mask, shape, name)
    return mask


def as_selection(where: jax.typing.ArrayLike | None, shape: tuple[int, ...]) -> Bool[Array, "..."]:
    """Convert `where` to a boolean JAX array of this shape; None means all true."""
    return jnp.ones(shape, bool) if where is None else as_mask(where, shape, "where")


def as_radius(radius: jax.typing.ArrayLike, dtype: jnp.dtype) -> Float[Array, ""]:
    """Convert to one JAX number, which may be infinite but not negative."""
    if is_traced(radius):
        return jnp.asarray(radius, dtype)
    number = np.asarray(as_float(radius, "radius"), np.float64)
    if number.shape != () or not number >= 0:
        raise InvalidInputError(f"radius is {quoted(radius)}; it must be one number, 0 or more.")
    return jnp.asarray(number, dtype)
