"""Foot rays: from a pixel into the world, their distance from a point, and their reliability."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from catfree.geometry._arrays import Scalar, as_flags, float_arrays, require_vectors, safe_norm
from catfree.geometry.camera import back_project
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import require_shape


def pixel_to_ray(
    K: Real[HostOrDevice, "3 3"],
    R: Real[HostOrDevice, "3 3"],
    t: Real[HostOrDevice, "3"],
    pixel: Real[HostOrDevice, "2"],
    distortion: Real[HostOrDevice, "5"] | Real[HostOrDevice, "8"] | None = None,
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Find the half-line of world points that a camera sees at one pixel.

    Args:
        K: (3, 3) intrinsics in pixels.
        R: (3, 3) world-to-camera rotation.
        t: (3,) world-to-camera translation in scene units.
        pixel: (2,) in original image pixels, center of the top-left pixel at (0, 0).
        distortion: (5,) or (8,) OpenCV coefficients, or None for a pinhole.

    Returns:
        origin: (3,) camera center `-Rᵀ t` in the world frame, scene units.
        direction: (3,) unit vector in the world frame.

    Raises:
        InvalidInputError: if pixel or t is not one vector, or K or R one matrix.

    Source: paper, Sec. "Pedestrian observations and ray reliability", back-projection of the
        bottom center of a box.
    """
    intrinsics, rotation, translation, pixel, distortion = float_arrays(
        "distortion", K=K, R=R, t=t, pixel=pixel, distortion=distortion
    )
    require_vectors(3, t=translation)
    require_shape(rotation, (3, 3), "R")
    normalized = back_project(intrinsics, pixel, distortion)
    in_camera = jnp.concatenate([normalized, jnp.ones((1,), normalized.dtype)])
    direction = jnp.asarray(rotation).T @ in_camera
    origin = -(jnp.asarray(rotation).T @ translation)
    return origin, direction / jnp.sqrt(jnp.sum(direction * direction))


def angular_residual(
    position: Real[HostOrDevice, "3"],
    origin: Real[HostOrDevice, "3"],
    direction: Real[HostOrDevice, "3"],
) -> Float[Array, ""]:
    """Compute the angle at a camera center between a ray and the line of sight to a position.

    Written with the arctangent: the arccosine of the paper loses all digits of an angle below
    3e-4 rad in float32 and has no derivative at 0 and pi.

    Args:
        position: (3,) world point in scene units.
        origin: (3,) camera center in scene units.
        direction: (3,) unit vector in the world frame.

    Returns:
        () radians in [0, pi]; pi / 2 with gradient 0 for a position at the camera center, where the
        angle is undefined.

    Raises:
        InvalidInputError: if position, origin or direction is not one vector.

    Source: paper, Eq. theta.
    """
    position, origin, direction = float_arrays(
        position=position, origin=origin, direction=direction
    )
    require_vectors(3, position=position, origin=origin, direction=direction)
    sight = position - origin
    # Rescaled by its largest entry so that the squares of very small scenes do not vanish. The
    # angle does not depend on the scale, so the scale may count as constant.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(sight)))
    is_apart = largest > 0
    sight = jnp.where(is_apart, sight, direction) / jnp.where(is_apart, largest, 1)
    angle = jnp.arctan2(safe_norm(jnp.cross(direction, sight)), jnp.sum(direction * sight))
    return jnp.where(is_apart, angle, math.pi / 2)


def height_weight(height: Scalar, median_height: Scalar) -> Float[Array, ""]:
    """Weight a box by its height: distant people are short, and their foot point is imprecise.

    Args:
        height: () box height in pixels.
        median_height: () median box height of the sequence in pixels.

    Returns:
        () `min(1, (height / median_height)²)`; 1 where the median is not a positive number.

    Source: paper, Eq. w.
    """
    height, median_height = float_arrays(height=height, median_height=median_height)
    usable = median_height > 0  # false for NaN too
    share = height / jnp.where(usable, median_height, 1)
    return jnp.where(usable, jnp.minimum(1, share**2), 1)


def pose_ratio(median_residual_pose: Scalar, median_residual_other: Scalar) -> Float[Array, ""]:
    """Weight a ray without confirmed ankles, relative to one with them.

    Args:
        median_residual_pose: () median angular residual of rays with confirmed ankles, radians.
        median_residual_other: () the same of all other rays, radians.

    Returns:
        () `min(1, (s_pose / s_other)²)`; 1 where either median does not exist (NaN) or where
        `s_other` is 0, because then nothing indicates that those rays are worse.

    Source: paper, Eq. w_pose; the bound of 1 keeps w in (0, 1].
    """
    pose, other = float_arrays(
        median_residual_pose=median_residual_pose, median_residual_other=median_residual_other
    )
    usable = (other > 0) & ~jnp.isnan(pose)
    ratio = jnp.where(usable, pose, 1) / jnp.where(usable, other, 1)
    return jnp.minimum(1, ratio * ratio)


def ray_weight(
    height: Scalar,
    median_height: Scalar,
    ankles_confirmed: bool | Bool[HostOrDevice, ""],
    ratio: Scalar,
    minimum: Scalar = 1e-4,
) -> Float[Array, ""]:
    """Compute the reliability w of a foot ray from box height and ankle visibility.

    Args:
        height: () box height in pixels.
        median_height: () median box height of the sequence in pixels.
        ankles_confirmed: () whether both ankle keypoints were seen.
        ratio: () the result of `pose_ratio`, in [0, 1].
        minimum: () floor of w: an existing ray never becomes an absent one (weight 0).

    Returns:
        () w in [minimum, 1].

    Raises:
        InvalidInputError: if `ankles_confirmed` is neither true nor false.

    Source: paper, Eq. w.
    """
    height, median_height, ratio, minimum = float_arrays(
        height=height, median_height=median_height, ratio=ratio, minimum=minimum
    )
    confirmed = as_flags(ankles_confirmed, "ankles_confirmed")
    trust = height_weight(height, median_height)
    return jnp.maximum(jnp.where(confirmed, 1, ratio) * trust, minimum)
