"""How the filters read their arguments: NumPy or JAX arrays in, JAX arrays of one float type."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from catfree.errors import InvalidInputError


def as_floating(values: jax.typing.ArrayLike) -> Float[Array, "..."]:
    """A JAX array of the input's float type; integers and booleans get the default float."""
    array = jnp.asarray(values)
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    return array.astype(jnp.result_type(float))


def as_sample(values: jax.typing.ArrayLike) -> Float[Array, " n"]:
    """`as_floating` of a flat array; a batch of samples goes through `jax.vmap`."""
    array = as_floating(values)
    if array.ndim != 1:
        raise InvalidInputError(
            f"A sample must have shape (n), got {array.shape}. Flatten it, or use jax.vmap."
        )
    return array


def as_mask(where: jax.typing.ArrayLike | None, shape: tuple[int, ...]) -> Bool[Array, "..."]:
    """A boolean JAX array; None means everything counts."""
    return jnp.ones(shape, bool) if where is None else jnp.asarray(where, bool)
