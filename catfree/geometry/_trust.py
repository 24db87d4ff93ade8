"""Eq. w, written once for NumPy and JAX arrays: the host weighs sequences, kernels weigh rays."""

from typing import Any


def height_trust(xp: Any, height: Any, median_height: Any) -> Any:
    """`min(1, (height / median_height)²)`; 1 where the median is not a positive number.

    Args:
        xp: `numpy` or `jax.numpy`, whichever the arrays belong to.
        height: (...) box heights in pixels.
        median_height: () median box height of the sequence in pixels.

    Returns:
        (...) in the arrays' dtype.
    """
    usable = median_height > 0  # false for NaN too
    share = height / xp.where(usable, median_height, 1)
    return xp.where(usable, xp.minimum(1, share**2), 1)


def pose_trust(xp: Any, median_residual_pose: Any, median_residual_other: Any) -> Any:
    """`min(1, (s_pose / s_other)²)`; 1 where a median is NaN or s_other is 0.

    Args:
        xp: `numpy` or `jax.numpy`, whichever the arrays belong to.
        median_residual_pose: () s_pose, radians.
        median_residual_other: () s_other, radians.

    Returns:
        () in the arrays' dtype.
    """
    usable = (median_residual_other > 0) & ~xp.isnan(median_residual_pose)
    ratio = xp.where(usable, median_residual_pose, 1) / xp.where(usable, median_residual_other, 1)
    return xp.minimum(1, ratio * ratio)


def combined_trust(xp: Any, height: Any, ankles_confirmed: Any, ratio: Any, minimum: Any) -> Any:
    """The weight w of rays whose boxes are trusted by `height`.

    Args:
        xp: `numpy` or `jax.numpy`, whichever the arrays belong to.
        height: (...) what `height_trust` gives.
        ankles_confirmed: (...) bool.
        ratio: () what `pose_trust` gives.
        minimum: () floor of w: an existing ray never becomes an absent one (weight 0).

    Returns:
        (...) in [minimum, 1], in the arrays' dtype.
    """
    return xp.maximum(xp.where(ankles_confirmed, 1, ratio) * height, minimum)
