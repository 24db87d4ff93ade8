"""Reconstructions of a known rig, for tests of code that uses them."""

import numpy as np
from scipy.spatial.transform import Rotation

from catfree.types import Rig
from catfree.types.results._reconstruction import Reconstruction


def reconstruct(
    rig: Rig,
    rng: np.random.Generator,
    *,
    rotation: float = 0.0,
    center: float = 0.0,
    focal: float = 0.0,
    points: np.ndarray | None = None,
    **fields: object,
) -> Reconstruction:
    """Add normal errors (radians, scene units, relative) to a rig, in a random frame."""
    cameras = rig.camera_count
    turn = Rotation.from_rotvec(rotation * rng.standard_normal((cameras, 3))).as_matrix()
    R = turn @ np.asarray(rig.R)
    centers = np.asarray(rig.centers) + center * rng.standard_normal((cameras, 3))
    K = np.array(rig.K)
    K[:, [0, 1], [0, 1]] *= np.exp(focal * rng.standard_normal(cameras))[:, None]
    scale = np.exp(rng.uniform(-3, 3))
    gauge = Rotation.random(random_state=rng).as_matrix()
    shift = rng.normal(0, 10, 3)
    centers = scale * centers @ gauge.T + shift
    R = R @ gauge.T
    cloud = np.zeros((0, 3)) if points is None else scale * points @ gauge.T + shift
    confidence = np.ones(len(cloud))
    return Reconstruction(K, R, -np.einsum("cij,cj->ci", R, centers), cloud, confidence, **fields)
