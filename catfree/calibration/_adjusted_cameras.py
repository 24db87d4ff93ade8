"""Cameras as parametrized in bundle adjustment: seven parameters each.

A `Rig` is validated on construction and stores translations and focal lengths; an adjustment needs
centers, logarithms of focal lengths and incremental rotations, and makes hundreds of intermediate
cameras. This module converts between the two forms.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from catfree.types import Rig

NEAREST_DEPTH = 1e-6  # fraction of E; closer points, or points behind the camera, have no pixel


@dataclass(frozen=True)
class Cameras:
    """The adjusted cameras: `pixel = focal_scale A (x, y) / z + principal point`.

    Attributes:
        R: (C, 3, 3) world-to-camera rotations.
        center: (C, 3) centers.
        log_scale: (C,) natural logarithm of the focal length relative to the one in K.
        K: (C, 3, 3) intrinsics at the start.
    """

    R: Float[np.ndarray, "cam 3 3"]
    center: Float[np.ndarray, "cam 3"]
    log_scale: Float[np.ndarray, " cam"]
    K: Float[np.ndarray, "cam 3 3"]

    @classmethod
    def of(cls, rig: Rig) -> "Cameras":
        """Cameras of a rig; unregistered ones get the identity pose at the origin."""
        registered = rig.registered[:, None]
        return cls(
            np.where(registered[..., None], np.asarray(rig.R, np.float64), np.eye(3)),
            np.where(registered, np.asarray(rig.centers, np.float64), 0.0),
            np.zeros(rig.camera_count),
            np.where(registered[..., None], np.asarray(rig.K, np.float64), np.eye(3)),
        )

    def rig(self, like: Rig) -> Rig:
        """Rig of these cameras, with image sizes, lenses and unregistered cameras of `like`."""
        K = self.K.copy()
        K[:, :2, :2] *= np.exp(self.log_scale)[:, None, None]
        return with_registered(like, K, self.R, -np.einsum("cij,cj->ci", self.R, self.center))

    def project_directions(
        self, direction: Float[np.ndarray, "person cam 3"]
    ) -> Float[np.ndarray, "person cam 2"]:
        """Pixels of world directions, one per person and camera; arbitrary behind the camera."""
        local = np.einsum("cij,pcj->pci", self.R, direction)
        depth = np.where(local[..., 2] > NEAREST_DEPTH, local[..., 2], 1.0)
        focal = self.K[:, :2, :2] * np.exp(self.log_scale)[:, None, None]
        offset = np.einsum("cij,pcj->pci", focal, local[..., :2] / depth[..., None])
        return offset + self.K[:, :2, 2]

    def moved(self, step: Float[np.ndarray, "cam 7"]) -> "Cameras":
        """Apply a step; rotations act in the camera frame."""
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        return replace(
            self,
            R=turn @ self.R,
            center=self.center + step[:, 3:6],
            log_scale=self.log_scale + step[:, 6],
        )

    def away_from(self, start: "Cameras") -> Float[np.ndarray, "cam 7"]:
        """(C, 7) the step from `start` to these cameras."""
        turn = Rotation.from_matrix(self.R @ start.R.transpose(0, 2, 1)).as_rotvec()
        return np.column_stack([turn, self.center - start.center, self.log_scale - start.log_scale])


def with_registered(
    like: Rig,
    K: Float[np.ndarray, "cam 3 3"],
    R: Float[np.ndarray, "cam 3 3"],
    t: Float[np.ndarray, "cam 3"],
) -> Rig:
    """Replace the registered cameras of a rig; the others stay as they are."""
    registered = like.registered[:, None, None]
    return replace(
        like,
        K=np.where(registered, K, np.asarray(like.K, np.float64)),
        R=np.where(registered, R, np.asarray(like.R, np.float64)),
        t=np.where(registered[:, 0], t, np.asarray(like.t, np.float64)),
    )
