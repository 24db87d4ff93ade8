"""Readers of COLMAP's binary files: cameras, images and points.

Every read is checked against the end of the file, and the end of the file against the announced
number of records.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from catfree.adapters.calibration_files.colmap._colmap_models import (
    MODELS,
    PARAMETERS,
    ColmapCamera,
    ColmapImage,
    supported_model,
)
from catfree.adapters.files._documents import numbers, require_file
from catfree.errors import FileFormatError, quoted


class BinaryFile:
    """A binary file read front to back, with a clear error if it ends too early."""

    def __init__(self, path: Path, meaning: str) -> None:
        """Read all bytes.

        Args:
            path: the file.
            meaning: description for messages.
        """
        source = require_file(path, meaning)
        try:
            self.data, self.at = source.read_bytes(), 0
        except OSError as error:
            raise FileFormatError(f"{source} cannot be read: {quoted(error)}.") from error

    def take(self, layout: str) -> tuple:
        size = struct.calcsize("<" + layout)
        self.skip(size)
        return struct.unpack_from("<" + layout, self.data, self.at - size)

    def skip(self, size: int) -> None:
        if self.at + size > len(self.data):
            raise FileFormatError("the file is truncated or not a COLMAP file.")
        self.at += size

    def name(self) -> str:
        start, end = self.at, self.data.find(b"\0", self.at)
        self.skip((end if end >= 0 else len(self.data)) - start + 1)
        try:
            return self.data[start:end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise FileFormatError("the file has an image name that is not UTF-8.") from error

    def records(self) -> Iterator[int]:
        """Yield the indices of the announced records, then check that nothing follows."""
        yield from range(self.take("Q")[0])
        if self.at != len(self.data):
            raise FileFormatError("the file continues after its last record.")


def binary_cameras(stream: BinaryFile) -> list[tuple[int, ColmapCamera]]:
    """Read numbers and cameras of `cameras.bin` in the order of the file."""
    cameras = []
    for _ in stream.records():
        camera_id, model_id, width, height = stream.take("iiQQ")
        model = supported_model(MODELS.get(model_id, (f"number {model_id}",))[0], camera_id)
        parameters = np.array(stream.take(f"{len(PARAMETERS[model])}d"))
        cameras.append((camera_id, (model, width, height, parameters)))
    return cameras


def binary_images(stream: BinaryFile) -> list[ColmapImage]:
    """Read the images of `images.bin` in the order of the file."""
    images = []
    for _ in stream.records():
        _, *pose, camera_id = stream.take("i7di")
        images.append((stream.name(), camera_id, np.array(pose[:4]), np.array(pose[4:])))
        stream.skip(24 * stream.take("Q")[0])  # x, y, point id of each image point
    return images


def binary_points(stream: BinaryFile) -> Float[np.ndarray, "p 3"]:
    """Read the points of `points3D.bin`."""
    points = []
    for _ in stream.records():
        points.append(stream.take("Q3d3Bd")[1:4])
        stream.skip(8 * stream.take("Q")[0])  # image id and point index of each observation
    return numbers(points, (len(points), 3), "a point")
