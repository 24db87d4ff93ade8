"""Apply a bundle adjustment step, seven parameters per camera, to the cameras of a rig."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from catfree.types import Rig


def moved_rig(rig: Rig, step: Float[np.ndarray, "cam 7"]) -> Rig:
    """Apply a step to the cameras of a rig.

    Args:
        rig: pinholes, with float64 arrays.
        step: (C, 7) rotation vector in the camera's axes in radians, displacement of the center in
            scene units, and change of the natural logarithm of the focal length.
    """
    R = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rig.R
    K = np.array(rig.K)
    K[:, :2, :2] *= np.exp(step[:, 6])[:, None, None]
    return replace(rig, K=K, R=R, t=-np.einsum("cij,cj->ci", R, rig.centers + step[:, 3:6]))


def with_registered(
    like: Rig,
    K: Float[np.ndarray, "cam 3 3"],
    R: Float[np.ndarray, "cam 3 3"],
    t: Float[np.ndarray, "cam 3"],
) -> Rig:
    """Replace the registered cameras of a rig, leaving the others unchanged."""
    registered = like.registered[:, None, None]
    return replace(
        like,
        K=np.where(registered, K, np.asarray(like.K, np.float64)),
        R=np.where(registered, R, np.asarray(like.R, np.float64)),
        t=np.where(registered[:, 0], t, np.asarray(like.t, np.float64)),
    )
