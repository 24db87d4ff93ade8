"""Reliability of each ray from confirmed ankles and box height, estimated from the sequence."""

import jax
import numpy as np
from jaxtyping import Bool, Float

from catfree import geometry
from catfree.geometry._buckets import in_blocks
from catfree.settings import RaySettings

DETECTION_BLOCK = 8192  # detections weighed by one call

_weigh = jax.jit(jax.vmap(geometry.ray_weight, (0, None, 0, None, None)))


def measured_pose_ratio(
    residual: Float[np.ndarray, " n"], ankles_confirmed: Bool[np.ndarray, " n"]
) -> float:
    """Estimate the weight of rays without confirmed ankles relative to rays with them.

    Args:
        residual: (N,) angular residuals of an unweighted triangulation in radians; NaN for
            detections outside any group.
        ankles_confirmed: (N,) bool.

    Returns:
        min(1, (s_pose / s_other)²) with s the medians; 1 if one of the two classes is empty or
        s_other is 0.

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    finite = np.isfinite(residual)
    confirmed, other = residual[finite & ankles_confirmed], residual[finite & ~ankles_confirmed]
    if len(confirmed) == 0 or len(other) == 0:
        return 1.0
    with jax.enable_x64(True):
        return float(geometry.pose_ratio(float(np.median(confirmed)), float(np.median(other))))


def ray_weights(
    height: Float[np.ndarray, " n"],
    ankles_confirmed: Bool[np.ndarray, " n"] | None,
    ratio: float,
    median_height: float,
    settings: RaySettings,
) -> Float[np.ndarray, " n"]:
    """Compute the reliability w of each ray in (0, 1].

    Args:
        height: (N,) box heights in pixels.
        ankles_confirmed: (N,) bool, or None without a pose estimator.
        ratio: the pose ratio.
        median_height: median box height of the sequence in pixels.
        settings: the cues to use, and the floor.

    Returns:
        (N,) weights.

    Source:
        Eq. w.
    """
    by_ankles = settings.use_ankles and ankles_confirmed is not None
    confirmed = ankles_confirmed if by_ankles else np.ones(len(height), bool)
    median = median_height if settings.use_box_height else np.nan  # no median: no height cue
    with jax.enable_x64(True):  # the heights are in double precision
        return in_blocks(
            lambda *rows: _weigh(rows[0], median, rows[1], ratio, settings.minimum_weight),
            (height, confirmed),
            DETECTION_BLOCK,
        )
