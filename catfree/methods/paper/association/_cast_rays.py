"""The ray of every detection through the bottom center of its box."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from catfree.geometry import pixel_to_ray
from catfree.methods.paper.association._observe import Observations
from catfree.types import Rays, Rig

DETECTION_BLOCK = 8192  # arrays of detections are padded to this to avoid recompilation


@partial(jax.jit, static_argnames="distorted")
def _directions(
    K: Float[Array, "cam 3 3"],
    R: Float[Array, "cam 3 3"],
    distortion: Float[Array, "cam 5"],
    camera: Array,
    pixel: Float[Array, "n 2"],
    *,
    distorted: bool,
) -> Float[Array, "n 3"]:
    def direction(index: Array, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        coefficients = distortion[index] if distorted else None
        at_origin = jnp.zeros(3, pixel.dtype)
        return pixel_to_ray(K[index], R[index], at_origin, pixel, coefficients)[1]

    return jax.vmap(direction)(camera, pixel)


def cast_rays(observations: Observations, rig: Rig) -> Rays:
    """Cast the ray of every observation through the bottom center of its box.

    Args:
        observations: detections in canonical order.
        rig: cameras in the frame of the rays.

    Returns:
        (N, ...) rays with weight 1, NumPy arrays in JAX's default float dtype.

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    count = len(observations)
    dtype = jnp.result_type(float)
    distortion = np.zeros((rig.camera_count, 5)) if rig.distortion is None else rig.distortion
    cameras = [np.asarray(array, dtype) for array in (rig.K, rig.R, distortion)]
    direction = np.empty((count, 3), dtype)
    for begin in range(0, count, DETECTION_BLOCK):
        rows = slice(begin, begin + DETECTION_BLOCK)
        padding = (0, DETECTION_BLOCK - len(observations.camera[rows]))
        block = _directions(
            *cameras,
            np.pad(observations.camera[rows], padding),
            np.pad(observations.foot[rows].astype(dtype), (padding, (0, 0))),
            distorted=rig.distortion is not None,
        )
        direction[rows] = np.asarray(block)[: DETECTION_BLOCK - padding[1]]
    origin = np.asarray(rig.centers, dtype)[observations.camera]
    return Rays(origin, direction, np.ones(count, dtype))
