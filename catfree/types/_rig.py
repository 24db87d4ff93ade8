"""Camera intrinsics and extrinsics: `Rig`, validated on construction.

`Rig` is separate from `Scene` because cameras are known before the ground: calibrations,
reconstructions and calibration files yield rigs; a scene is a rig with its ground plane.
"""

import os
from enum import IntEnum
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InvalidInputError, quoted
from catfree.types._annotations import HostOrDevice
from catfree.types._archive import load_record, naming_file, save_arrays
from catfree.types._sampling import select_rows
from catfree.types._validation import (
    as_float,
    as_integer,
    as_registered,
    entry_of,
    is_traced,
    refuse,
    require_finite,
    require_shape,
)

ROTATION_TOLERANCE = 1e-3  # calibration files often print rotations with few digits
UNIT_TOLERANCE = 1e-3  # of the length of a ray
FEWEST_NODES = 3  # along each side of a grid of rays


class Lens(IntEnum):
    """The camera model of one camera of a rig.

    Attributes:
        PINHOLE: `K` and OpenCV's distortion of five or eight coefficients.
        FISHEYE: `K` and the four coefficients of `cv2.fisheye` (Kannala-Brandt).
        RAYS: a grid of rays over the image; `K` only sets the image scale.
    """

    PINHOLE = 0
    FISHEYE = 1
    RAYS = 2


class Rig(eqx.Module):
    """C static cameras: intrinsics and world-to-camera extrinsics, `x_camera = R x_world + t`.

    Camera axes are OpenCV's (x right, y down, z forward).

    Attributes:
        K: (C, 3, 3) intrinsics in original pixels.
        R: (C, 3, 3) world-to-camera rotations.
        t: (C, 3) world-to-camera translations in scene units.
        image_size: (C, 2) int64 width and height in pixels.
        distortion: (C, 5) OpenCV k1, k2, p1, p2, k3, or (C, 8) with k4, k5, k6 of the rational
            model; of a fisheye, the first four are k1 to k4 of `cv2.fisheye`. None for ideal
            lenses.
        lens: (C,) `Lens` values, or None if all cameras are pinholes.
        rays: (C, rows, columns, 3) unit rays in camera axes of the cameras whose lens is `RAYS`
            (anything for the others), or None. The nodes are evenly spaced from the outer edge of
            the first row and column (-0.5) to that of the last ones.
        registered: (C,) bool; parameters of a camera that is not registered may be NaN, and its
            detections are ignored.
    """

    K: Float[HostOrDevice, "cam 3 3"]
    R: Float[HostOrDevice, "cam 3 3"]
    t: Float[HostOrDevice, "cam 3"]
    image_size: Int[np.ndarray, "cam 2"]
    distortion: Float[HostOrDevice, "cam 5"] | Float[HostOrDevice, "cam 8"] | None
    registered: Bool[np.ndarray, " cam"]
    lens: Int[np.ndarray, " cam"] | None
    rays: Float[HostOrDevice, "cam row column 3"] | None

    def __init__(
        self,
        K: Any,
        R: Any,
        t: Any,
        image_size: Any,
        distortion: Any = None,
        registered: Any = None,
        lens: Any = None,
        rays: Any = None,
    ) -> None:
        """Validate and store; a single `(width, height)` applies to all cameras.

        `lens` holds `Lens` values or the names "pinhole", "fisheye" and "rays".

        Raises:
            InvalidInputError: naming the first camera whose parameters have a wrong shape, are not
                finite, or are not valid intrinsics or rotations.
        """
        self.K, self.R, self.t = as_float(K, "K"), as_float(R, "R"), as_float(t, "t")
        require_shape(self.K, (None, 3, 3), "K")
        count = self.K.shape[0]
        require_shape(self.R, (count, 3, 3), "R")
        require_shape(self.t, (count, 3), "t")
        size = as_integer(image_size, "image_size")
        if size.shape == (2,):
            size = np.tile(size, (count, 1))
        require_shape(size, (count, 2), "image_size")
        self.image_size = size
        self.distortion = None if distortion is None else as_float(distortion, "distortion")
        if self.distortion is not None:
            wide = 8 if self.distortion.shape[-1:] == (8,) else 5
            require_shape(self.distortion, (count, wide), "distortion")
        self.registered = as_registered(registered, count)
        self.lens = _as_lens(lens, count)
        has_rays = self.lenses == Lens.RAYS
        self.rays = None
        if has_rays.any():
            self.rays = as_float(np.empty(0) if rays is None else rays, "rays")
            require_shape(self.rays, (count, None, None, 3), "rays")
        if not is_traced(self.K, self.R, self.t, self.distortion):
            self._check()

    def _check(self) -> None:
        for name in ("K", "R", "t", "distortion"):
            if getattr(self, name) is not None:
                require_finite(getattr(self, name), name, self.registered)
        if self.distortion is not None:
            rest = np.asarray(self.distortion)[:, 4:]
            bad = self.registered & (self.lenses == Lens.FISHEYE) & rest.any(-1)
            if bad.any():
                raise InvalidInputError(
                    f"{entry_of('distortion', bad)} of a fisheye has more than four coefficients "
                    "that are not zero."
                )
        if self.rays is not None:
            self._check_rays(np.asarray(self.rays))
        fault = "; it must be a positive number of pixels."
        refuse(self.image_size <= 0, self.image_size, "image_size", fault)
        require_cameras(self.K, self.R, self.registered)

    def _check_rays(self, rays: np.ndarray) -> None:
        if min(rays.shape[1:3]) < FEWEST_NODES:
            raise InvalidInputError(
                f"rays has {rays.shape[1]} rows and {rays.shape[2]} columns; a grid needs at least "
                f"{FEWEST_NODES} of each."
            )
        has_rays = self.registered & (self.lenses == Lens.RAYS)
        with np.errstate(invalid="ignore", over="ignore"):
            unit = np.abs(np.linalg.norm(rays, axis=-1) - 1) < UNIT_TOLERANCE
        bad = has_rays & ~unit.all((1, 2))
        if bad.any():
            raise InvalidInputError(
                f"{entry_of('rays', bad)} holds a ray that is not a unit vector. Every node of "
                "the image needs a direction in camera axes."
            )

    @property
    def lenses(self) -> Int[np.ndarray, " cam"]:
        """(C,) the `Lens` of every camera."""
        return np.zeros(self.camera_count, np.int64) if self.lens is None else self.lens

    @property
    def is_ideal(self) -> bool:
        """True if all cameras are pinholes without distortion."""
        bent = self.distortion is not None and bool(np.any(np.asarray(self.distortion)))
        return self.lens is None and not bent

    @property
    def camera_count(self) -> int:
        """Number of cameras, registered or not."""
        return self.K.shape[0]

    @property
    def centers(self) -> Float[HostOrDevice, "cam 3"]:
        """(C, 3) camera centers in world coordinates, where `R x + t = 0`."""
        namespace = np if isinstance(self.R, np.ndarray) else jnp
        center = namespace.zeros_like(self.t)
        # `-Rᵀ t`, then two steps: on a map, the rounding of a rotation would move it by meters.
        for _ in range(3):
            at_camera = namespace.einsum("cij,cj->ci", self.R, center) + self.t
            center = center - namespace.einsum("cji,cj->ci", self.R, at_camera)
        return center

    def select(self, cameras: Any) -> "Rig":
        """Select cameras by boolean mask or indices, in that order."""
        return select_rows(self, self.camera_count, cameras)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle).

        Raises:
            InvalidInputError: if the folder does not exist.
            WriteError: if the disk is full or not writable.
        """
        save_arrays(path, "Rig", vars(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Rig":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file, or a camera in it is invalid.
            FileFormatError: if the file holds something else.
        """
        arrays = load_record(path, cls)
        with naming_file(path):
            return cls(**arrays)


def require_cameras(K: Any, R: Any, registered: Bool[np.ndarray, " cam"]) -> None:
    """Raise if a registered camera has invalid intrinsics or an invalid rotation.

    Args:
        K: (C, 3, 3) intrinsics.
        R: (C, 3, 3) rotations.
        registered: (C,) which cameras to check.

    Raises:
        InvalidInputError: naming the first such camera.
    """
    K, R = np.asarray(K, np.float64), np.asarray(R, np.float64)
    focal_bad = registered & ~((K[:, 0, 0] > 0) & (K[:, 1, 1] > 0))
    form_bad = registered & ~(
        (np.abs(K[:, 2, 2] - 1) < 1e-6)
        & (np.abs(K[:, [1, 2, 2], [0, 0, 1]]) < 1e-6 * np.abs(K[:, :1, 0])).all(-1)
    )
    if focal_bad.any():
        raise InvalidInputError(
            f"{entry_of('K', focal_bad)} has a focal length that is not positive."
        )
    if form_bad.any():
        raise InvalidInputError(
            f"{entry_of('K', form_bad)} is not of the form [[fx, s, cx], [0, fy, cy], "
            "[0, 0, 1]]. Divide by K[2, 2], and check that it is not transposed."
        )
    require_rotations(R, "R", registered)


def require_rotations(R: Any, name: str, where: Any = True) -> None:
    """Raise unless these matrices (..., D, D) are proper rotations where `where` (...) is true.

    Raises:
        InvalidInputError: naming the first that is not.
    """
    R = np.asarray(R, np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(R @ R.swapaxes(-1, -2) - np.eye(R.shape[-1])).max((-1, -2), initial=0)
        turn = np.linalg.det(R)
    bad = np.asarray(where & ~((error < ROTATION_TOLERANCE) & (turn > 0)))
    if bad.any():
        at = tuple(np.argwhere(bad)[0])
        raise InvalidInputError(
            f"{entry_of(name, bad)} is not a rotation (|R Rᵀ - I| = {error[at]:.3g}, det = "
            f"{turn[at]:.3g}). A determinant of -1 means a mirrored frame: flip one world axis."
        )


def _as_lens(lens: Any, count: int) -> np.ndarray | None:
    """(C,) values of `Lens`, or None if all cameras are pinholes."""
    if lens is None:
        return None
    lenses = {one.name.lower(): int(one) for one in Lens}
    named = np.asarray(lens)
    if named.dtype.kind == "U":
        unknown = [str(name) for name in named.ravel() if name not in lenses]
        if unknown:
            raise InvalidInputError(
                f"lens has {quoted(unknown[0])}; it must be one of {', '.join(lenses)}."
            )
        named = np.array([lenses[str(name)] for name in named.ravel()], int).reshape(named.shape)
    values = as_integer(named, "lens")
    require_shape(values, (count,), "lens")
    if not np.isin(values, list(Lens)).all():
        raise InvalidInputError(f"lens has {values.tolist()}; it must hold `Lens` values.")
    return values if values.any() else None


def require_pinholes(rig: Rig) -> None:
    """Raise if a registered camera is not a pinhole, as refinement needs.

    Raises:
        InvalidInputError: naming the camera and its lens.
    """
    not_pinhole = rig.registered & (rig.lenses != Lens.PINHOLE)
    if not_pinhole.any():
        at = int(np.argmax(not_pinhole))
        kind = {Lens.FISHEYE: "a fisheye lens", Lens.RAYS: "a grid of rays"}[Lens(rig.lenses[at])]
        raise InvalidInputError(
            f"Camera {at} has {kind}, and refinement needs pinholes. Undistort its images and "
            "boxes to a pinhole first."
        )
