"""The cameras as bundle adjustment moves them: seven numbers each, in steps that can be undone.

A `Rig` is checked where it is made and stores translations and focal lengths; an adjustment needs
centres, logarithms of focal lengths and rotations that turn by a step, and makes hundreds of
cameras that nobody else sees. This is that form, with the ways from a rig and back.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from catfree.types import Rig

NEAREST_DEPTH = 1e-6  # shares of E: closer, or behind the camera, a point has no pixel


@dataclass(frozen=True)
class Cameras:
    """What the adjustment changes: `pixel = focal_scale A (x, y) / z + principal point`.

    Attributes:
        R: (C, 3, 3) world-to-camera rotations.
        center: (C, 3) centres.
        log_scale: (C,) logarithm of the focal length over the one in K.
        K: (C, 3, 3) intrinsics at the start.
    """

    R: Float[np.ndarray, "cam 3 3"]
    center: Float[np.ndarray, "cam 3"]
    log_scale: Float[np.ndarray, " cam"]
    K: Float[np.ndarray, "cam 3 3"]

    @classmethod
    def of(cls, rig: Rig) -> "Cameras":
        """The cameras of a rig; those that are not registered stand still at the origin."""
        known = rig.registered[:, None]
        return cls(
            np.where(known[..., None], np.asarray(rig.R, np.float64), np.eye(3)),
            np.where(known, np.asarray(rig.centers, np.float64), 0.0),
            np.zeros(rig.camera_count),
            np.where(known[..., None], np.asarray(rig.K, np.float64), np.eye(3)),
        )

    def rig(self, like: Rig) -> Rig:
        """A rig of these cameras with the sizes, lenses and unregistered cameras of another."""
        known = like.registered[:, None, None]
        K = self.K.copy()
        K[:, :2, :2] *= np.exp(self.log_scale)[:, None, None]
        t = -np.einsum("cij,cj->ci", self.R, self.center)
        return Rig(
            np.where(known, K, np.asarray(like.K, np.float64)),
            np.where(known, self.R, np.asarray(like.R, np.float64)),
            np.where(known[:, 0], t, np.asarray(like.t, np.float64)),
            like.image_size,
            like.distortion,
            like.registered,
        )

    def project_directions(
        self, direction: Float[np.ndarray, "person cam 3"]
    ) -> Float[np.ndarray, "person cam 2"]:
        """Pixels of world directions, one a person and camera; anything for those behind."""
        local = np.einsum("cij,pcj->pci", self.R, direction)
        depth = np.where(local[..., 2] > NEAREST_DEPTH, local[..., 2], 1.0)
        focal = self.K[:, :2, :2] * np.exp(self.log_scale)[:, None, None]
        offset = np.einsum("cij,pcj->pci", focal, local[..., :2] / depth[..., None])
        return offset + self.K[:, :2, 2]

    def moved(self, step: Float[np.ndarray, "cam 7"]) -> "Cameras":
        """The cameras after a step; rotations turn in their own camera frame."""
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        return replace(
            self,
            R=turn @ self.R,
            center=self.center + step[:, 3:6],
            log_scale=self.log_scale + step[:, 6],
        )

    def away_from(self, start: "Cameras") -> Float[np.ndarray, "cam 7"]:
        """(C, 7) the step that leads here from `start`."""
        turn = Rotation.from_matrix(self.R @ start.R.transpose(0, 2, 1)).as_rotvec()
        return np.column_stack([turn, self.center - start.center, self.log_scale - start.log_scale])
