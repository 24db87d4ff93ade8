"""How the filters read their arguments: NumPy or JAX arrays in, JAX arrays of one float type."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

HostOrDevice = np.ndarray | Array


def as_floating(values: jax.typing.ArrayLike) -> Float[Array, "..."]:
    """A JAX array of the input's float type; integers and booleans get the default float."""
    array = jnp.asarray(values)
    if jnp.issubdtype(array.dtype, jnp.floating):
        return array
    return array.astype(jnp.result_type(float))


def as_mask(where: jax.typing.ArrayLike | None, shape: tuple[int, ...]) -> Bool[Array, "..."]:
    """A boolean JAX array; None means everything counts."""
    return jnp.ones(shape, bool) if where is None else jnp.asarray(where)
