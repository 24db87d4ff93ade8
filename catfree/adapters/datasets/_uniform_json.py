"""One JSON file for a whole sequence: cameras, boxes and true positions in meters."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.calibration_files._named_rig import FileCamera, lens_coefficients, rig_of
from catfree.adapters.datasets._sequence import MultiViewSequence, require_people_in_front
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    list_of,
    naming_file,
    numbers,
    numbers_of,
    read_json,
    read_npz,
    text_of,
    whole_number,
)
from catfree.adapters.files._text_rows import naming_row
from catfree.adapters.protocols import ankles_confirmed
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Detections, Rig
from catfree.types._scene import metric_scene
from catfree.types._validation import as_path, as_positive


def read_uniform_json(
    path: StrPath, *, views: str = "views", embedding: str | None = None
) -> MultiViewSequence:
    """Read a sequence from one JSON file.

    The file holds `{name, units: "m", fps, cameras: [{name, K, dist, R, t, width, height}],
    frames: [{frame, gt: [{id, x, y}], views: {camera: [{box: [x1, y1, x2, y2], score?, kpts?,
    id?, emb_index?}]}}], evaluation_area?: {x: [min, max], y: [min, max]}}` with
    `x_camera = R x + t`, meters, z up, ground z = 0, pixels, positive depth. If cameras have no
    `K`, the sequence has no rig.

    Frame numbers are synchronized labels and may step by more than one: consecutive frames are
    neighbors in the sorted `frames` of the result.

    Args:
        path: the JSON file.
        views: key of the boxes to read, if the file holds boxes of several detectors.
        embedding: name of the appearance vectors to attach (L2-normalized, float32), an array of
            the `.npz` beside the JSON whose rows the boxes' `emb_index` select; None for none.

    Returns:
        The sequence. Float64 boxes in the file's order, `ankles_confirmed` if keypoints exist.

    Raises:
        InvalidInputError: if there is no such file, or a box, camera or position is invalid; the
            message names file, frame, camera and index.
        FileFormatError: if the file is not JSON of this form.
    """
    source = as_path(path, "path")
    document = read_json(source, "sequence")
    vectors = None if embedding is None else _vectors(source.with_suffix(".npz"), embedding)
    with naming_file(source):
        return _sequence(document, source, views, vectors)


def _sequence(
    document: Any, source: Path, views: str, vectors: Float[np.ndarray, "row d"] | None
) -> MultiViewSequence:
    if entry(document, "units") != "m":
        raise FileFormatError(f"the file has units {quoted(document['units'])}; convert it to 'm'.")
    cameras = list_of(entry(document, "cameras"), "cameras")
    records = list_of(entry(document, "frames"), "frames")
    names = tuple(
        text_of(entry(c, "name", f"camera {i}"), f"the name of camera {i}")
        for i, c in enumerate(cameras)
    )
    if len(set(names)) < len(names):
        raise FileFormatError(
            f"the file gives two cameras the same name: {shortened(', '.join(names))}."
        )
    frames = _frame_numbers(records)
    order = np.argsort(frames, kind="stable")
    table = _BoxTable(names)
    truth: list[tuple] = []
    for record, frame in zip(records, frames.tolist(), strict=True):
        truth += _ground_truth(record, frame)
        table.add(frame, entry(record, views, f"frame {frame}"))
    positions = np.array(truth, np.float64).reshape(-1, 4)

    rig, fps = _rig(cameras), document.get("fps")
    if rig is not None:
        require_people_in_front(rig, positions[:, 2:])
    return MultiViewSequence(
        name=text_of(document.get("name", source.stem), "the name"),
        detections=table.detections(vectors),
        rig=rig,
        scene=None if rig is None or rig.camera_count < 2 else metric_scene(rig),
        ground_truth=positions,
        frames=frames[order],
        camera_names=names,
        fps=None if fps is None else as_positive(numbers(fps, (), "fps"), "fps"),
        evaluation_area=_area(document.get("evaluation_area")),
        true_centres=None if rig is None else np.asarray(rig.centers),
        images=_images([records[i] for i in order], names, source.parent),
        identity=table.identity(),
    )


@dataclasses.dataclass
class _BoxTable:
    """Boxes of one file, collected frame by frame, with their places for messages."""

    camera_names: tuple[str, ...]
    rows: list[tuple[int, int, int, dict[str, Any]]] = dataclasses.field(default_factory=list)

    def add(self, frame: int, views: Any) -> None:
        if not isinstance(views, dict):
            raise FileFormatError(f"the views of frame {frame} must be an object.")
        unknown = sorted(set(views) - set(self.camera_names))
        if unknown:
            raise FileFormatError(
                f"frame {frame} has boxes of camera {quoted(unknown[0])}, which is not among its "
                f"cameras {shortened(', '.join(self.camera_names))}."
            )
        for camera, name in enumerate(self.camera_names):
            boxes = list_of(views.get(name, []), f"{name} of frame {frame}")
            self.rows += [(frame, camera, index, box) for index, box in enumerate(boxes)]

    def place(self, row: int) -> str:
        frame, camera, index, _ = self.rows[row]
        return f"box {index} of camera {shortened(self.camera_names[camera])} in frame {frame}"

    def column(self, key: str, shape: tuple[int, ...]) -> np.ndarray | None:
        """Return the (N, *shape) values of a key, which all boxes or none must have."""
        present = [isinstance(box, dict) and box.get(key) is not None for *_, box in self.rows]
        if not any(present):
            return None
        if not all(present):
            at = present.index(False)
            raise FileFormatError(f"{self.place(at)} has no {key!r}, while other boxes have one.")
        values = [box[key] for *_, box in self.rows]
        try:
            return numbers(values, (len(values), *shape), key)
        except CatFreeError:  # slow path only to name the offending box
            each = [numbers(v, shape, f"{key!r} of {self.place(i)}") for i, v in enumerate(values)]
            return np.stack(each)

    def detections(self, vectors: Float[np.ndarray, "row d"] | None) -> Detections:
        box = self.column("box", (4,))
        if box is None and self.rows:
            raise FileFormatError(f"{self.place(0)} has no 'box'.")
        box = np.empty((0, 4)) if box is None else box
        keypoints = self.column("kpts", (17, 3))
        ankles = None if keypoints is None else ankles_confirmed(keypoints)
        score = self.column("score", ())
        embedding = None if vectors is None else self.embedding(vectors)
        frame, camera = (np.array([row[at] for row in self.rows], np.int64) for at in (0, 1))
        with naming_row(lambda row: f"of {self.place(row)}"):
            return Detections(frame, camera, box, score, ankles, embedding, keypoints)

    def embedding(self, vectors: Float[np.ndarray, "row d"]) -> Float[np.ndarray, "n d"]:
        """Return the appearance vector that each box selects."""
        index = self.column("emb_index", ())
        if index is None and self.rows:
            raise FileFormatError("the boxes have no 'emb_index' into the appearance vectors.")
        index = np.empty(0) if index is None else index
        outside = (index < 0) | (index >= len(vectors)) | (index != np.round(index))
        if outside.any():
            at = int(np.argmax(outside))
            raise InvalidInputError(
                f"{self.place(at)} has emb_index {index[at]:.10g}, but there are {len(vectors)} "
                "appearance vectors, counted from 0."
            )
        return vectors[index.astype(np.int64)]

    def identity(self) -> np.ndarray | None:
        identities = [box.get("id") for *_, box in self.rows]
        if all(value is None for value in identities):
            return None
        whole = [
            -1 if value is None else whole_number(value, f"id of {self.place(at)}")
            for at, value in enumerate(identities)
        ]
        return np.array(whole, np.int64)


def _vectors(archive: Path, name: str) -> Float[np.ndarray, "row d"]:
    """Read (rows, D) float32 appearance vectors."""
    vectors = read_npz(archive, "appearance vectors", (name,))[name]
    if vectors.dtype.kind not in "biuf":
        raise FileFormatError(f"{archive}: {quoted(name)} has type {vectors.dtype}, not numbers.")
    if vectors.ndim != 2:
        raise FileFormatError(
            f"{archive}: {quoted(name)} must be a matrix of embeddings, one per row."
        )
    return vectors.astype(np.float32)


def _existing(folder: Path, name: Any) -> Path | None:
    path = folder / name if isinstance(name, str) and name else None
    return path if path is not None and os.path.isfile(path) else None


def _frame_numbers(records: list[Any]) -> np.ndarray:
    whole = [
        whole_number(entry(record, "frame", f"frames[{at}]"), f"frame of frames[{at}]")
        for at, record in enumerate(records)
    ]
    frames = np.array(whole, np.int64)
    distinct, counts = np.unique(frames, return_counts=True)
    if (counts > 1).any():
        raise FileFormatError(f"the file holds frame {int(distinct[counts > 1][0])} twice.")
    return frames


def _ground_truth(record: dict[str, Any], frame: int) -> list[tuple]:
    rows = []
    for at, person in enumerate(list_of(record.get("gt") or [], f"gt of frame {frame}")):
        where = f"gt {at} of frame {frame}"
        x, y = numbers([entry(person, axis, where) for axis in ("x", "y")], (2,), where)
        identity = -1 if person.get("id") is None else person["id"]
        rows.append((frame, whole_number(identity, f"id of {where}"), x, y))
    return rows


def _rig(cameras: list[Any]) -> Rig | None:
    if not cameras or any("K" not in camera for camera in cameras):
        return None
    file_cameras = []
    for camera in cameras:
        where = f"camera {shortened(str(camera['name']))}"
        K, R, t = (
            numbers_of(camera, key, shape, where)
            for key, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,)))
        )
        size = numbers([entry(camera, key, where) for key in ("width", "height")], (2,), where)
        distortion = lens_coefficients(camera.get("dist") or [], where)
        file_cameras.append(FileCamera(K, R, t, size, distortion))
    return rig_of(file_cameras)


def _area(area: Any) -> tuple[float, float, float, float] | None:
    if area is None:
        return None
    limits = [entry(area, axis, "evaluation_area") for axis in ("x", "y")]
    x, y = numbers(limits, (2, 2), "evaluation_area").tolist()
    return (x[0], x[1], y[0], y[1])


def _images(
    records: list[Any], names: tuple[str, ...], folder: Path
) -> tuple[tuple[Path | None, ...], ...]:
    """List (C, F) images, whose paths are relative to the folder of the JSON file."""
    paths_by_camera = [record.get("images") for record in records]
    paths_by_camera = [paths if isinstance(paths, dict) else {} for paths in paths_by_camera]
    images = tuple(
        tuple(_existing(folder, paths.get(name)) for paths in paths_by_camera) for name in names
    )
    return images if any(path for row in images for path in row) else ()
