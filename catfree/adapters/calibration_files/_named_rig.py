"""The content of a calibration file: cameras, or a rig with their names and optional points."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num
from scipy.spatial.transform import Rotation

from catfree.adapters.files._camera_names import file_names, numbered_names
from catfree.adapters.files._documents import StrPath, numbers, write_text_atomically
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.types import Lens, Plane, Rig, Scene
from catfree.types._validation import (
    as_integer,
    refuse,
    require_instance,
    require_names,
    require_shape,
    shown_camera,
)
from catfree.types._writing import make_folder

_IDEAL = np.zeros(8)
_UNDISTORT = "Undistort its images, and write the rig without distortion"


class FileCamera(NamedTuple):
    """One camera of a calibration file, as the fields of `Rig`.

    Attributes:
        K: (3, 3).
        R: (3, 3).
        t: (3,).
        image_size: (2,) width and height in pixels.
        distortion: (8,) coefficients, zero where the file has fewer.
        lens: the lens model.
        registered: whether its pose is known.
        rays: (rows, columns, 3) if the camera is a grid of rays, else None.
    """

    K: Float[np.ndarray, "3 3"]
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, "3"]
    image_size: Num[np.ndarray, "2"] | tuple[int, int]
    distortion: Float[np.ndarray, "8"] = _IDEAL
    lens: Lens = Lens.PINHOLE
    registered: bool = True
    rays: Float[np.ndarray, "row column 3"] | None = None

    @property
    def coefficients(self) -> Float[np.ndarray, "k"]:
        """Coefficients that a file states: (4,) of a fisheye, else (5,) or (8,)."""
        if self.lens == Lens.FISHEYE:
            return self.distortion[:4]
        return self.distortion if self.distortion[5:].any() else self.distortion[:5]

    @property
    def projection(self) -> Float[np.ndarray, "3 4"]:
        """(3, 4) matrix K [R | t] from world points to pixels."""
        return self.K @ np.column_stack([self.R, self.t])


def rotation_from_vector(value: Any, where: str) -> np.ndarray:
    """Convert a rotation vector in radians (OpenCV's Rodrigues) to a (3, 3) rotation.

    Args:
        value: the file's entry, three numbers.
        where: its place in the file, for messages.

    Raises:
        FileFormatError: if it is not three numbers.
        InvalidInputError: if it exceeds a full turn, as angles in degrees do.
    """
    vector = numbers(value, (3,), where)
    if math.hypot(*vector) > 2 * math.pi:  # without overflow
        raise InvalidInputError(
            f"{where} is {vector.tolist()}, more than a full turn. A rotation vector is in "
            "radians; convert it from degrees."
        )
    return Rotation.from_rotvec(vector).as_matrix()


def lens_coefficients(value: Any, where: str, lens: Lens = Lens.PINHOLE) -> Float[np.ndarray, "8"]:
    """Convert a list of coefficients, which may be shorter than the model's or padded with zeros.

    Args:
        value: the file's entry, coefficients in OpenCV's order; none means an ideal lens.
        where: the camera, for messages.
        lens: `FISHEYE` for k1 to k4 of `cv2.fisheye`.

    Returns:
        (8,) float64, zero where the list ends.

    Raises:
        FileFormatError: if it holds something else, or nonzero coefficients beyond the model's.
        InvalidInputError: if a coefficient is not finite.
    """
    values = numbers(value, None, f"the distortion of {where}")
    most = 4 if lens == Lens.FISHEYE else 8
    if values[most:].any():
        supported = "k1 to k4 of a fisheye" if most == 4 else "k1, k2, p1, p2, k3, k4, k5, k6"
        raise FileFormatError(
            f"the distortion of {where} has {len(values)} coefficients, but only {supported} are "
            "supported (no thin-prism or tilted model). Undistort the images or calibrate again "
            "with fewer coefficients."
        )
    coefficients = np.zeros(8)
    coefficients[: min(most, len(values))] = values[:most]
    return coefficients


def rig_of(cameras: Sequence[FileCamera]) -> Rig:
    """Join the cameras of a file into a rig."""
    K, R, t, size, distortion, lens, registered, rays = zip(*cameras, strict=True)
    K, R, t, size, distortion = (np.stack(part) for part in (K, R, t, size, distortion))
    coefficients = None
    if distortion.any():
        coefficients = distortion if distortion[:, 5:].any() else distortion[:, :5]
    grids = [grid for grid in rays if grid is not None]
    if len({grid.shape for grid in grids}) > 1:
        raise FileFormatError("the cameras' rays have different numbers of nodes.")
    grids = [np.zeros_like(grids[0]) if grid is None else grid for grid in rays] if grids else None
    return Rig(K, R, t, size, coefficients, registered, lens, grids)


def usual_size(image_size: Any) -> Int[np.ndarray, "2"]:
    """Return the given image size, or 1920 x 1080 for None, for files that do not state one.

    Raises:
        InvalidInputError: if these are not two whole numbers above 0.
    """
    size = as_integer((1920, 1080) if image_size is None else image_size, "image_size")
    require_shape(size, (2,), "image_size")
    refuse(size < 1, size, "image_size", "; it must be a width or a height in pixels.")
    return size


def require_stated_sizes(rig: Rig, names: Sequence[str] | None, image_size: Any) -> None:
    """Raise if the file states a different image size for a camera than the caller gave.

    Args:
        rig: the cameras as read, with the given size where the file states none.
        names: (C,) camera names, or None.
        image_size: width and height, or None.

    Raises:
        InvalidInputError: naming the first such camera, or if the given size is not two whole
            numbers above 0.
    """
    given = rig.image_size if image_size is None else usual_size(image_size)
    differs = (rig.image_size != given).any(axis=1)
    if differs.any():
        at = int(np.argmax(differs))
        width, height = rig.image_size[at].tolist()
        raise InvalidInputError(
            f"image_size is {' x '.join(map(str, given))}, but the calibration of camera "
            f"{shown_camera(at, names)} is for images of {width} x {height} px. Leave it out; "
            "boxes of images of another size must be scaled."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class NamedRig:
    """Cameras of one calibration file, in the file's order.

    Attributes:
        rig: the cameras, world-to-camera, in the file's units of length.
        names: (C,) their names.
        points: (P, 3) reconstructed points in the same frame, or None.
    """

    rig: Rig
    names: tuple[str, ...]
    points: Float[np.ndarray, "p 3"] | None = None

    def __post_init__(self) -> None:
        """Raise InvalidInputError if the names do not match the cameras; see `default_names`."""
        default_names(self.rig, self.names)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """(C,) the names, as of other sources of a scene."""
        return self.names

    @property
    def scene(self) -> Scene:
        """The cameras over the ground z = 0, in units of unknown length; `read_scene` takes others.

        Raises:
            InvalidInputError: if z = 0 cannot be the ground, or fewer than 2 cameras are
                registered.
        """
        return Scene.from_rig(self.rig, ground_at_zero(self.rig, "The calibration"))


def ground_at_zero(rig: Rig, source: Path | str) -> Plane:
    """Return the ground z = 0 with the cameras on its positive side.

    Raises:
        InvalidInputError: naming the source, unless most cameras are above it and look at it with
            the bottom of their images.
    """
    cameras = np.flatnonzero(rig.registered)
    K, R, center = (np.asarray(part, np.float64) for part in (rig.K, rig.R, rig.centers))
    # Boards that lie on the floor often have their z axis pointing into it.
    up = -1.0 if len(cameras) and np.median(center[cameras, 2]) < 0 else 1.0
    ground = Plane(np.array([0.0, 0.0, up]), 0.0)
    size = np.asarray(rig.image_size, np.float64)
    bottom = np.stack([size[:, 0] / 2, size[:, 1], np.ones(len(size))], axis=-1)
    with np.errstate(all="ignore"):  # a camera whose numbers overflow sees nothing
        sees = [
            ground.signed_distance(center[c]) > 0
            and (R[c].T @ np.linalg.solve(K[c], bottom[c])) @ np.asarray(ground.normal) < 0
            for c in cameras
        ]
    if 2 * sum(sees) <= len(cameras):
        raise InvalidInputError(
            f"{source} does not state the ground, and it is not z = 0: only {sum(sees)} of "
            f"{len(cameras)} cameras are above it and look down on it. Pass ground= to "
            "cf.read_scene, the plane in the frame of the file, or make the scene with "
            "cf.Scene.from_rig; cf.calibration.find_ground finds the plane in points of a "
            "reconstruction."
        )
    return ground


def default_names(rig: Rig, names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the given names, or C1, C2, ... if None.

    Raises:
        InvalidInputError: if they are not a list, there are not as many names as cameras, two are
            equal, or one is not text.
    """
    require_instance(rig, Rig, "rig")
    require_names(names, rig.camera_count, "names", distinct=True)
    return numbered_names(rig.camera_count) if names is None else tuple(names)


def writable_cameras(
    rig: Rig, names: Sequence[str] | None, target: StrPath, *, ideal: bool = False
) -> list[tuple[str, FileCamera]]:
    """List the registered cameras in float64 by name, for formats that cannot hold others.

    Args:
        rig: the cameras.
        names: (C,) names; C1, C2, ... if None.
        target: description of the output, for messages.
        ideal: whether the format has no lens coefficients.

    Raises:
        InvalidInputError: if no camera is registered, the names do not match the cameras, or a
            registered one has a lens that the format cannot hold.
    """
    labels = default_names(rig, names)
    if not rig.registered.any():
        raise InvalidInputError(f"Cannot write {target}: no camera of the rig is registered.")
    K, R, t = (np.asarray(part, np.float64) for part in (rig.K, rig.R, rig.t))
    distortion = np.zeros((rig.camera_count, 8))
    if rig.distortion is not None:
        distortion[:, : rig.distortion.shape[1]] = rig.distortion
    cameras = []
    for at in np.flatnonzero(rig.registered).tolist():
        lens = Lens(rig.lenses[at])
        for refused, reason, advice in (
            (lens == Lens.RAYS, "is a grid of rays", "write_scene_json and Rig.save can"),
            (ideal and lens == Lens.FISHEYE, "has a fisheye lens", _UNDISTORT),
            (ideal and distortion[at].any(), "has lens distortion", _UNDISTORT),
        ):
            if refused:
                raise InvalidInputError(
                    f"Cannot write {target}: camera {quoted(labels[at])} {reason}, which this "
                    f"format cannot hold. {advice}."
                )
        camera = FileCamera(K[at], R[at], t[at], rig.image_size[at], distortion[at], lens)
        cameras.append((labels[at], camera))
    return cameras


def write_cameras(
    folder: StrPath,
    rig: Rig,
    names: Sequence[str] | None,
    text_of: Callable[[FileCamera], str],
    *,
    ideal: bool = False,
) -> tuple[Path, ...]:
    """Write the text of each registered camera to `<name>.yml`; see `writable_cameras`."""
    labels, cameras = zip(*writable_cameras(rig, names, folder, ideal=ideal), strict=True)
    root = make_folder(folder)
    return tuple(
        write_text_atomically(root / f"{label}.yml", text_of(camera))
        for label, camera in zip(file_names(labels), cameras, strict=True)
    )
