"""The frame in which the ground is z = 0 and lengths are shares of the extent."""

from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float

from catfree.types import Rig, Scene
from catfree.types._scene import require_scene


class CanonicalFrame(eqx.Module):
    """Frame with the ground at z = 0, lengths as shares of E, and the cameras near the origin.

    Everything after the adapters runs in this frame: float32 stays accurate 10 km from the origin
    and at any scale, and the result moves with the scene.

    Attributes:
        axes: (3, 3) columns P and the ground normal in world coordinates.
        center: (3,) mean camera center in world coordinates.
        offset: signed height of `center` above the ground in scene units.
        extent: E in scene units.
    """

    axes: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, "3"]
    offset: float
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> "CanonicalFrame":
        """Make the frame of a scene.

        Raises:
            InvalidInputError: if it is not a `Scene`.
        """
        require_scene(scene)
        normal = np.asarray(scene.ground.normal, np.float64)
        axes = np.column_stack([np.asarray(scene.ground.basis, np.float64), normal])
        centers = np.asarray(scene.rig.centers, np.float64)[scene.rig.registered]
        center = centers.mean(0)
        height = float(normal @ center + np.asarray(scene.ground.offset, np.float64))
        return cls(axes, center, height, float(scene.extent))

    def to_canonical(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Convert world points (..., 3) to the canonical frame."""
        local = (np.asarray(points, np.float64) - self.center) @ self.axes
        return (local + np.array([0.0, 0.0, self.offset])) / self.extent

    def to_world(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Convert canonical points (..., 3) to world coordinates."""
        local = np.asarray(points, np.float64) * self.extent - np.array([0.0, 0.0, self.offset])
        return local @ self.axes.T + self.center

    def rig(self, rig: Rig) -> Rig:
        """Convert a rig to the canonical frame; unregistered cameras keep their values."""
        rotation = np.asarray(rig.R, np.float64) @ self.axes
        centers = self.to_canonical(np.asarray(rig.centers))
        return replace(
            rig,
            K=np.asarray(rig.K, np.float64),
            R=rotation,
            t=-np.einsum("cij,cj->ci", rotation, centers),
            distortion=None if rig.distortion is None else np.asarray(rig.distortion, np.float64),
        )
