"""How far each ray can be trusted: confirmed ankles and box height, learned from the sequence."""

import numpy as np
from jaxtyping import Bool, Float

from catfree.settings import RaySettings


def pose_ratio(
    residual: Float[np.ndarray, " n"], ankles_confirmed: Bool[np.ndarray, " n"]
) -> float:
    """Weight of rays without confirmed ankles against rays with them.

    Args:
        residual: (N,) angular residuals of an unweighted triangulation in radians; NaN for
            detections that belong to no group.
        ankles_confirmed: (N,) bool.

    Returns:
        min(1, (s_pose / s_other)²) with s the medians; 1 where one of the two classes is empty or
        s_other is 0, since then nothing speaks against the others.

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    known = np.isfinite(residual)
    confirmed, other = residual[known & ankles_confirmed], residual[known & ~ankles_confirmed]
    if len(confirmed) == 0 or len(other) == 0:
        return 1.0
    s_pose, s_other = float(np.median(confirmed)), float(np.median(other))
    return min(1.0, (s_pose / s_other) ** 2) if s_other > 0 else 1.0


def ray_weights(
    height: Float[np.ndarray, " n"],
    ankles_confirmed: Bool[np.ndarray, " n"] | None,
    ratio: float,
    median_height: float,
    settings: RaySettings,
) -> Float[np.ndarray, " n"]:
    """Reliability w of each ray in (0, 1].

    Args:
        height: (N,) box heights in pixels.
        ankles_confirmed: (N,) bool, or None where no pose estimator ran.
        ratio: the pose ratio.
        median_height: median box height of the sequence in pixels.
        settings: which cues are used, and the floor.

    Returns:
        (N,) weights.

    Source:
        Eq. w.
    """
    weight = np.ones(len(height))
    if settings.use_ankles and ankles_confirmed is not None:
        weight = np.where(ankles_confirmed, 1.0, ratio)
    if settings.use_box_height:
        weight = weight * np.minimum(1.0, (height / median_height) ** 2)
    return np.maximum(weight, settings.minimum_weight)
