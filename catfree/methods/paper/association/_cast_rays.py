"""The ray of every detection through the bottom center of its box."""

import jax.numpy as jnp
import numpy as np

from catfree.geometry.camera import rays_of_pixels
from catfree.methods.paper.association._observe import Observations
from catfree.types import Rays, Rig


def cast_rays(observations: Observations, rig: Rig) -> Rays:
    """Cast the ray of every observation through the bottom center of its box.

    Args:
        observations: detections in canonical order.
        rig: cameras in the frame of the rays, with any lenses.

    Returns:
        (N, ...) rays with weight 1, NumPy arrays in JAX's default float dtype.

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    dtype, kept = jnp.result_type(float), observations.kept
    direction = rays_of_pixels(rig, kept.camera, kept.foot).astype(dtype)
    origin = np.asarray(rig.centers, dtype)[kept.camera]
    return Rays(origin, direction, np.ones(len(observations), dtype))
