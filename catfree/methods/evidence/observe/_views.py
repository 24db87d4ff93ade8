"""Cameras as linear maps from (y1, y2, H) on the ground, in units of H0, to pixels."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from catfree.types import Scene

PEOPLE_BLOCKS = (64, 512)  # block sizes: people processed together in all cameras


class GroundViews(eqx.Module):
    """The cameras of a scene, expressed on its ground plane.

    A point at plane position (y1, y2) and height h (all in units of H0, from `origin`) has the
    homogeneous pixel `matrix @ (y1, y2, h, 1)`; its third entry is positive in front of the camera.

    Attributes:
        matrix: (C, 3, 4) projection; contains no NaN, even for unregistered cameras.
        ground_inverse: (C, 3, 3) map from a pixel to the homogeneous plane position of a foot.
        head_inverse: (C, 3, 3) the same for a point at height H0.
        focal: (C,) in pixels.
        center: (C, 2) principal point in pixels.
        image_size: (C, 2) width and height in pixels.
        station: (C, 2) the camera center projected onto the plane, in H0.
        heading: (C, 2) unit viewing direction of the camera on the plane.
        registered: (C,) bool.
        origin: (2,) plane coordinates of the local origin in scene units.
        unit: () H0 in scene units.
    """

    matrix: Float[np.ndarray, "cam 3 4"]
    ground_inverse: Float[np.ndarray, "cam 3 3"]
    head_inverse: Float[np.ndarray, "cam 3 3"]
    focal: Float[np.ndarray, " cam"]
    center: Float[np.ndarray, "cam 2"]
    image_size: Float[np.ndarray, "cam 2"]
    station: Float[np.ndarray, "cam 2"]
    heading: Float[np.ndarray, "cam 2"]
    registered: Bool[np.ndarray, " cam"]
    origin: Float[np.ndarray, "2"]
    unit: Float[np.ndarray, ""]


def ground_views(scene: Scene, unit: float) -> GroundViews:
    """Express the rig on the plane, in units of H0.

    Args:
        scene: rig and ground plane in scene units.
        unit: H0 in scene units.

    Returns:
        The cameras as maps from the plane to pixels.
    """
    rig = scene.rig
    registered = np.asarray(rig.registered)
    count = rig.camera_count

    def host(value: Any, fallback: np.ndarray) -> np.ndarray:
        array = np.asarray(value, np.float64)
        return np.where(registered.reshape(-1, *(1,) * (array.ndim - 1)), array, fallback)

    K = host(rig.K, np.eye(3))
    R = host(rig.R, np.eye(3))
    t = host(rig.t, np.array([0.0, 0.0, 1.0]))
    normal = np.asarray(scene.ground.normal, np.float64)
    offset = float(scene.ground.offset)
    basis = np.asarray(scene.ground.basis, np.float64)
    centers = -np.einsum("cji,cj->ci", R, t)
    plane_centers = centers @ basis
    origin = plane_centers[registered].mean(0) if registered.any() else np.zeros(2)
    start = basis @ origin - offset * normal  # the local origin in the world
    axes = np.concatenate(
        [R @ basis, (R @ normal)[..., None], ((R @ start + t) / unit)[..., None]], axis=-1
    )
    matrix = K @ axes
    foot = matrix[..., [0, 1, 3]]
    head = np.concatenate([matrix[..., :2], matrix[..., 2:3] + matrix[..., 3:]], axis=-1)
    forward = R[:, 2] @ basis  # optical axis on the plane; for a camera looking down, image up
    upward = -R[:, 1] @ basis
    norm = np.linalg.norm(forward, axis=-1, keepdims=True)
    heading = np.where(norm > 1e-3, forward, upward)
    heading = heading / np.maximum(np.linalg.norm(heading, axis=-1, keepdims=True), 1e-12)
    return GroundViews(
        matrix=np.where(registered[:, None, None], matrix, np.eye(3, 4)),
        ground_inverse=_inverse(foot, registered),
        head_inverse=_inverse(head, registered),
        focal=np.sqrt(np.abs(K[:, 0, 0] * K[:, 1, 1])),
        center=K[:, :2, 2].copy(),
        image_size=np.asarray(rig.image_size, np.float64).reshape(count, 2),
        station=(plane_centers - origin) / unit,
        heading=heading,
        registered=registered,
        origin=origin,
        unit=np.asarray(unit, np.float64),
    )


def _inverse(matrix: np.ndarray, registered: np.ndarray) -> np.ndarray:
    """Invert each 3x3 map; identity for cameras that are unregistered or in that plane."""
    scale = np.abs(matrix).max((-1, -2), keepdims=True)
    good = registered & (np.abs(np.linalg.det(matrix / scale)) > 1e-12)
    return np.linalg.inv(np.where(good[:, None, None], matrix, np.eye(3)))


def safe_ratio(numerator: Array, denominator: Array) -> Array:
    """Numerator / denominator, finite if the denominator is not positive."""
    return numerator / jnp.where(denominator > 1e-9, denominator, 1e-9)


def predict_edges(matrix: Array, state: Array) -> Float[Array, "3"]:
    """Predict the box edges of a person in an image: center column, head row, foot row.

    Args:
        matrix: (3, 4) camera of `GroundViews`.
        state: (3,) plane position and height in H0.

    Returns:
        (3,) pixels.
    """
    one, zero = jnp.ones((), state.dtype), jnp.zeros((), state.dtype)
    foot = matrix @ jnp.stack([state[0], state[1], zero, one])
    head = matrix @ jnp.stack([state[0], state[1], state[2], one])
    column = 0.5 * (safe_ratio(foot[0], foot[2]) + safe_ratio(head[0], head[2]))
    return jnp.stack([column, safe_ratio(head[1], head[2]), safe_ratio(foot[1], foot[2])])


def edges_and_slopes(matrix: Array, state: Array) -> tuple[Array, Array]:
    """`predict_edges` and its (3, 3) Jacobian with respect to the state."""
    return predict_edges(matrix, state), jax.jacfwd(predict_edges, argnums=1)(matrix, state)


def drop_to_height(inverse: Array, pixel: Array) -> Float[Array, "2"]:
    """Plane position whose foot (or head, with `head_inverse`) is at a pixel (2,)."""
    point = inverse @ jnp.stack([pixel[0], pixel[1], jnp.ones((), pixel.dtype)])
    denominator = point[2]
    small = jnp.abs(denominator) < 1e-12
    return point[:2] / jnp.where(small, 1e-12, denominator)


def height_at(matrix: Array, position: Array, row: Array) -> Float[Array, ""]:
    """Height at which a person at a plane position reaches an image row."""
    base = matrix[:, 0] * position[0] + matrix[:, 1] * position[1] + matrix[:, 3]
    numerator = row * base[2] - base[1]
    denominator = matrix[1, 2] - row * matrix[2, 2]
    small = jnp.abs(denominator) < 1e-12
    return numerator / jnp.where(small, 1e-12, denominator)
