"""Lens coefficients of calibration files, and what a file's format can hold of a rig's lenses."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import StrPath
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.types import Lens, Rig


def lens_coefficients(
    values: np.ndarray, source: StrPath, where: str, lens: Lens = Lens.PINHOLE
) -> Float[np.ndarray, "8"]:
    """Check a list of coefficients that may be shorter than its model has, or end in zeros.

    Args:
        values: (n,) coefficients in OpenCV's order; an empty list means an ideal lens.
        source: the file, for messages.
        where: the camera, for messages.
        lens: `FISHEYE` for k1 to k4 of `cv2.fisheye`.

    Returns:
        (8,) float64, zero where the list ends.

    Raises:
        FileFormatError: if a coefficient is not finite, or the model has fewer that are not zero.
    """
    if not np.isfinite(values).all():
        raise FileFormatError(f"{source}: the distortion of {where} is not finite.")
    most = 4 if lens == Lens.FISHEYE else 8
    if values[most:].any():
        supported = "k1 to k4 of a fisheye" if most == 4 else "k1, k2, p1, p2, k3, k4, k5, k6"
        raise FileFormatError(
            f"{source}: the distortion of {where} has {len(values)} coefficients, but only "
            f"{supported} are supported (no thin-prism or tilted model). Undistort the images or "
            "calibrate again with fewer coefficients."
        )
    coefficients = np.zeros(8)
    coefficients[: min(most, len(values))] = values[:most]
    return coefficients


def distortion_of(coefficients: Sequence[np.ndarray]) -> Float[np.ndarray, "cam k"] | None:
    """Stack the (8,) coefficients of cameras to the `distortion` of a rig.

    Returns:
        (C, 8), (C, 5) if no camera needs more, or None if all are zero.
    """
    stacked = np.stack(coefficients)
    if not stacked.any():
        return None
    return stacked if stacked[:, 5:].any() else stacked[:, :5]


def coefficients_of(rig: Rig, camera: int) -> Float[np.ndarray, "k"]:
    """Coefficients of a camera's lens for a file: (4,) of a fisheye, else (5,) or (8,)."""
    lens = np.zeros(5) if rig.distortion is None else np.asarray(rig.distortion)[camera]
    if rig.lenses[camera] == Lens.FISHEYE:
        return lens[:4]
    return lens if lens[5:].any() else lens[:5]


def require_coefficients(rig: Rig, names: Sequence[str], target: StrPath) -> None:
    """Raise if a camera is a grid of rays, for formats that hold coefficients only.

    Raises:
        InvalidInputError: naming the first such camera.
    """
    _refuse(
        rig.lenses == Lens.RAYS,
        "is a grid of rays",
        "write_scene_json and Rig.save can",
        names,
        target,
    )


def require_undistorted(rig: Rig, names: Sequence[str], target: StrPath) -> None:
    """Raise if a camera is not an ideal pinhole, for formats that cannot hold others.

    Raises:
        InvalidInputError: naming the first such camera.
    """
    require_coefficients(rig, names, target)
    advice = "Undistort its images, and write the rig without distortion"
    _refuse(rig.lenses == Lens.FISHEYE, "has a fisheye lens", advice, names, target)
    if rig.distortion is not None:
        bent = (np.asarray(rig.distortion) != 0).any(-1)
        _refuse(bent, "has lens distortion", advice, names, target)


def _refuse(
    refused: np.ndarray, reason: str, advice: str, names: Sequence[str], target: StrPath
) -> None:
    if refused.any():
        raise InvalidInputError(
            f"Cannot write {target}: camera {quoted(names[int(np.argmax(refused))])} {reason}, "
            f"which this format cannot hold. {advice}."
        )
