"""Simulated scenes: a tiny hand-made folder and the real ones."""

import json
from pathlib import Path

import numpy as np
import pytest

from catfree.adapters import read_scenario
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError

LOOKING_EAST = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
LOOKING_WEST = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]


def write(folder: Path, rig: dict | None = None, **detections: np.ndarray) -> Path:
    """Write two cameras, three frames and two boxes."""
    K = [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]]
    document = {
        "K": [K, K],
        "R": [LOOKING_EAST, LOOKING_WEST],
        "t": [[0.0, 2.0, 10.0], [0.0, 2.0, 10.0]],
        "image_size": [1920, 1080],
        "ground_normal": [0.0, 0.0, 1.0],
        "ground_offset": 0.5,
        "extent": 3.25,
        "fps": 2.0,
        "frames": 3,
    }
    (folder / "rig.json").write_text(json.dumps(document | (rig or {})))
    arrays = {
        "frame": np.array([0, 2], np.int16),
        "cam": np.array([0, 1], np.uint8),
        "box": np.array([[1, 2, 3, 4], [5, 6, 7, 8.5]], np.float32),
        "score": np.array([0.5, 1], np.float32),
        "ankle": np.array([1, 0], np.uint8),
        "emb": np.eye(2, dtype=np.float32),
    }
    np.savez(folder / "detections.npz", **(arrays | detections))
    truth = {"frame": np.array([0, 2]), "id": np.array([7, 8]), "xy": np.eye(2)}
    np.savez(folder / "gt.npz", **truth)
    protocol = {"true_centres": [[-10, 0, 2], [10, 0, 2]], "area": [0, 1, 2, 3], "threshold_m": 0.5}
    (folder / "eval.json").write_text(json.dumps(protocol))
    return folder


def test_example(tmp_path):
    sequence = read_scenario(write(tmp_path))
    scene, boxes = sequence.scene, sequence.detections
    assert scene is not None
    assert not scene.metric
    assert scene.extent == 3.25
    assert scene.ground.offset == 0.5
    np.testing.assert_array_equal(sequence.frames, [0, 1, 2])
    np.testing.assert_array_equal(sequence.ground_truth, [[0, 7, 1, 0], [2, 8, 0, 1]])
    np.testing.assert_array_equal(sequence.true_centres, [[-10, 0, 2], [10, 0, 2]])
    assert sequence.evaluation_area == (0, 1, 2, 3)
    assert sequence.points is None
    np.testing.assert_array_equal(boxes.box, [[1, 2, 3, 4], [5, 6, 7, 8.5]])
    np.testing.assert_array_equal(boxes.ankles_confirmed, [True, False])
    assert boxes.box.dtype == np.float64


@pytest.mark.parametrize("name", ["detections.npz", "gt.npz", "rig.json", "eval.json"])
def test_missing_and_truncated_files_are_named(name, tmp_path):
    write(tmp_path)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: len(content) // 2])
    with pytest.raises(FileFormatError, match=name):
        read_scenario(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(InvalidInputError, match=f"no file .*{name}"):
        read_scenario(tmp_path)


def test_missing_folder(tmp_path):
    with pytest.raises(InvalidInputError, match=r"no folder .*nowhere"):
        read_scenario(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("rig", "detections", "message"),
    [
        ({}, {"cam": np.array([0, 2])}, r"camera\[1\] is 2, but the rig has 2 cameras"),
        ({}, {"cam": np.array([0])}, r"detections\.npz: camera must have shape"),
        ({}, {"box": np.full((2, 4), np.nan)}, r"detections\.npz: box\[0, 0\] is not finite"),
        ({"t": [[0.0, 2.0, 10.0]]}, {}, r"rig\.json: t of the file must hold 2 x 3"),
        ({"R": [LOOKING_EAST, LOOKING_EAST[::-1]]}, {}, r"rig\.json: R\[1\] is not a rotation"),
        ({"ground_normal": [0.0, 0.0, -1.0]}, {}, r"rig\.json: The cameras are on the negative"),
        ({"extent": 0}, {}, r"rig\.json: extent is 0"),
        ({"frames": None}, {}, r"rig\.json: frames"),
        ({"fps": 0}, {}, r"rig\.json: fps is 0.0; it must be a positive number"),
    ],
)
def test_invalid_content_is_named(rig, detections, message, tmp_path):
    write(tmp_path, rig, **detections)
    with pytest.raises(CatFreeError, match=message):
        read_scenario(tmp_path)


@pytest.mark.parametrize("name", ["ring5", "mvx6", "gmvd8", "uneven7"])
def test_real_scenarios(name, shared):
    sequence = read_scenario(shared / "data" / "scenarios" / f"public_{name}")
    scene = sequence.scene
    assert scene is not None
    assert sequence.camera_count == int(name[-1])
    assert sequence.true_centres is not None
    assert sequence.true_centres.shape == (sequence.camera_count, 3)
    assert len(sequence.frames) == 40
    assert np.isin(sequence.detections.frame, sequence.frames).all()
    assert sequence.points is not None
    assert sequence.points.shape == (3600, 3)
    height = scene.ground.signed_distance(np.asarray(scene.rig.centers))
    assert (height > 0).all()
    # The ground truth is in meters, so distances between centers differ by one scale only.
    distances = [
        np.linalg.norm(c[:, None] - c[None], axis=-1)[np.triu_indices(len(c), 1)]
        for c in (np.asarray(scene.rig.centers), sequence.true_centres)
    ]
    ratio = distances[1] / distances[0]
    assert ratio.std() < 0.1 * ratio.mean()
