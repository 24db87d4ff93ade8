"""The scene's own frame, and the ray of every detection in it."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from catfree.association.observations import Observations
from catfree.geometry import pixel_to_ray
from catfree.types import Rays, Rig, Scene

DETECTION_BLOCK = 8192  # arrays of detections are padded to this: no sequence recompiles


class CanonicalFrame(eqx.Module):
    """Coordinates in which the ground is z = 0, lengths are shares of E, and the cameras are near.

    Everything after the adapters runs in this frame: float32 stays accurate 10 km from the origin
    and at any scale, and the result moves with the scene.

    Attributes:
        axes: (3, 3) columns P and the ground normal in world coordinates.
        center: (3,) mean camera centre in world coordinates.
        offset: signed height of the centre above the ground in scene units.
        extent: E in scene units.
    """

    axes: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, "3"]
    offset: float
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> "CanonicalFrame":
        """The frame of a scene."""
        normal = np.asarray(scene.ground.normal, np.float64)
        axes = np.column_stack([np.asarray(scene.ground.basis, np.float64), normal])
        centers = np.asarray(scene.rig.centers, np.float64)[scene.rig.registered]
        center = centers.mean(0)
        height = float(normal @ center + np.asarray(scene.ground.offset, np.float64))
        return cls(axes, center, height, float(scene.extent))

    def to_canonical(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """World points (..., 3) in the canonical frame."""
        local = (np.asarray(points, np.float64) - self.center) @ self.axes
        return (local + np.array([0.0, 0.0, self.offset])) / self.extent

    def to_world(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Canonical points (..., 3) in world coordinates."""
        local = np.asarray(points, np.float64) * self.extent - np.array([0.0, 0.0, self.offset])
        return local @ self.axes.T + self.center

    def rig(self, rig: Rig) -> Rig:
        """The rig in the canonical frame; cameras that are not registered keep their numbers."""
        rotation = np.asarray(rig.R, np.float64) @ self.axes
        centers = self.to_canonical(np.asarray(rig.centers))
        return Rig(
            np.asarray(rig.K, np.float64),
            rotation,
            -np.einsum("cij,cj->ci", rotation, centers),
            rig.image_size,
            None if rig.distortion is None else np.asarray(rig.distortion, np.float64),
            rig.registered,
        )


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
    """The ray of every observation through the bottom centre of its box.

    Args:
        observations: detections in canonical order.
        rig: cameras in the frame in which the rays are wanted.

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
