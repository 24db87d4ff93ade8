"""COLMAP reconstructions: text and binary in, text out."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    rig_of,
    writable_cameras,
)
from catfree.adapters.calibration_files.colmap._colmap_binary import (
    BinaryFile,
    binary_cameras,
    binary_images,
    binary_points,
)
from catfree.adapters.calibration_files.colmap._colmap_models import (
    PARAMETERS,
    PIXEL_CENTER,
    ColmapCamera,
    ColmapImage,
    intrinsics,
    supported_model,
)
from catfree.adapters.files._camera_names import natural_order
from catfree.adapters.files._documents import (
    StrPath,
    naming_file,
    numbers,
    parse_numbers,
    read_text,
    require_folder,
    write_text_atomically,
)
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Lens, Rig
from catfree.types._validation import as_finite, as_path
from catfree.types._writing import make_folder


def read_colmap(folder: StrPath) -> NamedRig:
    """Read a COLMAP model: every image becomes one camera of the rig, in natural order.

    The folder holds `cameras`, `images` and optionally `points3D`, all `.bin` or all `.txt`; binary
    files are preferred. Supported models are SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL,
    OPENCV, FULL_OPENCV, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE. The principal
    point is moved by half a pixel to catfree's convention, the center of the top-left pixel at
    (0, 0).

    Args:
        folder: for instance `sparse/0`.

    Returns:
        Rig in the model's arbitrary units and frame, image names, and points if there are any.

    Raises:
        InvalidInputError: if a file is missing or a camera is invalid.
        FileFormatError: if a file is truncated or malformed, describes a camera twice, or a camera
            model is not supported.
    """
    root = require_folder(folder, "COLMAP model")
    is_text = (root / "cameras.txt").is_file() and not (root / "cameras.bin").is_file()
    kind = "txt" if is_text else "bin"

    def parsed(name: str, text: Callable[..., Any], binary: Callable[..., Any]) -> Any:
        path = root / f"{name}.{kind}"
        content = (_lines if is_text else BinaryFile)(path, f"COLMAP {name}")
        with naming_file(path):
            return (text if is_text else binary)(content)

    numbered = parsed("cameras", _text_cameras, binary_cameras)
    images = parsed("images", _text_images, binary_images)
    images = sorted(images, key=lambda image: natural_order(image[0]))
    has_points = (root / f"points3D.{kind}").is_file()
    points = parsed("points3D", _text_points, binary_points) if has_points else None
    with naming_file(root):
        if not images:
            raise FileFormatError("the model holds no images.")
        cameras: dict[int, ColmapCamera] = dict(numbered)
        if len(cameras) < len(numbered):
            twice = Counter(camera_id for camera_id, _ in numbered).most_common(1)[0][0]
            raise FileFormatError(
                f"cameras.{kind} describes camera {twice} twice. Remove one of the two."
            )
        rig = rig_of([_camera(image, cameras) for image in images])
        return NamedRig(rig, tuple(image[0] for image in images), points)


def _camera(image: ColmapImage, cameras: dict[int, ColmapCamera]) -> FileCamera:
    name, camera_id, quaternion, translation = image
    where = f"image {shortened(name)}"
    if camera_id not in cameras:
        raise FileFormatError(f"{where} has camera {camera_id}, not in cameras.")
    model, width, height, parameters = cameras[camera_id]
    matrix, coefficients, lens = intrinsics(model, parameters, where)
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(quaternion)
    if not (np.isfinite(norm) and norm > 0):
        raise InvalidInputError(f"{where} has no valid rotation quaternion.")
    R = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    return FileCamera(matrix, R, translation, np.array([width, height]), coefficients, lens)


def write_colmap_text(
    folder: StrPath,
    rig: Rig,
    names: Sequence[str] | None = None,
    points: np.ndarray | None = None,
) -> Path:
    """Write `cameras.txt`, `images.txt` and `points3D.txt`, with one image per camera.

    Unregistered cameras are left out. A lens is written as OPENCV, with k3 to k6 as FULL_OPENCV, a
    fisheye as OPENCV_FISHEYE, an ideal camera as PINHOLE.

    Args:
        folder: created if it does not exist.
        rig: the cameras.
        names: (C,) image names without spaces; C1, C2, ... if None.
        points: (P, 3) points in the rig's frame, written in gray.

    Returns:
        The folder.

    Raises:
        InvalidInputError: if no camera is registered, a name has a space, a K has skew, a camera is
            a grid of rays, which COLMAP cannot represent, or the points are not finite or have
            another shape.
        WriteError: if the folder cannot be made, or the disk is full or not writable.
    """
    root = as_path(folder, "folder")
    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[]"]
    for at, (name, camera) in enumerate(writable_cameras(rig, names, root), start=1):
        K, lens = camera.K, camera.coefficients
        if not name or any(letter.isspace() for letter in name):
            raise InvalidInputError(
                f"Cannot write {root}: camera name {quoted(name)} is empty or has a space, "
                "which COLMAP's text format does not allow. Pass other names."
            )
        if abs(K[0, 1]) > 1e-9 * K[0, 0]:
            raise InvalidInputError(
                f"Cannot write {root}: camera {shortened(name)} has skew {K[0, 1]:.3g}, which "
                "no COLMAP model supports."
            )
        if camera.lens == Lens.FISHEYE:
            model, coefficients = "OPENCV_FISHEYE", lens
        elif not lens.any():
            model, coefficients = "PINHOLE", []
        elif not lens[4:].any():
            model, coefficients = "OPENCV", lens[:4]
        else:
            model, coefficients = "FULL_OPENCV", camera.distortion
        width, height = camera.image_size
        inner = _row(K[[0, 1], [0, 1]], K[:2, 2] + PIXEL_CENTER, coefficients)
        cameras.append(f"{at} {model} {width} {height} {inner}")
        quaternion = Rotation.from_matrix(camera.R).as_quat(canonical=True)
        images += [f"{at} {_row(np.roll(quaternion, 1), camera.t)} {at} {name}", ""]
    cloud = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    scene = np.empty((0, 3)) if points is None else as_finite(points, (None, 3), "points")
    cloud += [f"{at + 1} {_row(point)} 128 128 128 0" for at, point in enumerate(scene)]
    make_folder(root)
    for file, lines in (("cameras", cameras), ("images", images), ("points3D", cloud)):
        write_text_atomically(root / f"{file}.txt", "\n".join(lines) + "\n")
    return root


def _row(*parts: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(value)) for part in parts for value in part)


def _lines(path: Path, meaning: str) -> list[str]:
    text = read_text(path, meaning)
    return [line.strip() for line in text.splitlines() if not line.lstrip().startswith("#")]


def _integer(word: str, where: str) -> int:
    try:
        return int(word)
    except ValueError as error:
        raise FileFormatError(f"{where} has {quoted(word)} instead of a number.") from error


def _text_cameras(lines: list[str]) -> list[tuple[int, ColmapCamera]]:
    cameras = []
    for line in filter(None, lines):
        words = line.split()
        camera_id = _integer(words[0], "a camera")
        where = f"camera {camera_id}"
        if len(words) < 4:
            raise FileFormatError(f"{where} is incomplete.")
        model = supported_model(words[1], camera_id)
        width, height = (_integer(word, where) for word in words[2:4])
        values = parse_numbers(words[4:], where)
        parameters = numbers(values, (len(PARAMETERS[model]),), f"{where} ({model})")
        cameras.append((camera_id, (model, width, height, parameters)))
    return cameras


def _text_images(lines: list[str]) -> list[ColmapImage]:
    images, remaining = [], iter(lines)
    for line in remaining:
        if not line:
            continue
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise FileFormatError(f"the line of image {shortened(words[0])} is incomplete.")
        name, where = words[9], f"image {shortened(words[9])}"
        pose = numbers(parse_numbers(words[1:8], where), (7,), where)
        camera_id = _integer(words[8], where)
        images.append((name, camera_id, pose[:4], pose[4:]))
        points = next(remaining, "").split()  # x, y and point of each, often none at all
        if len(points) % 3:
            raise FileFormatError(
                f"the line after {where} must hold its image points, three numbers each, or be "
                "empty. Every image has two lines."
            )
    return images


def _text_points(lines: list[str]) -> Float[np.ndarray, "p 3"]:
    points = []
    for line in filter(None, lines):
        number, *words = line.split()
        where = f"point {shortened(number)}"
        points.append(numbers(parse_numbers(words[:3], where), (3,), where))
    return np.array(points).reshape(-1, 3)
