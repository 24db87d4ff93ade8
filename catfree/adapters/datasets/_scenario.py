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
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Detections, Plane, Rig, Scene
from catfree.types._validation import as_float, as_positive

_TRUTH = {"frame": 1, "id": 1, "xy": 2}  # arrays of gt.npz and their columns
_MOST_FRAMES = 10_000_000  # a larger count means a damaged file


def read_scenario(folder: StrPath) -> MultiViewSequence:
    """Read a simulated scene whose rig is approximate and in a frame that is not metric.

    The folder holds `detections.npz` (frame, cam, box xyxy, score, ankle, emb), `rig.json` (K, R,
    t, image_size, ground_normal, ground_offset, extent, fps, frames), `gt.npz` (frame, id, xy in
    meters), `eval.json` (true_centres, area as x_min, x_max, y_min, y_max, threshold_m) and
    optionally `cloud.npz` (points). To score a result, map it by the similarity from
    `scene.rig.centers` to `true_centres` and drop what falls outside `evaluation_area`.

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
    truth = read_npz(root / "gt.npz", "true positions", ("frame", "id", "xy"))
    columns = [_rows(truth[name], at, root / "gt.npz", name) for name, at in _TRUTH.items()]
    if len({len(column) for column in columns}) > 1:
        raise FileFormatError(f"{root / 'gt.npz'}: frame, id and xy differ in length.")
    ground_truth = np.concatenate(columns, axis=1)
    protocol = read_json(root / "eval.json", "evaluation protocol")
    centers = (scene.rig.camera_count, 3)
    area = numbers_of(protocol, "area", (4,), root / "eval.json", "the file")
    x_min, x_max, y_min, y_max = area.tolist()
    cloud = root / "cloud.npz"
    return MultiViewSequence(
        name=root.resolve().name,
        detections=detections,
        rig=scene.rig,
        scene=scene,
        ground_truth=ground_truth,
        frames=np.arange(frame_count),
        camera_names=numbered_names(scene.rig.camera_count),
        fps=fps,
        evaluation_area=(x_min, x_max, y_min, y_max),
        true_centres=numbers_of(protocol, "true_centres", centers, root / "eval.json", "the file"),
        points=(
            _rows(read_npz(cloud, "scene points", ("points",))["points"], 3, cloud, "points")
            if cloud.is_file()
            else None
        ),
    )


def _rows(values: np.ndarray, columns: int, source: Path, name: str) -> np.ndarray:
    """Reshape to (N, columns) float64."""
    return numbers(values, (values.size // columns, columns), source, name)


def _read_scene(path: Path) -> tuple[Scene, float, int]:
    document = read_json(path, "rig")

    def value(key: str, *shape: int) -> np.ndarray:
        return numbers_of(document, key, shape, path, "the file")

    count = len(list_of(entry(document, "K", path, "the file"), path, "K"))
    K, R, t = value("K", count, 3, 3), value("R", count, 3, 3), value("t", count, 3)
    normal, offset = value("ground_normal", 3), value("ground_offset")
    extent = value("extent")
    size = numbers_of(document, "image_size", None, path, "the file")
    size = size if len(size) == 2 else value("image_size", count, 2)
    with naming_file(path):
        fps = as_positive(float(value("fps")), "fps")
    frames = float(value("frames"))
    if not (0 <= frames <= _MOST_FRAMES and frames == int(frames)):
        raise FileFormatError(f"{path}: frames is {frames}; it must be the number of frames.")
    with naming_file(path):
        scene = Scene(Rig(K, R, t, size), Plane(normal, offset), extent)
    return scene, fps, int(frames)


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
    if len(detections) and detections.camera.max() >= camera_count:
        raise InvalidInputError(
            f"{path} has detections of camera {detections.camera.max()}, but rig.json has "
            f"{camera_count} cameras (counted from 0)."
        )
    return detections
