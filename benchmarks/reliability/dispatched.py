"""Valid files for readers that detect the format, and for tables of boxes."""

import csv
import dataclasses
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet

from benchmarks.reliability.material import Material, Reader
from catfree._run.sharded._plan_file import PlanFile, read_plan, write_plan
from catfree._run.sharded._receipt import (
    MANIFEST,
    MANIFEST_SCHEMA,
    SCENE_FILE,
    SCHEMA,
    WORK_FOLDER,
    Receipt,
    read_receipt,
    write_receipt,
)
from catfree._run.sharded._shard import shards
from catfree._run.sharded._stored_tracks import open_tracks
from catfree.adapters import (
    read_detections,
    read_detections_parquet,
    read_missing_pictures,
    read_scene,
    read_tracks,
    write_detections_parquet,
    write_scene_json,
    write_tracks_csv,
    write_tracks_parquet,
)
from catfree.adapters.files._fingerprint import hash_file
from catfree.errors import FileFormatError
from catfree.settings import Settings
from catfree.types import Clock, Detections, Tracks

# Paths that `read_scene` is given in the folders of other readers.
_SCENES = {
    "Scene.load": "a.npz",
    "read_scene_json": "a.json",
    "read_rig_json": "a.json",
    "read_uniform_json": "a.json",
    "read_anipose_toml": "a.toml",
    "read_opencv_yaml (YAML)": "",
    "read_colmap (text)": "m",
    "read_colmap (binary)": "m",
    "read_ai_city": "a.json",
    "read_mv3dt": "",
    "read_wildtrack": "",
    "read_multiviewx": "",
}

# Readers for which only some files of the folder describe a scene.
_DAMAGED = {
    "read_uniform_json": (".json",),
    "read_wildtrack": (".xml", ".json"),
    "read_multiviewx": (".xml", ".json"),
}


def dispatching_readers(m: Material, known: list[Reader]) -> list[Reader]:
    """Make the readers of boxes, tracks, scenes and shards in any format.

    Args:
        m: content of the files.
        known: readers of one format each, whose files `read_scene` and `read_detections` take.
    """
    by_name = {reader.name: reader for reader in known}
    full = _with_everything(m)
    return [
        Reader(
            "read_detections (CSV)",
            lambda f: write_boxes_csv(f / "a.csv", m.detections, m.names),
            lambda f: read_detections(f / "a.csv", m.names),
        ),
        Reader(
            "read_detections (CSV of widths)",
            lambda f: write_widths_csv(f / "a.csv", m.detections),
            lambda f: read_detections(f / "a.csv", frame_rate=5),
        ),
        Reader(
            "read_detections (Parquet)",
            lambda f: write_detections_parquet(f / "a.parquet", full),
            lambda f: read_detections(f / "a.parquet", m.names),
        ),
        Reader(
            "read_detections (Parquet with names)",
            lambda f: _write_named_parquet(f / "a.parquet", full, m.names),
            lambda f: read_detections(f / "a.parquet", m.names),
        ),
        Reader(
            "read_detections (folder of Parquet)",
            lambda f: _write_parts(f, full),
            lambda f: read_detections(f, m.names),
        ),
        Reader(
            "read_detections (npz)",
            lambda f: full.save(f / "a.npz"),
            lambda f: read_detections(f / "a.npz", m.names),
        ),
        Reader("read_detections (MOT)", lambda f: _write_mot_folder(f, m), read_detections),
        Reader(
            "read_detections (uniform JSON)",
            by_name["read_uniform_json"].write,
            lambda f: read_detections(f / "a.json"),
            only=(".json",),
        ),
        Reader(
            "read_detections (COCO)",
            by_name["read_coco"].write,
            lambda f: read_detections(f / "a.json"),
        ),
        Reader(
            "read_detections_parquet",
            lambda f: write_detections_parquet(f / "a.parquet", full),
            lambda f: read_detections_parquet(f / "a.parquet", 1, 7),
        ),
        Reader(
            "Detections.from_table (CSV)",
            lambda f: write_boxes_csv(f / "a.csv", m.detections, m.names),
            lambda f: _from_pandas(f / "a.csv", m.names),
        ),
        Reader(
            "read_missing_pictures (CSV)",
            lambda f: (f / "a.csv").write_text("frame,camera\n0,north\n3,1\n4,south\n4,2\n"),
            lambda f: read_missing_pictures(f / "a.csv", m.names),
        ),
        Reader(
            "read_missing_pictures (Parquet)",
            lambda f: _write_table(f / "a.parquet", frame=[0, 3, 4], camera=[2, 0, 1]),
            lambda f: read_missing_pictures(f / "a.parquet", m.names),
        ),
        Reader(
            "read_tracks (CSV)",
            lambda f: write_tracks_csv(f / "a.csv", m.tracks),
            lambda f: read_tracks(f / "a.csv"),
        ),
        Reader(
            "read_tracks (CSV with a clock)",
            lambda f: write_tracks_csv(f / "tracks.csv", _timed(m)),
            read_tracks,
        ),
        Reader(
            "read_tracks (Parquet)",
            lambda f: write_tracks_parquet(f / "a.parquet", _timed(m), m.names),
            lambda f: _without_position(read_tracks(f / "a.parquet")),
        ),
        Reader(
            "read_tracks (npz)",
            lambda f: m.tracks.save(f / "a.npz"),
            lambda f: read_tracks(f / "a.npz"),
        ),
        *(
            Reader(
                f"read_scene ({name})",
                by_name[name].write,
                _scene_reader(inner),
                only=_DAMAGED.get(name, ()),
            )
            for name, inner in _SCENES.items()
        ),
        Reader("read_plan", lambda f: _write_plan(f, m), lambda f: read_plan(f / "plan.json")),
        Reader(
            "read_receipt",
            lambda f: write_receipt(f / "a.json", _receipt("")),
            lambda f: _with_finite_settings(read_receipt(f / "a.json")),
        ),
        Reader("open_tracks", lambda f: _write_joined(f, m), _read_joined),
    ]


def write_boxes_csv(path: Path, boxes: Detections, names: tuple[str, ...]) -> None:
    """Write a table of corners and scores with camera names."""
    rows = zip(boxes.frame.tolist(), boxes.camera.tolist(), boxes.box.tolist(), strict=True)
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "camera", "x1", "y1", "x2", "y2", "score"])
        writer.writerows([frame, names[camera], *box, 0.5] for frame, camera, box in rows)


def write_widths_csv(path: Path, boxes: Detections) -> None:
    """Write a table of widths and heights with camera numbers."""
    rows = zip(boxes.frame.tolist(), boxes.camera.tolist(), boxes.box.tolist(), strict=True)
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame_id", "cam", "left", "top", "width", "height", "conf"])
        writer.writerows([f, c, x1, y1, x2 - x1, y2 - y1, 1] for f, c, (x1, y1, x2, y2) in rows)


def _with_everything(m: Material) -> Detections:
    """Add every optional column to the boxes."""
    count = len(m.detections)
    return replace(
        m.detections,
        score=np.full(count, 0.5),
        ankles_confirmed=np.arange(count) % 2 == 0,
        embedding=np.eye(count, 4, dtype=np.float32) + 1,
        keypoints=np.tile([50.0, 60.0, 0.5], (count, 17, 1)),
        clock=Clock(5.0, 1.7e9, utc=True),
    )


def _timed(m: Material) -> Tracks:
    """Put the tracks on a clock."""
    return replace(m.tracks, clock=Clock(5.0, 1.7e9, utc=True))


def _write_table(path: Path, **columns: Any) -> None:
    pyarrow.parquet.write_table(pyarrow.table(columns), path, write_page_checksum=True)


def _write_named_parquet(path: Path, boxes: Detections, names: tuple[str, ...]) -> None:
    """Write a table as other programs do: with camera names, and lists of varying length."""
    columns: dict[str, Any] = {
        "frame": boxes.frame,
        "camera": [names[c] for c in boxes.camera],
        "embedding": [] if boxes.embedding is None else boxes.embedding.tolist(),
    }
    columns |= dict(zip(("x1", "y1", "x2", "y2"), np.ascontiguousarray(boxes.box.T), strict=True))
    _write_table(path, **columns)


def _write_parts(folder: Path, boxes: Detections) -> None:
    for part in (0, 1):
        rows = (boxes.frame >= 4) == bool(part)
        write_detections_parquet(folder / f"part-{part}.parquet", boxes[rows])


def _write_mot_folder(folder: Path, m: Material) -> None:
    for camera, name in enumerate(m.names):
        one = m.detections[m.detections.camera == camera]
        text = "".join(
            f"{frame + 1},-1,{x1},{y1},{x2 - x1},{y2 - y1},0.5,-1,-1,-1\n"
            for frame, (x1, y1, x2, y2) in zip(one.frame.tolist(), one.box.tolist(), strict=True)
        )
        (folder / f"{name}.txt").write_text(text)


def _from_pandas(path: Path, names: tuple[str, ...]) -> Detections:
    """Read boxes with pandas; what pandas cannot read says nothing about catfree."""
    import pandas

    try:
        table = pandas.read_csv(path)
    except Exception as error:
        raise FileFormatError(f"pandas does not read {path}.") from error
    return Detections.from_table(table, camera_names=names)


def _without_position(tracks: Tracks) -> Tracks:
    """Return the tracks without positions that a table does not store, which must be NaN."""
    assert np.isnan(tracks.position).all()
    return replace(tracks, position=np.zeros_like(tracks.position))


def _scene_reader(inner: str) -> Callable[[Path], Any]:
    return lambda folder: read_scene(folder / inner)


def _write_plan(folder: Path, m: Material) -> None:
    write_detections_parquet(folder / "boxes.parquet", m.detections)
    plan = shards(
        folder / "boxes.parquet",
        every=0.8,
        overlap=0.4,
        frame_rate=5,
        silent=[[3, 1]],
        site="north",
        date="2026-11-20",
        camera_names=m.names,
    )
    write_plan(folder / "plan.json", PlanFile(plan, "scene.json", "out", "evidence"))
    (folder / "boxes.parquet").unlink()


def _receipt(scene_file: str) -> Receipt:
    return Receipt(
        schema=SCHEMA,
        index=0,
        count=1,
        first=0,
        stop=8,
        first_seen=0,
        stop_seen=8,
        shard="a",
        source="b",
        run="c",
        settings=dataclasses.asdict(Settings()),
        clock=dataclasses.asdict(Clock(5.0)),
        scene_file=scene_file,
        part="d",
        fragments="e",
        boxes=48,
        cameras=(0, 1, 2),
        boxes_used=0.9,
        expected_moda=80.0,
        median_sigma=0.1,
        person_height=1.7,
        seconds=2.5,
        warnings=("Camera north moved.",),
        verdicts=("healthy",),
    )


def _with_finite_settings(receipt: Receipt) -> Receipt:
    """Replace infinite settings of the receipt by zeros, as some settings may be infinite."""

    def finite(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: finite(item) for name, item in value.items()}
        if isinstance(value, list):
            return [finite(item) for item in value]
        return 0.0 if isinstance(value, float) and np.isinf(value) else value

    return replace(receipt, settings=finite(receipt.settings))


def _write_joined(folder: Path, m: Material) -> None:
    """Write the folder that `join` leaves, without its shards."""
    (folder / WORK_FOLDER).mkdir()
    write_scene_json(folder / SCENE_FILE, m.scene, m.names)
    tracks, parts = _timed(m), []
    for number, (first, stop) in enumerate(((0, 4), (4, 8))):
        rows = tracks[(tracks.frame >= first) & (tracks.frame < stop)]
        path = write_tracks_parquet(folder / f"part-{number:05d}.parquet", rows, m.names)
        part = {"file": path.name, "first": first, "stop": stop, "rows": len(rows)}
        parts.append(part | {"sha256": hash_file(path), "boxes_used": 0.9, "warnings": []})
    document = {
        "schema": MANIFEST_SCHEMA,
        "clock": {"frame_rate": 5.0, "start": 1.7e9, "utc": True},
        "scene_file": hash_file(folder / SCENE_FILE),
        "people": 2,
        "parts": parts,
    }
    (folder / MANIFEST).write_text(json.dumps(document))


def _read_joined(folder: Path) -> Any:
    stored = open_tracks(folder)
    return vars(stored) | {"tracks": stored.read(), "some": stored.between(1.7e9, 1.7e9 + 1)}
