"""Visibility of places on the ground, and the precision of positions there."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.geometry import (
    CanonicalFrame,
    angular_residual,
    ground_sigma,
    information,
    pixel_to_ray,
    project,
)
from catfree.geometry._buckets import in_blocks
from catfree.types import Plane, Scene

PLACES_BLOCK = 4096  # places evaluated together
# A lens polynomial can fold points far outside the picture back into it. The ray of such a pixel
# misses the point by far more than this angle in radians.
FOLD_TOLERANCE = 1e-2


def look(
    scene: Scene,
    active: Bool[np.ndarray, " cam"],
    places: Float[np.ndarray, "n 2"],
    sigma_theta: float | int,
    person_height: float | int | None,
) -> tuple[Bool[np.ndarray, "cam n"], Float[np.ndarray, " n"]]:
    """Compute which cameras see each place on the ground, and its sigma.

    Args:
        scene: cameras, ground and extent.
        active: (C,) bool, the cameras to use.
        places: (N, 2) ground coordinates in scene units.
        sigma_theta: angular noise of a foot ray in radians.
        person_height: height in scene units of the head, which must be in the picture too, or None.

    Returns:
        (C, N) whether each camera sees each place, and (N,) sigma in scene units, inf below two
        cameras.
    """
    frame = CanonicalFrame.of(scene)
    rig = frame.rig(scene.rig)
    normal = np.asarray(scene.ground.normal, np.float64)
    on_plane = -np.asarray(scene.ground.offset, np.float64) * normal
    world = places @ np.asarray(scene.ground.basis, np.float64).T + on_plane
    points = frame.to_canonical(world)
    points[:, 2] = 0
    height = None if person_height is None else jnp.asarray(person_height / frame.extent)
    # Unregistered cameras may hold NaN.
    K, R, t = (
        jnp.asarray(np.where(np.reshape(active, (-1,) + (1,) * (a.ndim - 1)), a, b))
        for a, b in ((rig.K, np.eye(3)), (rig.R, np.eye(3)), (rig.t, np.zeros(3)))
    )
    distortion = None
    if rig.distortion is not None:
        distortion = jnp.asarray(np.where(active[:, None], rig.distortion, 0))
    cameras = (
        K,
        R,
        t,
        jnp.asarray(rig.image_size, K.dtype),
        distortion,
        jnp.asarray(active),
        jnp.asarray(sigma_theta, K.dtype),
        height,
    )
    visible, sigma = in_blocks(
        lambda block: _look_everywhere(block, *cameras), (points,), PLACES_BLOCK
    )
    return visible.T, sigma.astype(np.float64) * frame.extent


@jax.jit
def _look_everywhere(points: Array, *cameras: Any) -> tuple[Array, Array]:
    return jax.vmap(lambda point: _look_at(point, *cameras))(points)


def _look_at(
    point: Array,
    K: Array,
    R: Array,
    t: Array,
    size: Array,
    distortion: Array | None,
    active: Array,
    sigma_theta: Array,
    height: Array | None,
) -> tuple[Array, Array]:
    """(C,) whether each camera sees a canonical ground point, and its sigma as a share of E."""
    inside = partial(_inside, distorted=distortion is not None)
    see = jax.vmap(inside, (0, 0, 0, 0, None if distortion is None else 0, None))
    visible = active & see(K, R, t, size, distortion, point)
    if height is not None:
        head = point + jnp.array([0, 0, 1], point.dtype) * height.astype(point.dtype)
        visible = visible & see(K, R, t, size, distortion, head)
    origins = -jnp.einsum("cji,cj->ci", R, t)
    sight = point[None, :] - origins
    length = jnp.sqrt(jnp.sum(sight * sight, axis=-1))
    directions = sight / jnp.where(length > 0, length, 1)[:, None]
    matrix = information(point, origins, directions, visible.astype(point.dtype), sigma_theta)
    ground = Plane(jnp.array([0, 0, 1], point.dtype), jnp.zeros((), point.dtype))
    return visible, ground_sigma(matrix, ground)


def _inside(
    K: Array,
    R: Array,
    t: Array,
    size: Array,
    distortion: Array | None,
    point: Array,
    *,
    distorted: bool,
) -> Array:
    """Whether a point is in the picture, whose border is half a pixel outside pixel centers."""
    pixel, depth = project(K, R, t, point, distortion)
    inside = (depth > 0) & jnp.all((pixel >= -0.5) & (pixel <= size - 0.5))
    if distorted:
        origin, direction = pixel_to_ray(K, R, t, pixel, distortion)
        inside = inside & (angular_residual(point, origin, direction) < FOLD_TOLERANCE)
    return inside
