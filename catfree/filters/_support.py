"""Cameras that confirm a position, regardless of the groups of their detections.

Source: paper, Sec. "Selecting pedestrian positions", support recount.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Num, ScalarLike

from catfree.errors import InvalidInputError, quoted
from catfree.filters._sample_arrays import as_floating, as_radius
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import as_integer, is_traced, require_shape


def support(
    position: Num[HostOrDevice, "3"],
    origins: Num[HostOrDevice, "cam 3"],
    directions: Num[HostOrDevice, "cam ray 3"],
    weights: Num[HostOrDevice, "cam ray"],
    radius: ScalarLike,
) -> Int[Array, " cam"]:
    """Find each camera's ray that supports a position: the most reliable within the radius.

    Args:
        position: (3,) in scene units.
        origins: (C, 3) camera centers in scene units.
        directions: (C, D, 3) unit directions of the rays of each camera, world frame.
        weights: (C, D) reliability w; rays with weight 0 are absent and may hold anything.
        radius: largest angle between a ray and the direction to the position in radians, below
            pi / 2.

    Returns:
        (C,) int32 index of the supporting ray, -1 if the camera has none. Of rays with equal
        weights the one with the smaller angle wins, then the lower index.

    Raises:
        InvalidInputError: if shapes do not fit, or the radius is negative or not a number.

    Source: paper, Sec. "Selecting pedestrian positions", recount of the supporting cameras.
    """
    position, origins = as_floating(position, "position"), as_floating(origins, "origins")
    directions = as_floating(directions, "directions")
    weights = as_floating(weights, "weights")
    require_shape(directions, (*weights.shape, 3), "directions")
    require_shape(origins, (len(weights), 3), "origins")
    require_shape(position, (3,), "position")
    if directions.shape[1] == 0:
        return jnp.full(origins.shape[0], -1, jnp.int32)
    # tan² of the angle from cross and dot product: at these small angles, where the cosine loses
    # all digits, it is as accurate in float32 as arctan2 and several times faster.
    x, y, z = (offset[:, None] for offset in (position[None, :] - origins).T)
    u, v, w = directions[..., 0], directions[..., 1], directions[..., 2]
    across = jnp.square(v * z - w * y) + jnp.square(w * x - u * z) + jnp.square(u * y - v * x)
    along = u * x + v * y + w * z
    limit = jnp.square(jnp.tan(as_radius(radius, position.dtype)))
    inside = (weights > 0) & (along > 0) & (across <= limit * jnp.square(along))
    best = jnp.max(jnp.where(inside, weights, 0), axis=1, keepdims=True)
    tied = inside & (weights == best)
    residual = jnp.where(tied, across / jnp.where(tied, jnp.square(along), 1), jnp.inf)
    chosen = jnp.argmin(residual, axis=1).astype(jnp.int32)
    return jnp.where(jnp.any(inside, axis=1), chosen, -1)


def weighted_support(
    index: Int[HostOrDevice, " cam"], weights: Num[HostOrDevice, "cam ray"]
) -> Float[Array, ""]:
    """Sum the reliabilities w of the rays that support a position.

    Args:
        index: (C,) supporting ray of each camera, or -1 (from `support`).
        weights: (C, D) reliability w of the rays.

    Returns:
        () the sum.

    Raises:
        InvalidInputError: if a camera has no such ray.

    Source: paper, Sec. "Selecting pedestrian positions", where candidates with "stronger camera
        support" come first; Fig. "reliability" for the weights.
    """
    weights = as_floating(weights, "weights")
    rays = index if is_traced(index) else as_integer(index, "index")
    require_shape(weights, (None, None), "weights")
    require_shape(rays, weights.shape[:1], "index")
    if not is_traced(rays) and ((rays < -1) | (rays >= weights.shape[1])).any():
        raise InvalidInputError(
            f"index is {quoted(rays.tolist())}; of {weights.shape[1]} rays per camera, it must "
            "name one, or be -1."
        )
    if weights.shape[1] == 0:
        return jnp.zeros((), weights.dtype)
    chosen = jnp.take_along_axis(weights, jnp.maximum(rays, 0)[:, None], axis=1)[:, 0]
    return jnp.sum(jnp.where(rays >= 0, chosen, 0))
