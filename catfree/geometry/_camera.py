"""Projection and back-projection of a pinhole camera with OpenCV's five distortion coefficients.

Conventions: `x_camera = R x_world + t`, camera axes x right, y down, z forward; pixels with the
center of the top-left pixel at (0, 0); distortion k1, k2, p1, p2, k3.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Real

from catfree.geometry._arrays import float_arrays, safe_norm
from catfree.types._annotations import HostOrDevice

# Newton's method converges quadratically from the distorted point; ten steps reach float64
# precision for every lens whose distortion is invertible in its image.
UNDISTORTION_STEPS = 10
# Longest Newton step in units of 1 + radius: keeps points outside the invertible disc finite.
UNDISTORTION_TRUST = 0.3
# A point is in front of a camera if its depth is more than this share of its distance. Below it
# (89.99 degrees off the axis) no pinhole image exists and powers of the radius overflow float32.
FRONT_SHARE = 1e-4


def distort(
    point: Real[HostOrDevice, "2"], distortion: Real[HostOrDevice, "5"]
) -> Float[Array, "2"]:
    """Apply lens distortion to a point of the normalized image plane.

    Args:
        point: (2,) ideal coordinates x/z, y/z in the camera frame, without unit.
        distortion: (5,) OpenCV k1, k2, p1, p2, k3.

    Returns:
        (2,) distorted normalized coordinates.

    Source: the radial and tangential model of Brown (1971) as OpenCV's `projectPoints` states it.
    """
    point, distortion = float_arrays(point, distortion)
    x, y = point[0], point[1]
    k1, k2, p1, p2, k3 = (distortion[i] for i in range(5))
    squared = x * x + y * y
    radial = 1 + squared * (k1 + squared * (k2 + squared * k3))
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
            y * radial + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def undistort(
    point: Real[HostOrDevice, "2"], distortion: Real[HostOrDevice, "5"]
) -> Float[Array, "2"]:
    """Invert `distort` by a fixed number of Newton steps (hence differentiable).

    Args:
        point: (2,) distorted normalized coordinates, without unit.
        distortion: (5,) OpenCV k1, k2, p1, p2, k3.

    Returns:
        (2,) ideal normalized coordinates; finite but arbitrary where no ideal point maps there.

    Source: the model of Brown (1971) as in `distort`, inverted by Newton's method.
    """
    return _undistort(*float_arrays(point, distortion))


@jax.jit
def _undistort(distorted: Array, coefficients: Array) -> Array:
    """Compiled body of `undistort`: uncompiled, every call would trace its loop again."""

    def newton_step(estimate: Array, _: None) -> tuple[Array, None]:
        error = distort(estimate, coefficients) - distorted
        jacobian = jax.jacfwd(distort)(estimate, coefficients)
        a, b, c, d = jacobian[0, 0], jacobian[0, 1], jacobian[1, 0], jacobian[1, 1]
        determinant = a * d - b * c
        # Beyond the fold of the lens the determinant is not positive: step along the error.
        regular = determinant > 1e-3
        scale = 1 / jnp.where(regular, determinant, 1)
        newton = scale * jnp.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]])
        step = jnp.where(regular, newton, error)
        length = safe_norm(step)
        longest = UNDISTORTION_TRUST * (1 + safe_norm(estimate))
        shrink = jnp.where(length > longest, longest / jnp.where(length > longest, length, 1), 1)
        return estimate - shrink * step, None

    return jax.lax.scan(newton_step, distorted, None, length=UNDISTORTION_STEPS)[0]


def project(
    K: Real[HostOrDevice, "3 3"],
    R: Real[HostOrDevice, "3 3"],
    t: Real[HostOrDevice, "3"],
    point: Real[HostOrDevice, "3"],
    distortion: Real[HostOrDevice, "5"] | None = None,
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Project a world point to its pixel and its depth.

    Args:
        K: (3, 3) intrinsics in pixels.
        R: (3, 3) world-to-camera rotation.
        t: (3,) world-to-camera translation in scene units.
        point: (3,) world point in scene units.
        distortion: (5,) OpenCV coefficients, or None for a pinhole.

    Returns:
        pixel: (2,) in original image pixels; finite but meaningless where depth is not positive.
        depth: () coordinate along the optical axis in scene units, negative behind the camera.
    """
    intrinsics, rotation, translation, world, distortion = float_arrays(K, R, t, point, distortion)
    in_camera = rotation @ world + translation
    depth = in_camera[2]
    distance = safe_norm(in_camera)
    in_front = depth > FRONT_SHARE * distance
    # Elsewhere divide by the distance: finite, though meaningless.
    divisor = jnp.where(in_front, depth, jnp.where(distance > 0, distance, 1))
    normalized = in_camera[:2] / divisor
    if distortion is not None:
        normalized = distort(normalized, distortion)
    return intrinsics[:2, :2] @ normalized + intrinsics[:2, 2], depth


def back_project(
    K: Real[HostOrDevice, "3 3"],
    pixel: Real[HostOrDevice, "2"],
    distortion: Real[HostOrDevice, "5"] | None = None,
) -> Float[Array, "2"]:
    """Ideal normalized coordinates of a pixel: the inverse of intrinsics and distortion.

    Args:
        K: (3, 3) intrinsics `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]` in pixels.
        pixel: (2,) in original image pixels.
        distortion: (5,) OpenCV coefficients, or None for a pinhole.

    Returns:
        (2,) x/z, y/z in the camera frame.
    """
    K, pixel, distortion = float_arrays(K, pixel, distortion)
    y = (pixel[1] - K[1, 2]) / K[1, 1]
    x = (pixel[0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    normalized = jnp.stack([x, y])
    return normalized if distortion is None else undistort(normalized, distortion)
