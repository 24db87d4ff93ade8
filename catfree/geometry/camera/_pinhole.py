"""A pinhole camera with OpenCV's lens distortion of five or eight coefficients.

Conventions: `x_camera = R x_world + t`, camera axes x right, y down, z forward; pixels with the
center of the top-left pixel at (0, 0); distortion k1, k2, p1, p2, k3 and optionally k4, k5, k6.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from catfree.errors import InvalidInputError
from catfree.geometry._arrays import float_arrays, require_vectors, safe_norm
from catfree.geometry.camera._inversion import inside_fold, invert
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import require_shape

# A point is in front of a camera if its depth is more than this share of its distance. Below it
# (89.4 degrees off the axis) no pinhole image exists, and derivatives of a lens overflow float32.
FRONT_SHARE = 1e-2
# Places between the axis and a point, evenly spaced in angle, at which the lens must not fold.
FOLD_SAMPLES = 16
SMALLEST_DENOMINATOR = 1e-3  # of the rational model: its pole is far outside the image

Lens = Real[HostOrDevice, "5"] | Real[HostOrDevice, "8"]


def distort(point: Real[HostOrDevice, "2"], distortion: Lens) -> Float[Array, "2"]:
    """Apply lens distortion to a point of the normalized image plane.

    Args:
        point: (2,) ideal coordinates x/z, y/z in the camera frame, without unit.
        distortion: (5,) OpenCV k1, k2, p1, p2, k3, or (8,) with k4, k5, k6 of the rational model.

    Returns:
        (2,) distorted normalized coordinates; finite at a pole of the rational model.

    Raises:
        InvalidInputError: if point is not one vector, or there are neither 5 nor 8 coefficients.

    Source: the radial and tangential model of Brown (1971) as OpenCV's `projectPoints` states it.
    """
    ideal, lens = float_arrays(point=point, distortion=distortion)
    require_vectors(2, point=ideal)
    if lens.shape not in ((5,), (8,)):
        raise InvalidInputError(
            f"distortion has shape {lens.shape}; it must be k1, k2, p1, p2, k3, or these and k4, "
            "k5, k6. Append 0 for those that are missing."
        )
    x, y = ideal[0], ideal[1]
    k1, k2, p1, p2, k3 = (lens[i] for i in range(5))
    squared = x * x + y * y
    radial = 1 + squared * (k1 + squared * (k2 + squared * k3))
    if len(lens) == 8:
        k4, k5, k6 = (lens[i] for i in range(5, 8))
        divisor = 1 + squared * (k4 + squared * (k5 + squared * k6))
        near_pole = jnp.abs(divisor) < SMALLEST_DENOMINATOR
        radial = radial / jnp.where(near_pole, SMALLEST_DENOMINATOR, divisor)
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
            y * radial + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def undistort(point: Real[HostOrDevice, "2"], distortion: Lens) -> Float[Array, "2"]:
    """Invert `distort` by a fixed number of Newton steps (hence differentiable).

    Args:
        point: (2,) distorted normalized coordinates, without unit.
        distortion: (5,) or (8,) OpenCV coefficients as in `distort`.

    Returns:
        (2,) ideal normalized coordinates; finite but arbitrary where no ideal point maps there.

    Raises:
        InvalidInputError: if point is not one vector.

    Source: the model of Brown (1971) as in `distort`, inverted by Newton's method.
    """
    bent, lens = float_arrays(point=point, distortion=distortion)
    require_vectors(2, point=bent)
    return _undistort(bent, lens)


@jax.jit  # uncompiled, every call would trace its loop again
def _undistort(bent: Float[Array, "2"], lens: Lens) -> Float[Array, "2"]:
    return invert(lambda ideal: distort(ideal, lens), bent)


def pinhole_ray(
    K: Real[HostOrDevice, "3 3"], pixel: Real[HostOrDevice, "2"], distortion: Lens | None = None
) -> Float[Array, "3"]:
    """Find the direction in which a pinhole camera sees at a pixel.

    Args:
        K: (3, 3) intrinsics in pixels.
        pixel: (2,) in original image pixels.
        distortion: (5,) or (8,) OpenCV coefficients, or None for an ideal lens.

    Returns:
        (3,) unit vector in camera axes; finite but arbitrary beyond the fold of the lens.

    Raises:
        InvalidInputError: if pixel is not one vector, or K one matrix.
    """
    ideal = back_project(K, pixel, distortion)
    ray = jnp.append(ideal, jnp.ones((), ideal.dtype))
    return ray / jnp.sqrt(jnp.sum(ray * ray))


def pinhole_pixel(
    K: Real[HostOrDevice, "3 3"], point: Real[HostOrDevice, "3"], distortion: Lens | None = None
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Find the pixel at which a pinhole camera sees a point.

    Args:
        K: (3, 3) intrinsics in pixels.
        point: (3,) in camera axes, any unit.
        distortion: (5,) or (8,) OpenCV coefficients, or None for an ideal lens.

    Returns:
        pixel: (2,) in original image pixels, possibly outside the image; always finite.
        imaged: () whether the pixel is the point's image: it is in front of the camera, and inside
            the fold of the lens.

    Raises:
        InvalidInputError: if point is not one vector, or K one matrix.
    """
    intrinsics, xyz, lens = float_arrays("distortion", K=K, point=point, distortion=distortion)
    require_vectors(3, point=xyz)
    require_shape(intrinsics, (3, 3), "K")
    normalized, in_front = _normalize(xyz)
    if lens is None:
        return to_pixel(intrinsics, normalized), in_front
    radius = safe_norm(normalized)
    off_axis = radius > 0
    fractions = jnp.arange(1, FOLD_SAMPLES + 1, dtype=xyz.dtype) / FOLD_SAMPLES
    radii = jnp.tan(fractions * jnp.arctan(radius)) / jnp.where(off_axis, radius, 1)
    whole = inside_fold(lambda ideal: distort(ideal, lens), jnp.outer(radii, normalized))
    return to_pixel(intrinsics, distort(normalized, lens)), in_front & whole


def project(
    K: Real[HostOrDevice, "3 3"],
    R: Real[HostOrDevice, "3 3"],
    t: Real[HostOrDevice, "3"],
    point: Real[HostOrDevice, "3"],
    distortion: Lens | None = None,
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Project a world point to its pixel and its depth.

    Args:
        K: (3, 3) intrinsics in pixels.
        R: (3, 3) world-to-camera rotation.
        t: (3,) world-to-camera translation in scene units.
        point: (3,) world point in scene units.
        distortion: (5,) or (8,) OpenCV coefficients, or None for a pinhole.

    Returns:
        pixel: (2,) in original image pixels; finite, but meaningless where depth is not positive,
            and far outside the image within 0.6 degrees of the camera's plane.
        depth: () coordinate along the optical axis in scene units, negative behind the camera.

    Raises:
        InvalidInputError: if point or t is not one vector, or K or R one matrix.
    """
    intrinsics, rotation, translation, world, distortion = float_arrays(
        "distortion", K=K, R=R, t=t, point=point, distortion=distortion
    )
    require_vectors(3, t=translation, point=world)
    require_shape(intrinsics, (3, 3), "K")
    require_shape(rotation, (3, 3), "R")
    in_camera = rotation @ world + translation
    normalized, _ = _normalize(in_camera)
    if distortion is not None:
        normalized = distort(normalized, distortion)
    return to_pixel(intrinsics, normalized), in_camera[2]


def back_project(
    K: Real[HostOrDevice, "3 3"],
    pixel: Real[HostOrDevice, "2"],
    distortion: Lens | None = None,
) -> Float[Array, "2"]:
    """Convert a pixel to ideal normalized coordinates: invert intrinsics and distortion.

    Args:
        K: (3, 3) intrinsics `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]` in pixels.
        pixel: (2,) in original image pixels.
        distortion: (5,) or (8,) OpenCV coefficients, or None for a pinhole.

    Returns:
        (2,) x/z, y/z in the camera frame.

    Raises:
        InvalidInputError: if pixel is not one vector, or K one matrix.
    """
    intrinsics, at, lens = float_arrays("distortion", K=K, pixel=pixel, distortion=distortion)
    require_vectors(2, pixel=at)
    require_shape(intrinsics, (3, 3), "K")
    normalized = from_pixel(intrinsics, at)
    return normalized if lens is None else undistort(normalized, lens)


def to_pixel(K: Float[Array, "3 3"], normalized: Float[Array, "2"]) -> Float[Array, "2"]:
    """Apply intrinsics to a point of the distorted plane."""
    return K[:2, :2] @ normalized + K[:2, 2]


def from_pixel(K: Float[Array, "3 3"], pixel: Float[Array, "2"]) -> Float[Array, "2"]:
    """Invert `to_pixel`."""
    y = (pixel[1] - K[1, 2]) / K[1, 1]
    x = (pixel[0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    return jnp.stack([x, y])


def _normalize(point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Compute (2,) x/z, y/z of a point, and whether it is in front of the camera."""
    depth, least = point[2], FRONT_SHARE * safe_norm(point)
    in_front = depth > least
    # Elsewhere divide by the least depth: finite, and beside the camera outside of any image.
    return point[:2] / jnp.where(in_front, depth, jnp.where(least > 0, least, 1)), in_front
