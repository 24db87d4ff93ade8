"""One valid file or folder per reader, with its reader."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.reliability.dispatched import dispatching_readers
from benchmarks.reliability.material import Material, Reader
from catfree._run._cache import StageCache, to_arrays
from catfree._run._result_folder import LOCALIZATION_FILE, read_results
from catfree._run.sharded._sites import read_sites
from catfree.adapters import (
    read_ai_city,
    read_ai_city_tracks,
    read_anipose_toml,
    read_coco,
    read_colmap,
    read_ground_truth,
    read_mot,
    read_multiviewx,
    read_mv3dt,
    read_opencv_yaml,
    read_rig_json,
    read_scenario,
    read_scene_json,
    read_tracks_csv,
    read_tracks_parquet,
    read_uniform_json,
    read_wildtrack,
    write_ai_city,
    write_ai_city_tracks,
    write_anipose_toml,
    write_colmap_text,
    write_mot_boxes,
    write_mv3dt,
    write_opencv_yaml,
    write_rig_json,
    write_scene_json,
    write_tracks_csv,
    write_tracks_parquet,
)
from catfree.adapters.calibration_files.colmap._colmap_models import MODELS, PARAMETERS
from catfree.adapters.datasets._detection_files import RESULT_SCENE
from catfree.adapters.video._timestamps import read_timestamps
from catfree.calibration import read_anchors
from catfree.methods.online import TrackerState
from catfree.types import (
    Detections,
    Localization,
    Rig,
    Scene,
    Tracks,
)
from catfree.types._archive import save_arrays

_TIMES = "frame_id,timestamp_s\n0,1700000000.0\n1,1700000000.04\n2,1700000000.08\n"
WILDTRACK_LABELS = ("CVLab1", "CVLab2", "CVLab3", "CVLab4", "IDIAP1", "IDIAP2", "IDIAP3")


def readers(seed: int) -> list[Reader]:
    """Make every reader of the library."""
    m = Material(seed)
    known = _of_one_format(m)
    return known + dispatching_readers(m, known)


def _of_one_format(m: Material) -> list[Reader]:
    lens = m.lens_rig()
    return [
        Reader("Detections.load", lambda f: m.detections.save(f / "a.npz"), _load(Detections)),
        Reader("Rig.load", lambda f: lens.save(f / "a.npz"), _load(Rig)),
        Reader("Scene.load", lambda f: m.scene.save(f / "a.npz"), _load(Scene)),
        Reader("Tracks.load", lambda f: m.tracks.save(f / "a.npz"), _load(Tracks)),
        Reader(
            "TrackerState.load", lambda f: m.tracker_state().save(f / "a.npz"), _load(TrackerState)
        ),
        Reader("read_results", lambda f: _write_results(f, m), read_results),
        Reader(
            "cached Localization",
            lambda f: StageCache(f).store("localize", "0" * 40, m.localization),
            lambda f: StageCache(f).load("localize", "0" * 40, Localization),
            cached=True,
        ),
        Reader(
            "cached Detections",
            lambda f: StageCache(f).store("boxes", "0" * 40, m.detections),
            lambda f: StageCache(f).load("boxes", "0" * 40, Detections),
            cached=True,
        ),
        Reader(
            "read_rig_json",
            lambda f: write_rig_json(f / "a.json", lens, m.names, metric=True),
            lambda f: read_rig_json(f / "a.json"),
        ),
        Reader(
            "read_scene_json",
            lambda f: write_scene_json(f / "a.json", m.scene, m.names),
            lambda f: read_scene_json(f / "a.json"),
        ),
        Reader(
            "read_uniform_json",
            lambda f: _write_uniform(f, m),
            lambda f: read_uniform_json(f / "a.json", embedding="osnet"),
        ),
        Reader(
            "read_anipose_toml",
            lambda f: write_anipose_toml(f / "a.toml", lens, m.names),
            lambda f: read_anipose_toml(f / "a.toml"),
        ),
        Reader(
            "read_opencv_yaml (YAML)",
            lambda f: write_opencv_yaml(f, lens, m.names),
            lambda f: read_opencv_yaml(sorted(f.glob("*.yml"))),
        ),
        *(
            Reader(
                f"read_opencv_yaml ({suffix.upper()})",
                lambda f, suffix=suffix: _write_storage(f / f"a.{suffix}", lens),
                lambda f, suffix=suffix: read_opencv_yaml(f / f"a.{suffix}"),
            )
            for suffix in ("xml", "json")
        ),
        Reader(
            "read_colmap (text)",
            lambda f: write_colmap_text(f / "m", lens, m.names, np.eye(3)),
            lambda f: read_colmap(f / "m"),
        ),
        Reader(
            "read_colmap (binary)",
            lambda f: _write_colmap_binary(f / "m", m.rig, m.names),
            lambda f: read_colmap(f / "m"),
        ),
        Reader(
            "read_tracks_csv",
            lambda f: write_tracks_csv(f / "a.csv", m.tracks),
            lambda f: read_tracks_csv(f / "a.csv"),
        ),
        Reader(
            "read_tracks_parquet",
            lambda f: write_tracks_parquet(f / "a.parquet", m.tracks),
            lambda f: read_tracks_parquet(f / "a.parquet", m.scene.ground),
        ),
        Reader(
            "read_timestamps",
            lambda f: (f / "a.csv").write_text(_TIMES),
            lambda f: read_timestamps(f / "a.csv", 3),
        ),
        Reader("read_mot", lambda f: _write_mot(f, m), lambda f: _read_mot(f / "a.txt")),
        Reader(
            "read_ground_truth",
            lambda f: _write_truth(f, m),
            lambda f: read_ground_truth(f / "a.csv"),
        ),
        Reader("read_coco", lambda f: _write_coco(f, m), lambda f: read_coco(f / "a.json")),
        Reader(
            "read_ai_city",
            lambda f: write_ai_city(f / "a.json", m.rig, m.names),
            lambda f: read_ai_city(f / "a.json"),
        ),
        Reader(
            "read_mv3dt",
            lambda f: write_mv3dt(f, m.rig, m.names),
            lambda f: read_mv3dt(sorted(f.iterdir())),
        ),
        Reader(
            "read_ai_city_tracks",
            lambda f: write_ai_city_tracks(f / "a.txt", m.tracks),
            lambda f: read_ai_city_tracks(f / "a.txt"),
        ),
        Reader("read_wildtrack", _write_wildtrack, read_wildtrack, only=(".xml", ".json")),
        Reader(
            "read_multiviewx",
            _write_multiviewx,
            lambda f: read_multiviewx(f, boxes="annotations"),
            only=(".xml", ".json"),
        ),
        Reader(
            "read_multiviewx (matchings)",
            _write_multiviewx,
            lambda f: read_multiviewx(f, boxes="matchings"),
            only=(".txt",),
        ),
        Reader("read_anchors", _write_anchors, lambda f: read_anchors(f / "a.json")),
        Reader("read_sites", _write_sites, lambda f: read_sites(f / "a.toml")),
        Reader("read_scenario", lambda f: _write_scenario(f, m), read_scenario),
    ]


def _load(kind: Any) -> Callable[[Path], Any]:
    return lambda folder: kind.load(folder / "a.npz")


def _write_results(folder: Path, m: Material) -> None:
    write_scene_json(folder / RESULT_SCENE, m.scene, m.names)
    arrays = to_arrays(m.localization)
    save_arrays(folder / LOCALIZATION_FILE, Localization.__name__, arrays)


def _write_uniform(folder: Path, m: Material) -> None:
    rig = m.rig
    cameras = [
        {"name": name, "K": K.tolist(), "R": R.tolist(), "t": t.tolist(), "dist": [0, 0, 0, 0, 0]}
        | {"width": 320, "height": 240}
        for name, K, R, t in zip(
            m.names, np.asarray(rig.K), np.asarray(rig.R), np.asarray(rig.t), strict=True
        )
    ]
    frames: dict[int, dict] = {}
    for at in range(len(m.detections)):
        row = m.detections[at : at + 1]
        record = frames.setdefault(
            int(row.frame[0]),
            {
                "frame": int(row.frame[0]),
                "gt": [{"id": 1, "x": 0.5, "y": 0.25}],
                "views": {name: [] for name in m.names},
                "images": {"north": "north.png"},
            },
        )
        score = 0.5 if row.score is None else float(row.score[0])
        box = {"box": row.box[0].tolist(), "score": score, "emb_index": at, "id": 3}
        box["kpts"] = np.tile([50.0, 60.0, 0.5], (17, 1)).tolist()
        record["views"][m.names[int(row.camera[0])]].append(box)
    document = {"name": "tiny", "units": "m", "fps": 5.0, "cameras": cameras}
    document |= {"frames": list(frames.values())}
    document |= {"evaluation_area": {"x": [-1.0, 1.0], "y": [-1.0, 1.0]}}
    (folder / "a.json").write_text(json.dumps(document))
    looks = np.eye(len(m.detections), 4, dtype=np.float32) + 1
    np.savez_compressed(folder / "a.npz", osnet=looks)


def _write_storage(path: Path, rig: Rig) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 320)
    storage.write("image_height", 240)
    storage.write("camera_matrix", np.asarray(rig.K)[0])
    storage.write("distortion_coefficients", np.asarray(rig.distortion)[0][:, None])
    storage.write("R", np.asarray(rig.R)[0])
    storage.write("t", np.asarray(rig.t)[0][:, None])
    storage.write("distortion_model", "plumb_bob")
    storage.release()


def _write_colmap_binary(folder: Path, rig: Rig, names: tuple[str, ...]) -> None:
    """Convert the text files, whose numbers are written in COLMAP's binary layout."""
    import struct

    write_colmap_text(folder, rig, names)
    number = {name: at for at, (name, _) in MODELS.items()}
    rows = _rows(folder / "cameras.txt")
    content = struct.pack("<Q", len(rows))
    for camera, model, width, height, *values in rows:
        content += struct.pack("<iiQQ", int(camera), number[model], int(width), int(height))
        content += struct.pack(f"<{len(PARAMETERS[model])}d", *map(float, values))
    (folder / "cameras.bin").write_bytes(content)
    rows = _rows(folder / "images.txt")
    content = struct.pack("<Q", len(rows))
    for image, *pose, camera, name in rows:
        content += struct.pack("<i7di", int(image), *map(float, pose), int(camera))
        content += name.encode() + b"\0" + struct.pack("<Q2dq", 1, 1.0, 2.0, -1)
    (folder / "images.bin").write_bytes(content)
    content = struct.pack("<Q", 3)
    for at in range(3):
        content += struct.pack("<Q3d3BdQii", at, 0.5, at, 1.0, 9, 9, 9, 0.1, 1, 1, 0)
    (folder / "points3D.bin").write_bytes(content)
    for path in folder.glob("*.txt"):
        path.unlink()


def _rows(path: Path) -> list[list[str]]:
    lines = (line.split() for line in path.read_text().splitlines() if not line.startswith("#"))
    return [words for words in lines if words]


def _write_mot(folder: Path, m: Material) -> None:
    one = m.detections[m.detections.camera == 0]
    write_mot_boxes(folder / "a.txt", one, np.arange(8), np.zeros(len(one)))


def _read_mot(path: Path) -> Any:
    table = read_mot(path)
    return table, table.detections()


def _write_coco(folder: Path, m: Material) -> None:
    boxes = m.detections
    rows = [
        {"image_id": f"{camera}/{frame}.png", "bbox": [x1, y1, x2 - x1, y2 - y1], "score": 0.5}
        for camera, frame, (x1, y1, x2, y2) in zip(
            boxes.camera.tolist(), boxes.frame.tolist(), boxes.box.tolist(), strict=True
        )
    ]
    (folder / "a.json").write_text(json.dumps(rows))


def _write_truth(folder: Path, m: Material) -> None:
    rows = "".join(",".join(f"{value:g}" for value in row) + "\n" for row in m.tracks.to_rows())
    (folder / "a.csv").write_text("frame,id,x,y\n" + rows)


def rig_around(x: float, y: float, count: int) -> Rig:
    """Place cameras 3 m high on a circle of 15 m radius, looking at (x, y)."""
    angle = 2 * np.pi * np.arange(count) / count + 0.2
    place = np.stack([15 * np.cos(angle), 15 * np.sin(angle), np.full(count, 3.0)], -1)
    center = np.array([x, y, 0]) + place
    forward = np.array([x, y, 0]) - center
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.tile([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]], (count, 1, 1))
    return Rig(K, R, -np.einsum("cij,cj->ci", R, center), (1920, 1080))


def _xml(path: Path, **matrices: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = (
        f"<{name} type_id='opencv-matrix'><rows>1</rows><cols>{value.size}</cols><dt>d</dt>"
        f"<data>{' '.join(map(repr, value.ravel().tolist()))}</data></{name}>"
        for name, value in matrices.items()
    )
    path.write_text(f"<?xml version='1.0'?><opencv_storage>{''.join(parts)}</opencv_storage>")


def _annotations(path: Path, cell: int, cameras: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    box = {"xmin": 10, "ymin": 20, "xmax": 30, "ymax": 80}
    hidden = dict.fromkeys(box, -1)
    views = [{"viewNum": c} | (box if c % 2 else hidden) for c in range(cameras)]
    path.write_text(json.dumps([{"personID": 3, "positionID": cell, "views": views}]))


def _write_wildtrack(folder: Path) -> None:
    rig = rig_around(3.0, 6.0, 7)
    for camera, label in enumerate(WILDTRACK_LABELS):
        R, t = np.asarray(rig.R)[camera], np.asarray(rig.t)[camera]
        _xml(
            folder / "calibrations" / "intrinsic_zero" / f"intr_{label}.xml",
            camera_matrix=np.asarray(rig.K)[camera],
            distortion_coefficients=np.zeros(5),
        )
        _xml(
            folder / "calibrations" / "extrinsic" / f"extr_{label}.xml",
            rvec=Rotation.from_matrix(R).as_rotvec(),
            tvec=100 * t,
        )
    for frame in (0, 5):
        _annotations(folder / "annotations_positions" / f"{frame:08d}.json", 240 + 480 * 600, 7)


def _write_multiviewx(folder: Path) -> None:
    rig, flip = rig_around(12.5, 8.0, 6), np.diag([1.0, -1, 1])
    for camera in range(6):
        R, t = np.asarray(rig.R)[camera], np.asarray(rig.t)[camera]
        _xml(
            folder / "calibrations" / "intrinsic" / f"intr_Camera{camera + 1}.xml",
            camera_matrix=np.asarray(rig.K)[camera],
        )
        _xml(
            folder / "calibrations" / "extrinsic" / f"extr_Camera{camera + 1}.xml",
            rvec=Rotation.from_matrix(-R @ flip).as_rotvec(),
            tvec=-(t + R @ np.array([0, 16.0, 0])),
        )
        pixels = [1, 0, *np.stack([np.arange(9) * 5, np.arange(9) * 7], -1).ravel()]
        points = [1, 0, *np.tile([3.0, 4.0, 0.5], 9)]
        for suffix, row in (("", pixels), ("_3d", points)):
            path = folder / "matchings" / f"Camera{camera + 1}{suffix}.txt"
            path.parent.mkdir(exist_ok=True)
            path.write_text(" ".join(f"{value:g}" for value in row) + "\n")
    _annotations(folder / "annotations_positions" / "00001.json", 500 + 1000 * 320, 6)


def _write_anchors(folder: Path) -> None:
    distance = {"camera": "north", "pixels": [[64, 50], [81, 50.5]], "meters": 5.0}
    camera = {"camera": 1, "height": 4.1, "position": [1, 2, 4.1], "rotation": np.eye(3).tolist()}
    point = {"camera": 0, "pixel": [51, 70], "longitude": 8.547, "latitude": 47.376, "sd": 0.1}
    document = {"distances": [distance], "cameras": [camera], "points": [point]}
    (folder / "a.json").write_text(json.dumps(document))


def _write_sites(folder: Path) -> None:
    options = "every = 600\noverlap = 9.5\nmethod = 'default'\ndetector = 'a.onnx'\n"
    north = "[[site]]\nname = 'north'\ndate = 2026-11-20\nvideos = ['a.mp4', 'b.mp4']\n"
    north += "scene = 'scene.json'\nframe_rate = 12.5\nsilent = 'silent.csv'\n"
    south = "[[site]]\nname = 'south'\ndetections = 'boxes.csv'\nunit = 'cm'\n"
    south += "image_size = [[320, 240], [640, 480]]\nanchors = 'anchors.json'\n"
    (folder / "a.toml").write_text(options + north + south)


def _write_scenario(folder: Path, m: Material) -> None:
    rig, boxes = m.rig, m.detections
    document = {key: np.asarray(getattr(rig, key)).tolist() for key in ("K", "R", "t")}
    document |= {"image_size": [320, 240], "ground_normal": [0, 0, 1.0], "ground_offset": 0.0}
    document |= {"extent": 3.0, "fps": 5.0, "frames": 8}
    (folder / "rig.json").write_text(json.dumps(document))
    count = len(boxes)
    score = np.ones(count) if boxes.score is None else boxes.score
    np.savez_compressed(
        folder / "detections.npz",
        frame=boxes.frame,
        cam=boxes.camera,
        box=boxes.box,
        score=score,
        ankle=np.ones(count, np.uint8),
        emb=np.ones((count, 2), np.float32),
    )
    np.savez_compressed(folder / "gt.npz", frame=np.arange(3), id=np.arange(3), xy=np.ones((3, 2)))
    np.savez_compressed(folder / "cloud.npz", points=np.eye(3))
    protocol = {"true_centres": np.asarray(rig.centers).tolist(), "area": [-1, 1, -2, 2]}
    (folder / "eval.json").write_text(json.dumps(protocol))
