"""Valid parameters of some cameras, for tests of code that uses them."""

import numpy as np
from scipy.spatial.transform import Rotation

K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])


def parameters(cameras: int = 3, dtype: type[np.floating] = np.float64) -> dict:
    rng = np.random.default_rng(0)
    return {
        "K": np.tile(K, (cameras, 1, 1)).astype(dtype),
        "R": Rotation.from_quat(rng.standard_normal((cameras, 4)))
        .as_matrix()
        .reshape(-1, 3, 3)
        .astype(dtype),
        "t": rng.standard_normal((cameras, 3)).astype(dtype),
        "image_size": (640, 480),
    }
