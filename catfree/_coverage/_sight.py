"""Visibility of places on the ground, and the precision of positions there."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.geometry import CanonicalFrame, ground_sigma, information
from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import people_in_rig
from catfree.geometry._plane import from_plan
from catfree.types import Plane, Scene

PLACES_BLOCK = 4096  # places evaluated together


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
    points = frame.to_canonical(from_plan(scene, places))
    points[:, 2] = 0
    people = points + np.array([0, 0, (person_height or 0) / frame.extent])
    visible = np.zeros((rig.camera_count, len(points)), bool)
    for camera in np.flatnonzero(active):
        head, foot, imaged = people_in_rig(rig, camera, people)
        # The border of a picture is half a pixel outside pixel centers.
        ends = np.stack([head, foot], 1)
        inside = (ends >= -0.5) & (ends <= rig.image_size[camera] - 0.5)
        visible[camera] = imaged & inside.all((1, 2))
    # Unregistered cameras may hold NaN.
    dtype = jnp.result_type(float)
    origins = np.where(active[:, None], np.asarray(rig.centers), 0).astype(dtype)
    sigma = in_blocks(
        lambda *block: _sigmas(*block, origins, np.asarray(sigma_theta, dtype)),
        (points.astype(dtype), visible.T.astype(dtype)),
        PLACES_BLOCK,
    )
    return visible, sigma.astype(np.float64) * frame.extent


@jax.jit
@partial(jax.vmap, in_axes=(0, 0, None, None))
def _sigmas(
    point: Float[Array, "3"],
    visible: Float[Array, " cam"],
    origins: Float[Array, "cam 3"],
    sigma_theta: Float[Array, ""],
) -> Float[Array, ""]:
    """Sigma of a canonical ground point as a share of E."""
    sight = point[None, :] - origins
    length = jnp.sqrt(jnp.sum(sight * sight, axis=-1))
    directions = sight / jnp.where(length > 0, length, 1)[:, None]
    matrix = information(point, origins, directions, visible, sigma_theta)
    ground = Plane(jnp.array([0, 0, 1], point.dtype), jnp.zeros((), point.dtype))
    return ground_sigma(matrix, ground)
