"""Simulated scenes: a folder with detections, a perturbed rig in an arbitrary frame, and truth."""

from pathlib import Path

import numpy as np

from catfree.adapters.datasets._sequence import MultiViewSequence
from catfree.adapters.files._camera_names import numbered_names
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    list_of,
    naming_file,
    numbers,
    numbers_of,
    read_json,
    read_npz,
    require_folder,
)
from catfree.errors import FileFormatError
from catfree.types import Detections, Plane, Rig, Scene
from catfree.types._validation import as_float, as_positive, require_known_cameras

_TRUTH = {"frame": 1, "id": 1, "xy": 2}  # arrays of gt.npz and their columns
_MOST_FRAMES = 10_000_000  # a larger count means a damaged file


def read_scenario(folder: StrPath) -> MultiViewSequence:
    """Read a simulated scene with an approximate rig in a non-metric frame.

    The folder holds `detections.npz` (frame, cam, box xyxy, score, ankle, emb), `rig.json` (K, R,
    t, image_size, ground_normal, ground_offset, extent, fps, frames), `gt.npz` (frame, id, xy in
    meters), `eval.json` (true_centres, area as x_min, x_max, y_min, y_max, threshold_m) and
    optionally `cloud.npz` (points). To score a result, map it by the similarity from
    `scene.rig.centers` to `true_centres` and drop positions outside `evaluation_area`.

    Args:
        folder: the scenario's folder.

    Returns:
        The sequence; `scene` has the file's plane and extent and is not metric, `ground_truth`
        and `true_centres` are in meters.

    Raises:
        InvalidInputError: if a file is missing or a value in it is invalid.
        FileFormatError: if a file is malformed.
    """
    root = require_folder(folder, "scenario")
    scene, fps, frame_count = _read_scene(root / "rig.json")
    detections = _read_detections(root / "detections.npz", scene.rig.camera_count)
    arrays = read_npz(root / "gt.npz", "true positions", tuple(_TRUTH))
    with naming_file(root / "gt.npz"):
        columns = [_rows(arrays[name], width, name) for name, width in _TRUTH.items()]
        if len({len(column) for column in columns}) > 1:
            raise FileFormatError("frame, id and xy differ in length.")
    protocol = read_json(root / "eval.json", "evaluation protocol")
    with naming_file(root / "eval.json"):
        x_min, x_max, y_min, y_max = numbers_of(protocol, "area", (4,)).tolist()
        true_centers = numbers_of(protocol, "true_centres", (scene.rig.camera_count, 3))
    cloud, points = root / "cloud.npz", None
    if cloud.is_file():
        stored = read_npz(cloud, "scene points", ("points",))["points"]
        with naming_file(cloud):
            points = _rows(stored, 3, "points")
    return MultiViewSequence(
        name=root.resolve().name,
        detections=detections,
        rig=scene.rig,
        scene=scene,
        ground_truth=np.concatenate(columns, axis=1),
        frames=np.arange(frame_count),
        camera_names=numbered_names(scene.rig.camera_count),
        fps=fps,
        evaluation_area=(x_min, x_max, y_min, y_max),
        true_centres=true_centers,
        points=points,
    )


def _rows(values: np.ndarray, columns: int, name: str) -> np.ndarray:
    """Reshape to (N, columns) float64."""
    return numbers(values, (values.size // columns, columns), name)


def _read_scene(path: Path) -> tuple[Scene, float, int]:
    document = read_json(path, "rig")
    with naming_file(path):
        count = len(list_of(entry(document, "K"), "K"))
        shapes = {"K": (count, 3, 3), "R": (count, 3, 3), "t": (count, 3)}
        K, R, t = (numbers_of(document, key, shape) for key, shape in shapes.items())
        normal = numbers_of(document, "ground_normal", (3,))
        offset, extent, fps, frames = (
            numbers_of(document, key, ()) for key in ("ground_offset", "extent", "fps", "frames")
        )
        size = numbers_of(document, "image_size", None)
        size = size if len(size) == 2 else numbers(size, (count, 2), "image_size of the file")
        if not (0 <= frames <= _MOST_FRAMES and frames == np.round(frames)):
            raise FileFormatError(f"frames is {frames}; it must be the number of frames.")
        scene = Scene(Rig(K, R, t, size), Plane(normal, offset), extent)
        return scene, as_positive(fps, "fps"), int(frames)


def _read_detections(path: Path, camera_count: int) -> Detections:
    names = ("frame", "cam", "box", "score", "ankle", "emb")
    arrays = read_npz(path, "detections", names)
    with naming_file(path):
        detections = Detections(
            arrays["frame"],
            arrays["cam"],
            as_float(arrays["box"]).astype(np.float64),
            score=as_float(arrays["score"]).astype(np.float64),
            ankles_confirmed=arrays["ankle"],
            embedding=as_float(arrays["emb"]).astype(np.float32),
        )
        require_known_cameras(detections.camera, camera_count)
    return detections
