"""The `camInfo` files of NVIDIA's DeepStream trackers: one 3 x 4 projection matrix per camera."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.linalg import rq

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    usual_size,
    write_cameras,
)
from catfree.adapters.calibration_files._opencv_storage import Storage, read_cameras
from catfree.adapters.files._documents import StrPath, numbers
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Rig
from catfree.types._validation import as_positive

PROJECTION = "projectionMatrix_3x4_w2p"  # world to pixel


def read_mv3dt(
    paths: StrPath | Sequence[StrPath], image_size: tuple[int, int] | None = None
) -> NamedRig:
    """Read `camInfo` files: the cameras of DeepStream's single-view and multi-view 3D trackers.

    Args:
        paths: one YAML file per camera, with `projectionMatrix_3x4_w2p`, 12 numbers row by row.
        image_size: width and height in pixels, which the files do not state; 1920 x 1080 if None.

    Returns:
        The rig in the files' unit of length, each camera named after its file.

    Raises:
        InvalidInputError: if a file is missing or given twice, or a camera is invalid.
        FileFormatError: if a file is malformed or has no such matrix.
    """
    size = usual_size(image_size)

    def camera_of(storage: Storage) -> FileCamera:
        if PROJECTION not in storage.numbers:
            raise FileFormatError(f"the file has no {PROJECTION!r} from the world to pixels.")
        matrix = numbers(storage.numbers[PROJECTION], (3, 4), PROJECTION)
        return FileCamera(*decomposed(matrix), size)

    return read_cameras(paths, "camInfo", camera_of)


def write_mv3dt(
    folder: StrPath,
    rig: Rig,
    names: Sequence[str] | None = None,
    *,
    person_height: float = 1.7,
    person_radius: float = 0.3,
) -> tuple[Path, ...]:
    """Write one `camInfo` file per registered camera, `<name>.yml`.

    Args:
        folder: created if it does not exist.
        rig: the cameras, without lens distortion, in meters with z up and the ground at z = 0.
        names: (C,) names; C1, C2, ... if None.
        person_height: height of the cylinder that represents a person, in meters.
        person_radius: radius of this cylinder, in meters.

    Returns:
        The files, in the order of the cameras.

    Raises:
        InvalidInputError: if no camera is registered, one has lens distortion, or the names do not
            match the cameras.
        WriteError: if the disk is full or not writable.
    """
    height = as_positive(person_height, "person_height")
    radius = as_positive(person_radius, "person_radius")
    # One object class, with the number that detectors give people.
    model = f"modelInfo:\n  - classID: 0\n    height: {height!r}\n    radius: {radius!r}\n"

    def text_of(camera: FileCamera) -> str:
        rows = "".join(f"- {float(v)!r}\n" for v in camera.projection.ravel())
        return f"{PROJECTION}:\n{rows}\n{model}"

    return write_cameras(folder, rig, names, text_of, ideal=True)


def decomposed(
    projection: Float[np.ndarray, "3 4"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Split a projection matrix of any scale into K, R and t.

    Raises:
        InvalidInputError: if it is not the projection of a camera at a finite position.
    """
    KR = projection[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        scale = np.cbrt(np.linalg.det(KR))
    if not (np.isfinite(scale) and abs(scale) > 1e-9 * np.abs(KR).max(initial=0) > 0):
        raise InvalidInputError("The projection matrix is not that of a camera at a finite place.")
    K, R = rq(KR / scale)
    sign = np.diag(np.sign(np.diag(K)))  # a positive focal length; the determinant of R is 1
    K, R = K @ sign, sign @ R
    t = np.linalg.solve(K, projection[:, 3] / scale)
    return K / K[2, 2], R, t
