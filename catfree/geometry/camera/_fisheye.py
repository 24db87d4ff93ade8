"""OpenCV's fisheye lens (Kannala and Brandt): the image radius is a polynomial of the angle."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from catfree.geometry._arrays import float_arrays, require_vectors, safe_norm
from catfree.geometry.camera._inversion import inside_fold, invert
from catfree.geometry.camera._pinhole import FOLD_SAMPLES, from_pixel, to_pixel
from catfree.types._annotations import HostOrDevice


def fisheye_ray(
    K: Real[HostOrDevice, "3 3"], pixel: Real[HostOrDevice, "2"], k: Real[HostOrDevice, "4"]
) -> Float[Array, "3"]:
    """Find the direction in which a fisheye camera sees at a pixel.

    Args:
        K: (3, 3) intrinsics in pixels.
        pixel: (2,) in original image pixels.
        k: (4,) k1 to k4 of `cv2.fisheye`.

    Returns:
        (3,) unit vector in camera axes, up to 180 degrees from the optical axis; finite but
        arbitrary for pixels beyond the fold of the polynomial.

    Raises:
        InvalidInputError: if pixel is not one vector.

    Source: Kannala and Brandt (2006), as the documentation of `cv2.fisheye` states it.
    """
    intrinsics, at, lens = float_arrays(K=K, pixel=pixel, k=k)
    require_vectors(2, pixel=at)
    turned = invert(lambda angle: _bend(angle, lens), from_pixel(intrinsics, at))
    angle = safe_norm(turned)
    # sin(angle) / angle, whose derivative at 0 is 0.
    away = angle > 0
    share = jnp.where(away, jnp.sin(angle) / jnp.where(away, angle, 1), 1)
    return jnp.append(share * turned, jnp.cos(angle))


def fisheye_pixel(
    K: Real[HostOrDevice, "3 3"], point: Real[HostOrDevice, "3"], k: Real[HostOrDevice, "4"]
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Find the pixel at which a fisheye camera sees a point.

    Args:
        K: (3, 3) intrinsics in pixels.
        point: (3,) in camera axes, any unit.
        k: (4,) k1 to k4 of `cv2.fisheye`.

    Returns:
        pixel: (2,) in original image pixels; always finite.
        imaged: () whether the pixel is the point's image: it is inside the fold of the
            polynomial, and neither at the camera nor exactly behind it.

    Raises:
        InvalidInputError: if point is not one vector.

    Source: Kannala and Brandt (2006), as the documentation of `cv2.fisheye` states it.
    """
    intrinsics, xyz, lens = float_arrays(K=K, point=point, k=k)
    require_vectors(3, point=xyz)
    largest = jnp.max(jnp.abs(xyz))
    somewhere = largest > 0
    xyz = xyz / jnp.where(somewhere, largest, 1)
    radius = safe_norm(xyz[:2])
    aside = radius > 0
    ahead = xyz[2] > 0
    angle = jnp.arctan2(radius, jnp.where(aside | ahead, xyz[2], 1))
    share = jnp.where(aside, angle / jnp.where(aside, radius, 1), 1 / jnp.where(ahead, xyz[2], 1))
    turned = share * xyz[:2]
    fractions = jnp.arange(1, FOLD_SAMPLES + 1, dtype=turned.dtype) / FOLD_SAMPLES
    whole = inside_fold(lambda angle: _bend(angle, lens), jnp.outer(fractions, turned))
    return to_pixel(intrinsics, _bend(turned, lens)), somewhere & (aside | ahead) & whole


def _bend(turned: Float[Array, "2"], k: Float[Array, "4"]) -> Float[Array, "2"]:
    """Bend the plane in which the radius is the angle from the axis."""
    squared = jnp.sum(turned * turned)
    return turned * (1 + squared * (k[0] + squared * (k[1] + squared * (k[2] + squared * k[3]))))
