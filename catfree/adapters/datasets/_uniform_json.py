"""One JSON file for a whole sequence: cameras, boxes and true positions in meters."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from catfree.adapters.calibration_files._distortion import lens_coefficients
from catfree.adapters.calibration_files._named_rig import FileCamera, rig_of
from catfree.adapters.datasets._sequence import (
    MultiViewSequence,
    metric_scene,
    require_people_in_front,
)
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
from catfree.adapters.protocols import ankles_confirmed
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Detections, Rig
from catfree.types._validation import as_float, as_path, as_positive, require_boxes


def read_uniform_json(
    path: StrPath, *, views: str = "views", embedding: str | None = None
) -> MultiViewSequence:
    """Read a sequence from one JSON file.

    The file holds `{name, units: "m", fps, cameras: [{name, K, dist, R, t, width, height}],
    frames: [{frame, gt: [{id, x, y}], views: {camera: [{box: [x1, y1, x2, y2], score?, kpts?,
    id?, emb_index?}]}}], evaluation_area?: {x: [min, max], y: [min, max]}}` with
    `x_camera = R x + t`, meters, z up, ground z = 0, pixels, positive depth. Cameras without `K`
    give a sequence without rig.

    Frame numbers are synchronized labels and may step by more than one: consecutive frames are
    neighbors in the sorted `frames` of the result.

    Args:
        path: the JSON file.
        views: key of the boxes to read, if the file holds those of several detectors.
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
    if entry(document, "units", source, "the file") != "m":
        raise FileFormatError(f"{source} has units {quoted(document['units'])}; convert it to 'm'.")
    cameras = list_of(entry(document, "cameras", source, "the file"), source, "cameras")
    records = list_of(entry(document, "frames", source, "the file"), source, "frames")
    names = tuple(
        text_of(entry(c, "name", source, f"camera {i}"), source, f"the name of camera {i}")
        for i, c in enumerate(cameras)
    )
    if len(set(names)) < len(names):
        raise FileFormatError(
            f"{source} gives two cameras the same name: {shortened(', '.join(names))}."
        )
    frames = _frame_numbers(records, source)
    order = np.argsort(frames, kind="stable")
    table = _BoxTable(source, names)
    truth: list[tuple] = []
    for record, frame in zip(records, frames.tolist(), strict=True):
        truth += _ground_truth(record, frame, source)
        table.add(frame, entry(record, views, source, f"frame {frame}"))
    positions = np.array(truth, np.float64).reshape(-1, 4)

    rig = _read_rig(cameras, source)
    fps = document.get("fps")
    if fps is not None:
        rate = float(numbers(fps, (), source, "fps"))
        with naming_file(source):
            fps = as_positive(rate, "fps")
    if rig is not None:
        require_people_in_front(rig, positions[:, 2:], source)
    with naming_file(source):
        scene = None if rig is None or rig.camera_count < 2 else metric_scene(rig)
    return MultiViewSequence(
        name=text_of(document.get("name", source.stem), source, "the name"),
        detections=table.detections(embedding),
        rig=rig,
        scene=scene,
        ground_truth=positions,
        frames=frames[order],
        camera_names=names,
        fps=fps,
        evaluation_area=_area(document.get("evaluation_area"), source),
        true_centres=None if rig is None else np.asarray(rig.centers),
        images=_images([records[i] for i in order], names, source),
        identity=table.identity(),
    )


@dataclasses.dataclass
class _BoxTable:
    """Boxes of one file, collected frame by frame, with their places for messages."""

    source: Path
    camera_names: tuple[str, ...]
    rows: list[tuple[int, int, int, dict[str, Any]]] = dataclasses.field(default_factory=list)

    def add(self, frame: int, views: Any) -> None:
        if not isinstance(views, dict):
            raise FileFormatError(f"{self.source}: the views of frame {frame} must be an object.")
        unknown = sorted(set(views) - set(self.camera_names))
        if unknown:
            raise FileFormatError(
                f"{self.source}: frame {frame} has boxes of camera {quoted(unknown[0])}, which is "
                f"not among its cameras {shortened(', '.join(self.camera_names))}."
            )
        for camera, name in enumerate(self.camera_names):
            boxes = list_of(views.get(name, []), self.source, f"{name} of frame {frame}")
            self.rows += [(frame, camera, index, box) for index, box in enumerate(boxes)]

    def place(self, row: int) -> str:
        frame, camera, index, _ = self.rows[row]
        return f"box {index} of camera {shortened(self.camera_names[camera])} in frame {frame}"

    def column(self, key: str, shape: tuple[int, ...]) -> np.ndarray | None:
        """Return the (N, *shape) values of a key that all boxes or none must have."""
        present = [isinstance(box, dict) and box.get(key) is not None for *_, box in self.rows]
        if not any(present):
            return None
        if not all(present):
            at = present.index(False)
            raise FileFormatError(
                f"{self.source}: {self.place(at)} has no {key!r}, while other boxes have one."
            )
        values = [box[key] for *_, box in self.rows]
        try:
            array = np.asarray(as_float(values), np.float64)
        except InvalidInputError:
            array = np.empty(0)
        if array.shape != (len(values), *shape):  # slow path only to name the offending box
            array = np.stack(
                [
                    numbers(v, shape, self.source, f"{key!r} of {self.place(i)}", finite=False)
                    for i, v in enumerate(values)
                ]
            )
        finite = np.isfinite(array).reshape(len(array), -1).all(-1)
        if not finite.all():
            at = int(np.argmin(finite))
            raise InvalidInputError(
                f"{self.source}: {key!r} of {self.place(at)} is not finite. Remove that box."
            )
        return array

    def detections(self, embedding: str | None) -> Detections:
        box = self.column("box", (4,))
        if box is None and self.rows:
            raise FileFormatError(f"{self.source}: {self.place(0)} has no 'box'.")
        box = np.empty((0, 4)) if box is None else box
        keypoints = self.column("kpts", (17, 3))
        ankles = None if keypoints is None else ankles_confirmed(keypoints)
        score = self.column("score", ())
        with naming_file(self.source):
            require_boxes(len(box), box, score, keypoints, self.place)
        vectors = None if embedding is None else self.embedding(embedding)
        frame, camera = (np.array([row[at] for row in self.rows], np.int64) for at in (0, 1))
        with naming_file(self.source):
            return Detections(frame, camera, box, score, ankles, vectors, keypoints)

    def embedding(self, name: str) -> np.ndarray:
        """Return (N, D) float32 rows of the array `name` in the archive beside the JSON."""
        archive = self.source.with_suffix(".npz")
        vectors = read_npz(archive, "appearance vectors", (name,))[name]
        index = self.column("emb_index", ())
        if vectors.dtype.kind not in "biuf":
            raise FileFormatError(
                f"{archive}: {quoted(name)} has type {vectors.dtype}, not numbers."
            )
        if vectors.ndim != 2 or index is None:
            raise FileFormatError(
                f"{self.source}: the boxes have no 'emb_index' into the rows of {archive}."
                if vectors.ndim == 2
                else f"{archive}: {quoted(name)} must be a matrix of embeddings, one per row."
            )
        outside = (index < 0) | (index >= len(vectors)) | (index != np.round(index))
        if outside.any():
            at = int(np.argmax(outside))
            raise InvalidInputError(
                f"{self.source}: {self.place(at)} has emb_index {index[at]:.10g}, but "
                f"{archive} has {len(vectors)} rows of {quoted(name)}, counted from 0."
            )
        return vectors[index.astype(np.int64)].astype(np.float32)

    def identity(self) -> np.ndarray | None:
        identities = [box.get("id") for *_, box in self.rows]
        if all(value is None for value in identities):
            return None
        whole = [
            -1 if value is None else whole_number(value, self.source, f"id of {self.place(at)}")
            for at, value in enumerate(identities)
        ]
        return np.array(whole, np.int64)


def _existing(folder: Path, name: Any) -> Path | None:
    path = folder / name if isinstance(name, str) and name else None
    return path if path is not None and os.path.isfile(path) else None


def _frame_numbers(records: list[Any], source: Path) -> np.ndarray:
    places = [f"frames[{at}]" for at in range(len(records))]
    whole = [
        whole_number(entry(record, "frame", source, where), source, f"frame of {where}")
        for record, where in zip(records, places, strict=True)
    ]
    frames = np.array(whole, np.int64)
    distinct, counts = np.unique(frames, return_counts=True)
    if (counts > 1).any():
        raise FileFormatError(f"{source} holds frame {int(distinct[counts > 1][0])} twice.")
    return frames


def _ground_truth(record: dict[str, Any], frame: int, source: Path) -> list[tuple]:
    rows = []
    for at, person in enumerate(list_of(record.get("gt") or [], source, f"gt of frame {frame}")):
        where = f"gt {at} of frame {frame}"
        xy = [entry(person, axis, source, where) for axis in ("x", "y")]
        x, y = numbers(xy, (2,), source, where)
        identity = -1 if person.get("id") is None else person["id"]
        identity = whole_number(identity, source, f"id of {where}")
        rows.append((frame, identity, x, y))
    return rows


def _read_rig(cameras: list[Any], source: Path) -> Rig | None:
    if not cameras or any("K" not in camera for camera in cameras):
        return None
    file_cameras = []
    for camera in cameras:
        where = f"camera {shortened(str(camera['name']))}"
        K, R, t = (
            numbers_of(camera, key, shape, source, where)
            for key, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,)))
        )
        pair = [entry(camera, key, source, where) for key in ("width", "height")]
        size = numbers(pair, (2,), source, where)
        values = numbers(camera.get("dist") or [], None, source, f"dist of {where}")
        distortion = lens_coefficients(values, source, where)
        file_cameras.append(FileCamera(K, R, t, size, distortion))
    return rig_of(file_cameras, source)


def _area(area: Any, source: Path) -> tuple[float, float, float, float] | None:
    if area is None:
        return None
    limits = [entry(area, axis, source, "evaluation_area") for axis in ("x", "y")]
    x, y = numbers(limits, (2, 2), source, "evaluation_area").tolist()
    return (x[0], x[1], y[0], y[1])


def _images(
    records: list[Any], names: tuple[str, ...], source: Path
) -> tuple[tuple[Path | None, ...], ...]:
    """List (C, F) images, whose paths are relative to the JSON file's folder."""
    paths_by_camera = [record.get("images") for record in records]
    paths_by_camera = [paths if isinstance(paths, dict) else {} for paths in paths_by_camera]
    images = tuple(
        tuple(_existing(source.parent, paths.get(name)) for paths in paths_by_camera)
        for name in names
    )
    return images if any(path for row in images for path in row) else ()
