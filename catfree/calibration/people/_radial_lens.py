"""Removal of radial lens distortion from boxes."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import edges_of
from catfree.geometry.camera import rays_of_pixels, undistort
from catfree.types import Rig

BLOCK = 2048  # pixels undistorted together


@dataclass(frozen=True)
class RadialLenses:
    """One coefficient of radial distortion per camera, OpenCV's k1.

    Attributes:
        focal: (C,) focal lengths in pixels.
        k1: (C,) coefficients, 0 for an ideal lens.
    """

    focal: Float[np.ndarray, " cam"]
    k1: Float[np.ndarray, " cam"]

    @classmethod
    def of(cls, rig: Rig) -> "RadialLenses":
        """Lenses of a rig; unregistered cameras get the median lens of the others."""
        known = rig.registered
        k1 = radial_distortion(rig)
        size = rig.image_size.max(1)
        share = np.asarray(rig.K, np.float64)[:, 0, 0] / size
        share, k1 = (np.where(known, a, np.median(a[known])) for a in (share, k1))
        return cls(share * size, k1)

    def of_focal(self, focal: Float[np.ndarray, " cam"]) -> "RadialLenses":
        """Lenses with other focal lengths and the same distortion of pixels."""
        return RadialLenses(focal, self.k1 * (focal / self.focal) ** 2)

    def straightened(
        self, camera: Int[np.ndarray, " n"], edges: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Undistort boxes.

        Args:
            camera: (n,) camera of each box.
            edges: (n, 3) center column, top and bottom row in pixels from the image center.

        Returns:
            (n, 3) the undistorted edges; the input edges if no lens has distortion.
        """
        if not self.k1.any():
            return edges
        focal = self.focal[camera]
        rows = [np.stack([edges[:, 0], edges[:, i]], -1) / focal[:, None] for i in (1, 2)]
        with jax.enable_x64(True):
            head, foot = (in_blocks(_undistorted, (row, self.k1[camera]), BLOCK) for row in rows)
        return edges_of(head, foot) * focal[:, None]


def radial_distortion(rig: Rig) -> Float[np.ndarray, " cam"]:
    """(C,) k1 of the cameras of a rig, 0 without distortion."""
    if rig.distortion is None:
        return np.zeros(rig.camera_count)
    return np.nan_to_num(np.asarray(rig.distortion, np.float64)[:, 0])


def ideal_pixels(
    rig: Rig, camera: Int[np.ndarray, " n"], pixel: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Convert pixels to ideal cameras with square pixels, relative to the principal point.

    Args:
        rig: the cameras, which must be pinholes.
        camera: (n,) camera of each pixel.
        pixel: (n, 2) as observed.

    Returns:
        (n, 2) in units of horizontal pixels; NaN for cameras that are NaN.
    """
    K, R = (np.asarray(part, np.float64)[camera] for part in (rig.K, rig.R))
    ray = np.einsum("nij,nj->ni", R, rays_of_pixels(rig, camera, pixel))
    return K[:, :1, 0] * ray[:, :2] / ray[:, 2:]


def lens(k1: Float[Array, ""]) -> Float[Array, "5"]:
    """Return OpenCV's five coefficients of a lens with radial distortion k1 alone."""
    return jnp.zeros(5, k1.dtype).at[0].set(k1)


@jax.jit
@jax.vmap
def _undistorted(point: Float[Array, "2"], k1: Float[Array, ""]) -> Float[Array, "2"]:
    return undistort(point, lens(k1))
