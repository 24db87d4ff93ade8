"""The `calibration.json` of the AI City Challenge, Track 1, and of NVIDIA's smart spaces."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    require_stated_sizes,
    rig_of,
    usual_size,
    writable_cameras,
)
from catfree.adapters.calibration_files._projection_matrices import decomposed
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    list_of,
    naming_file,
    numbers,
    numbers_of,
    read_json,
    text_of,
    write_text_atomically,
)
from catfree.errors import FileFormatError, quoted
from catfree.types import Rig

_WIDTH, _HEIGHT = "frameWidth", "frameHeight"


def read_ai_city(path: StrPath, image_size: tuple[int, int] | None = None) -> NamedRig:
    """Read the cameras of a `calibration.json`.

    Each entry of `sensors` has `id` and either `intrinsicMatrix` (3 x 3) and `extrinsicMatrix`
    (3 x 4, world to camera), or `cameraMatrix` (3 x 4, world to pixels). Other kinds of sensors are
    skipped.

    Args:
        path: the file.
        image_size: width and height in pixels of cameras whose attributes do not state them;
            1920 x 1080 if None.

    Returns:
        The rig in meters, and the names.

    Raises:
        InvalidInputError: if there is no such file, a camera is invalid, or the attributes of one
            state a size other than `image_size`.
        FileFormatError: if it is not JSON of this form.
    """
    size = usual_size(image_size)
    document = read_json(path, "calibration")
    names, cameras = [], []
    with naming_file(path):
        for at, sensor in enumerate(list_of(entry(document, "sensors"), "sensors")):
            where = f"sensor {at}"
            name = text_of(entry(sensor, "id", where), f"the id of {where}")
            if sensor.get("type", "camera") == "camera":
                names.append(name)
                cameras.append(_camera(sensor, where, size))
        if not names:
            raise FileFormatError("the file holds no camera.")
        rig = rig_of(cameras)
        require_stated_sizes(rig, names, image_size)
        return NamedRig(rig, tuple(names))


def write_ai_city(path: StrPath, rig: Rig, names: Sequence[str] | None = None) -> Path:
    """Write the registered cameras as a `calibration.json`.

    The map has world coordinates: `scaleFactor` is 1 and `translationToGlobalCoordinates` 0.
    `homography` maps the ground z = 0 to pixels.

    Args:
        path: the file.
        rig: the cameras, without lens distortion, in meters with z up and the ground at z = 0.
        names: (C,) names; C1, C2, ... if None.

    Returns:
        The path.

    Raises:
        InvalidInputError: if no camera is registered, one has lens distortion, the names do not
            match the cameras, or the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    sensors = []
    for label, camera in writable_cameras(rig, names, path, ideal=True):
        plane = camera.projection[:, [0, 1, 3]]
        x, y, _ = (-camera.R.T @ camera.t).tolist()
        attributes = dict(zip((_WIDTH, _HEIGHT), camera.image_size, strict=True))
        sensors.append(
            {
                "type": "camera",
                "id": label,
                "coordinates": {"x": x, "y": y},
                "scaleFactor": 1.0,
                "translationToGlobalCoordinates": {"x": 0.0, "y": 0.0},
                "attributes": [{"name": k, "value": str(v)} for k, v in attributes.items()],
                "intrinsicMatrix": camera.K.tolist(),
                "extrinsicMatrix": np.column_stack([camera.R, camera.t]).tolist(),
                "cameraMatrix": camera.projection.tolist(),
                "homography": (plane / (plane[2, 2] or 1.0)).tolist(),
            }
        )
    document = {"version": "1.0", "calibrationType": "cartesian", "sensors": sensors}
    return write_text_atomically(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def _camera(sensor: dict[str, Any], where: str, usual: Int[np.ndarray, "2"]) -> FileCamera:
    stated = _image_size(sensor, where)
    size = usual if stated is None else stated
    if "intrinsicMatrix" not in sensor or "extrinsicMatrix" not in sensor:
        return FileCamera(*decomposed(numbers_of(sensor, "cameraMatrix", (3, 4), where)), size)
    K = numbers_of(sensor, "intrinsicMatrix", (3, 3), where)
    pose = numbers_of(sensor, "extrinsicMatrix", None, where)
    if pose.size == 16:
        if (pose[12:] != [0, 0, 0, 1]).any():
            raise FileFormatError(
                f"the last row of extrinsicMatrix of {where} is {pose[12:].tolist()}, not 0, 0, "
                "0, 1. Transpose the matrix."
            )
        pose = pose[:12]
    pose = numbers(pose, (3, 4), f"extrinsicMatrix of {where}")
    return FileCamera(K, pose[:, :3], pose[:, 3], size)


def _image_size(sensor: dict[str, Any], where: str) -> tuple[int, int] | None:
    attributes = sensor.get("attributes")
    listed = attributes if isinstance(attributes, list) else []
    stated = {str(one.get("name")): one.get("value") for one in listed if isinstance(one, dict)}
    pair = [stated.get(_WIDTH), stated.get(_HEIGHT)]
    if not any(pair):
        return None
    words = [str(value) for value in pair]
    if not all(word.isdecimal() and len(word) < 10 for word in words):
        raise FileFormatError(
            f"the size of {where} is {quoted(pair[0])} x {quoted(pair[1])}, not two whole numbers."
        )
    return int(words[0]), int(words[1])
