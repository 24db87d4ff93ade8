"""The `calibration.toml` that aniposelib, Pose2Sim, FreeMoCap and Caliscope exchange."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    lens_coefficients,
    rig_of,
    rotation_from_vector,
    writable_cameras,
)
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    naming_file,
    numbers_of,
    text_of,
    write_text_atomically,
)
from catfree.adapters.files._toml import read_toml
from catfree.errors import FileFormatError, quoted, shortened
from catfree.types import Lens, Rig
from catfree.types._validation import as_positive

_LARGEST_FILE = 2**20  # characters; a camera takes about 500, and the parser two seconds at most
_MOST_DOTS = 64  # a camera has nine decimal points per line


def read_anipose_toml(path: StrPath, *, metres_per_unit: float = 1.0) -> NamedRig:
    """Read a `calibration.toml`: one table per camera, in the file's order.

    Each table has `name`, `size` (width, height), `matrix`, `distortions`, `rotation` (vector in
    radians, world to camera) and `translation`; with `fisheye = true`, the distortions are k1 to k4
    of `cv2.fisheye`. Tables with none of these entries, such as `metadata`, are skipped.

    Args:
        path: the file.
        metres_per_unit: 1.0 for Pose2Sim, which writes meters; 0.001 for FreeMoCap, and for
            aniposelib with a board in millimeters.

    Returns:
        Rig in meters if `metres_per_unit` is right, and the names.

    Raises:
        InvalidInputError: if there is no such file, a camera is invalid, two have the same name, or
            `metres_per_unit` is not a positive number.
        FileFormatError: if it is not TOML of this form.
    """
    scale = as_positive(metres_per_unit, "metres_per_unit")
    document = read_toml(path, "calibration", largest=_LARGEST_FILE, dots=_MOST_DOTS)
    names, cameras = [], []
    with naming_file(path):
        for key, camera in document.items():
            keys = camera if isinstance(camera, dict) else ()
            if {"matrix", "rotation", "translation"}.isdisjoint(keys):
                continue
            where = f"camera [{shortened(key)}]"
            fisheye = camera.get("fisheye", False)
            if not isinstance(fisheye, bool):
                raise FileFormatError(
                    f"fisheye of {where} is {quoted(fisheye)}; it must be true or false."
                )
            lens = Lens.FISHEYE if fisheye else Lens.PINHOLE
            K = numbers_of(camera, "matrix", (3, 3), where)
            size = numbers_of(camera, "size", (2,), where)
            R = rotation_from_vector(entry(camera, "rotation", where), f"rotation of {where}")
            t = numbers_of(camera, "translation", (3,), where) * scale
            distortion = lens_coefficients(camera.get("distortions", []), where, lens)
            cameras.append(FileCamera(K, R, t, size, distortion, lens))
            names.append(text_of(camera.get("name", key), f"the name of {where}"))
        if not names:
            raise FileFormatError("the file holds no camera (a table with a 'matrix').")
        return NamedRig(rig_of(cameras), tuple(names))


def write_anipose_toml(
    path: StrPath,
    rig: Rig,
    names: Sequence[str] | None = None,
    *,
    metres_per_unit: float = 1.0,
) -> Path:
    """Write a `calibration.toml`, leaving out unregistered cameras.

    Args:
        path: the file.
        rig: the cameras, in meters.
        names: (C,) names; C1, C2, ... if None.
        metres_per_unit: the file's unit of length: 1.0 for Pose2Sim, 0.001 for FreeMoCap.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist, no camera is registered, a camera is a grid
            of rays, the names do not match the cameras, or `metres_per_unit` is not a positive
            number.
    """
    scale = as_positive(metres_per_unit, "metres_per_unit")
    lines = []
    for at, (name, camera) in enumerate(writable_cameras(rig, names, path)):
        # TOML writes strings and lists of numbers as JSON does, except for the character DEL.
        label = json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007F")
        lines += [
            f"[cam_{at}]",
            f"name = {label}",
            f"size = {np.asarray(camera.image_size).tolist()}",
            f"matrix = {camera.K.tolist()}",
            f"distortions = {camera.coefficients.tolist()}",
            f"rotation = {Rotation.from_matrix(camera.R).as_rotvec().tolist()}",
            f"translation = {(camera.t / scale).tolist()}",
            f"fisheye = {str(camera.lens == Lens.FISHEYE).lower()}",
            "",
        ]
    return write_text_atomically(path, "\n".join([*lines, "[metadata]", ""]))
