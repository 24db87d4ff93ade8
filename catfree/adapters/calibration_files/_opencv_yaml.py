"""Calibrations as OpenCV writes them: one YAML, XML or JSON file per camera."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    lens_coefficients,
    require_stated_sizes,
    rotation_from_vector,
    usual_size,
    write_cameras,
)
from catfree.adapters.calibration_files._opencv_storage import Storage, read_cameras
from catfree.adapters.files._documents import StrPath, numbers
from catfree.errors import FileFormatError
from catfree.types import Lens, Rig
from catfree.types._validation import as_positive

# The names that OpenCV's own samples and common tools use for the same matrix.
_INTRINSICS = ("K", "camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic", "M")
_DISTORTION = (
    "dist_coeffs",
    "distortion_coefficients",
    "distCoeffs",
    "Distortion_Coefficients",
    "distortion",
    "dist",
    "D",
)
_ROTATION = ("R", "Rot", "rotation_matrix", "rotation", "rvec", "rotation_vector")
_TRANSLATION = ("t", "T", "tvec", "translation_vector", "translation")
_WIDTH = ("image_width", "image_Width", "width")
_HEIGHT = ("image_height", "image_Height", "height")
_SIZE = ("image_size", "imageSize", "size")

# Words of files and tools for the lens models of `cv2.fisheye` and of a pinhole.
_FISHEYE = re.compile("fish_?eye|equidistant|kannala", re.IGNORECASE)
_PINHOLE = re.compile("pinhole|plumb|rational|rad(ial)?[-_ ]?tan|brown|opencv", re.IGNORECASE)


def read_opencv_yaml(
    paths: StrPath | Sequence[StrPath],
    *,
    image_size: tuple[int, int] | None = None,
    metres_per_unit: float = 1.0,
) -> NamedRig:
    """Read one calibration file per camera, as written by OpenCV's `FileStorage`.

    A file holds the intrinsics (`K`, `camera_matrix`, ...), optionally the lens (`dist_coeffs`,
    `distortion_coefficients`, ...), the world-to-camera pose (`R` as a matrix or a rotation
    vector, or `rvec`; `t` or `tvec`), and the image size (`image_width` and `image_height`, or
    `image_size`).

    Four coefficients may be k1, k2, p1, p2 of an old pinhole calibration or k1 to k4 of
    `cv2.fisheye.calibrate`, and confusing them moves people by meters. Unless all are 0, the file
    must state the model, by `fisheye_model: 0` or `1`, by another entry whose name contains "model"
    and whose value is known (`distortion_model: plumb_bob` or `equidistant`), or by a fifth
    coefficient.

    Args:
        paths: one file or several, in the order of the rig's cameras.
        image_size: width and height in pixels for files that do not state them.
        metres_per_unit: the files' unit of length: 0.001 for millimeters.

    Returns:
        The rig, each camera named after its file, and also after its folder if files of several
        folders have the same name.

    Raises:
        InvalidInputError: if a file is missing or given twice, a camera is invalid, a file states a
            size other than `image_size`, or `metres_per_unit` is not a positive number.
        FileFormatError: if a file is malformed, or does not state the model of its four
            coefficients.
    """
    scale = as_positive(metres_per_unit, "metres_per_unit")

    def camera_of(storage: Storage) -> FileCamera:
        matrices = storage.numbers
        rotation = _first(matrices, _ROTATION, "rotation")
        if rotation.size == 3:
            rotation = rotation_from_vector(rotation, "the rotation")
        shift = _first(matrices, _TRANSLATION, "translation")
        coefficients = _first(matrices, _DISTORTION, None)
        lens = _lens(storage, coefficients)
        return FileCamera(
            numbers(_first(matrices, _INTRINSICS, "intrinsics"), (3, 3), "K"),
            numbers(rotation, (3, 3), "the rotation"),
            numbers(shift, (3,), "the translation") * scale,
            _image_size(matrices, image_size),
            lens_coefficients(coefficients, "the camera", lens),
            lens,
        )

    found = read_cameras(paths, "calibration", camera_of)
    require_stated_sizes(found.rig, found.names, image_size)
    return found


def write_opencv_yaml(
    folder: StrPath, rig: Rig, names: Sequence[str] | None = None
) -> tuple[Path, ...]:
    """Write one YAML file per registered camera, `<name>.yml`, that OpenCV can read.

    Args:
        folder: created if it does not exist.
        rig: the cameras.
        names: (C,) file names without suffix, in which `_` replaces `/`; C1, C2, ... if None.

    Returns:
        The paths, in the order of the rig.

    Raises:
        InvalidInputError: if the path cannot be a folder, no camera is registered, a camera is a
            grid of rays, or the names do not match the cameras.
    """

    def text_of(camera: FileCamera) -> str:
        width, height = camera.image_size
        matrices = {
            "camera_matrix": camera.K,
            "distortion_coefficients": camera.coefficients[:, None],
            "R": camera.R,
            "t": camera.t[:, None],
        }
        lines = ["%YAML:1.0", "---", f"image_width: {width}", f"image_height: {height}"]
        if camera.lens == Lens.FISHEYE:
            lines.append("fisheye_model: 1")
        for key, matrix in matrices.items():
            data = ", ".join(repr(float(value)) for value in matrix.ravel())
            lines += [
                f"{key}: !!opencv-matrix",
                f"   rows: {matrix.shape[0]}",
                f"   cols: {matrix.shape[1]}",
                "   dt: d",
                f"   data: [ {data} ]",
            ]
        return "\n".join(lines) + "\n"

    return write_cameras(folder, rig, names, text_of)


def _lens(storage: Storage, coefficients: np.ndarray) -> Lens:
    """Lens model that a file states; four coefficients may belong to either.

    Raises:
        FileFormatError: if the file has four coefficients and does not state their model.
    """
    models = [text for key, text in storage.words.items() if "model" in key.lower()]
    flag = storage.numbers.get("fisheye_model", storage.numbers.get("fisheye", np.empty(0)))
    if flag.any() or any(_FISHEYE.search(text) for text in models):
        return Lens.FISHEYE
    is_pinhole = flag.size or any(_PINHOLE.search(text) for text in models)
    if coefficients.size == 4 and coefficients.any() and not is_pinhole:
        raise FileFormatError(
            "the file has 4 distortion coefficients but does not state the lens model. For k1, k2, "
            "p1, p2 of a pinhole, add k3 = 0 as the fifth, or the line `fisheye_model: 0`; for k1 "
            "to k4 of cv2.fisheye, add `fisheye_model: 1`."
        )
    return Lens.PINHOLE


def _first(
    values: dict[str, np.ndarray], names: tuple[str, ...], meaning: str | None
) -> np.ndarray:
    """Return the first value that the file has; if it has none and `meaning` is given, raise."""
    matches = [values[name] for name in names if name in values]
    if not matches and meaning is not None:
        raise FileFormatError(f"the file has no {meaning} ({', '.join(names)}).")
    return matches[0] if matches else np.empty(0)


def _image_size(values: dict[str, np.ndarray], default: tuple[int, int] | None) -> np.ndarray:
    pair = _first(values, _SIZE, None)
    width, height = (_first(values, names, None) for names in (_WIDTH, _HEIGHT))
    size = pair if pair.size else np.concatenate([width, height])
    if size.size == 0 and default is not None:
        return usual_size(default)
    if size.size != 2:
        raise FileFormatError("the file does not state the image size. Pass image_size=.")
    return size
