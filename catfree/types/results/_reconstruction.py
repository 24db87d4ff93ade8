"""The result of a reconstructor for one instant: `Reconstruction`, in its own frame and scale.

The type is separate from the protocol of reconstructors, because code that averages reconstructions
(`catfree.calibration`) does not depend on how they were made.
"""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from catfree.types._rig import require_cameras
from catfree.types._validation import (
    as_flag,
    as_float,
    as_registered,
    as_rows,
    require_finite,
    require_shape,
)


class Reconstruction(eqx.Module):
    """Cameras and scene points of one instant, in their own frame and scale.

    Attributes:
        K: (C, 3, 3) intrinsics in pixels of the ORIGINAL pictures.
        R: (C, 3, 3) world-to-camera rotations, OpenCV axes: `x_cam = R x + t`.
        t: (C, 3) world-to-camera translations in the reconstruction's units.
        points: (P, 3) scene points in the reconstruction's frame.
        confidence: (P,) positive confidence of each point; comparable within one reconstruction.
        scale_is_metric: whether the units are meters.
        weights_id: content hash of the weights that produced it.
        registered: (C,) false for views whose camera could not be determined; their K, R and t are
            finite placeholders.
    """

    K: Float[np.ndarray, "cam 3 3"]
    R: Float[np.ndarray, "cam 3 3"]
    t: Float[np.ndarray, "cam 3"]
    points: Float[np.ndarray, "p 3"]
    confidence: Float[np.ndarray, " p"]
    scale_is_metric: bool = eqx.field(static=True)
    weights_id: str = eqx.field(static=True)
    registered: Bool[np.ndarray, " cam"]

    def __init__(
        self,
        K: Any,
        R: Any,
        t: Any,
        points: Any,
        confidence: Any,
        scale_is_metric: bool = False,
        weights_id: str = "",
        registered: Any = None,
    ) -> None:
        """Validate and store.

        Raises:
            InvalidInputError: naming the first wrong shape, value that is not finite, invalid
                intrinsics or matrix that is not a rotation.
        """
        self.K, self.R, self.t = (
            np.asarray(as_float(value, name)) for name, value in (("K", K), ("R", R), ("t", t))
        )
        self.points = as_rows(points, 3, "points")
        self.confidence = np.asarray(as_float(confidence, "confidence"))
        self.scale_is_metric, self.weights_id = (
            as_flag(scale_is_metric, "scale_is_metric"),
            str(weights_id),
        )
        require_shape(self.t, (None, 3), "t")
        cameras = len(self.t)
        self.registered = as_registered(registered, cameras)
        require_shape(self.K, (cameras, 3, 3), "K")
        require_shape(self.R, (cameras, 3, 3), "R")
        require_shape(self.confidence, (len(self.points),), "confidence")
        for name in ("K", "R", "t", "points", "confidence"):
            require_finite(getattr(self, name), name)
        require_cameras(self.K, self.R, np.ones(cameras, bool))
