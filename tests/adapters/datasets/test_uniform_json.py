"""The uniform JSON: hand-made files, damaged files, and real data."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import read_uniform_json
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError

LOOKING_EAST = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
LOOKING_WEST = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
K = [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]]


def document() -> dict:
    """Write two cameras 2 m high at x = -10 and x = 10, facing each other, and two people."""
    cameras = [
        {"name": name, "K": K, "R": R, "t": [0.0, 2.0, 10.0], "width": 1920, "height": 1080}
        for name, R in (("west", LOOKING_EAST), ("east", LOOKING_WEST))
    ]
    keypoints = [[5.0, 6.0, 0.9]] * 17
    hidden = [*keypoints[:16], [5.0, 6.0, 0.49]]
    seen = {"box": [1.0, 2.0, 11.0, 22.0], "score": 0.9, "kpts": keypoints, "emb_index": 1}
    partly = {"box": [1, 2, 11, 32], "score": 0.5, "kpts": hidden, "emb_index": 0}
    return {
        "name": "two",
        "units": "m",
        "fps": 2,
        "cameras": cameras,
        "frames": [
            {"frame": 10, "gt": [{"id": 4, "x": 1.0, "y": 2.0}], "views": {"east": [partly]}},
            {
                "frame": 5,
                "gt": [{"id": None, "x": 3.0, "y": 4.0}],
                "views": {"west": [dict(seen), dict(seen)]},
            },
            {"frame": 15, "gt": [], "views": {}},
        ],
        "evaluation_area": {"x": [-1.0, 2.0], "y": [-3, 4]},
    }


def write(path: Path, content: dict) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_example(tmp_path):
    path = write(tmp_path / "two.json", document())
    vectors = np.eye(3, dtype=np.float16)[:2]
    np.savez(tmp_path / "two.npz", osnet=vectors)
    sequence = read_uniform_json(path, embedding="osnet")
    boxes = sequence.detections
    assert (sequence.name, sequence.fps, sequence.camera_names) == ("two", 2.0, ("west", "east"))
    np.testing.assert_array_equal(sequence.frames, [5, 10, 15])  # 15 has no boxes
    np.testing.assert_array_equal(boxes.frame, [10, 5, 5])
    np.testing.assert_array_equal(boxes.camera, [1, 0, 0])
    np.testing.assert_array_equal(boxes.box[:2], [[1, 2, 11, 32], [1, 2, 11, 22]])
    assert boxes.score is not None
    np.testing.assert_array_equal(boxes.score, [0.5, 0.9, 0.9])
    assert boxes.ankles_confirmed is not None
    np.testing.assert_array_equal(boxes.ankles_confirmed, [False, True, True])
    assert boxes.embedding is not None
    assert boxes.embedding.dtype == np.float32
    np.testing.assert_array_equal(boxes.embedding, np.eye(3)[[0, 1, 1]])
    np.testing.assert_array_equal(sequence.ground_truth, [[10, 4, 1, 2], [5, -1, 3, 4]])
    assert sequence.evaluation_area == (-1, 2, -3, 4)
    assert sequence.identity is None
    assert sequence.rig is not None
    assert sequence.rig.distortion is None
    np.testing.assert_array_equal(sequence.rig.centers, [[-10, 0, 2], [10, 0, 2]])
    scene = sequence.scene
    assert scene is not None
    assert scene.metric
    assert scene.extent == 20
    np.testing.assert_array_equal(scene.ground.normal, [0, 0, 1])
    assert scene.ground.offset == 0


def test_embeddings_are_read_only_on_request(tmp_path):
    sequence = read_uniform_json(write(tmp_path / "two.json", document()))
    assert sequence.detections.embedding is None


def test_annotated_boxes_keep_their_identity(tmp_path):
    content = document()
    content["frames"][0]["views"]["east"][0]["id"] = 7
    sequence = read_uniform_json(write(tmp_path / "two.json", content))
    assert sequence.identity is not None
    np.testing.assert_array_equal(sequence.identity, [7, -1, -1])


def test_other_detectors_boxes(tmp_path):
    content = document()
    for frame in content["frames"]:
        frame["views_other"] = {"west": [{"box": [0, 0, 1, 1]}]}
    sequence = read_uniform_json(write(tmp_path / "two.json", content), views="views_other")
    assert len(sequence.detections) == 3
    assert sequence.detections.score is None


def test_without_calibration_there_is_no_rig(tmp_path):
    content = document()
    for camera in content["cameras"]:
        del camera["K"]
    sequence = read_uniform_json(write(tmp_path / "two.json", content))
    assert sequence.rig is None
    assert sequence.scene is None
    assert len(sequence.detections) == 3


def test_no_frames_and_no_people(tmp_path):
    content = document() | {"frames": []}
    sequence = read_uniform_json(write(tmp_path / "two.json", content))
    assert len(sequence.frames) == len(sequence.detections) == len(sequence.ground_truth) == 0


def test_select_frames(tmp_path):
    sequence = read_uniform_json(write(tmp_path / "two.json", document()))
    part = sequence.select_frames([15, 5])
    np.testing.assert_array_equal(part.frames, [5, 15])
    np.testing.assert_array_equal(part.detections.frame, [5, 5])
    np.testing.assert_array_equal(part.ground_truth, [[5, -1, 3, 4]])
    with pytest.raises(InvalidInputError, match="no frame 7"):
        sequence.select_frames([7])


def edit(path: str, value: object):
    """Replace one entry of a document, addressed like `frames.0.views`; `...` deletes it."""
    content = copy.deepcopy(document())
    *parents, last = (int(k) if k.isdigit() else k for k in path.split("."))
    node = content
    for key in parents:
        node = node[key]
    if value is ...:
        del node[last]
    else:
        node[last] = value
    return content


NAN = float("nan")
BOX = "frames.1.views.west.1"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (f"{BOX}.box", [5, 5, 5, 9], "box 1 of camera west in frame 5 is .* x1 < x2"),
        (f"{BOX}.box", [NAN, 5, 6, 9], "'box' of box 1 of camera west in frame 5 is not finite"),
        (f"{BOX}.box", [5, 6, 9], "'box' of box 1 of camera west in frame 5 must hold 4"),
        (f"{BOX}.box", "wide", "'box' of box 1 of camera west in frame 5"),
        (f"{BOX}.box", ..., "box 1 of camera west in frame 5 has no 'box'"),
        (f"{BOX}.score", ..., "box 1 of camera west in frame 5 has no 'score'"),
        (f"{BOX}.score", 1.5, "score of box 1 of camera west in frame 5 is 1.5"),
        (f"{BOX}.kpts", [[1, 2, 3]], "'kpts' of box 1 of camera west in frame 5 must hold 17 x 3"),
        (BOX, 3, "box 1 of camera west in frame 5"),
        ("frames.0.views", {"north": []}, "frame 10 has boxes of camera 'north'"),
        ("frames.0.views", ..., "frame 10 has no 'views'"),
        ("frames.0.views", [], "views of frame 10 must be an object"),
        ("frames.0.frame", 5, "holds frame 5 twice"),
        ("frames.0.frame", 0.5, r"frame of frames\[0\] is 0.5, not a whole"),
        ("frames.0.gt.0.x", NAN, "gt 0 of frame 10 is not finite"),
        ("frames.0.gt.0", {"x": 1}, "gt 0 of frame 10 has no 'y'"),
        ("frames", {}, "frames must be a list"),
        ("units", "cm", "units 'cm'"),
        ("cameras.0.R", LOOKING_EAST[::-1], r"R\[0\] is not a rotation"),
        ("cameras.0.K", [[1, 2], [3, 4]], "camera west must hold 3 x 3"),
        ("cameras.0.t", ..., "camera west has no 't'"),
        ("cameras.1.name", "west", "two cameras the same name"),
        ("cameras.0.dist", [0] * 8 + [1], "camera west has 9 coefficients"),
        ("evaluation_area", {"x": [1]}, "evaluation_area has no 'y'"),
    ],
)
def test_errors_name_file_frame_camera_and_index(path, value, message, tmp_path):
    file = write(tmp_path / "two.json", edit(path, value))
    with pytest.raises(CatFreeError, match=r"two\.json.*" + message):
        read_uniform_json(file)


def test_missing_views_of_another_detector(tmp_path):
    with pytest.raises(FileFormatError, match="frame 10 has no 'views_fairmot'"):
        read_uniform_json(write(tmp_path / "two.json", document()), views="views_fairmot")


def test_embedding_files_are_checked(tmp_path):
    path = write(tmp_path / "two.json", document())
    with pytest.raises(InvalidInputError, match=r"two\.npz"):
        read_uniform_json(path, embedding="osnet")
    np.savez(tmp_path / "two.npz", reid=np.eye(3))
    with pytest.raises(FileFormatError, match=r"no array 'osnet'; it holds reid"):
        read_uniform_json(path, embedding="osnet")
    np.savez(tmp_path / "two.npz", osnet=np.eye(3)[:1])
    with pytest.raises(InvalidInputError, match="box 0 of camera west in frame 5 has emb_index 1"):
        read_uniform_json(path, embedding="osnet")
    np.savez(tmp_path / "two.npz", osnet=np.eye(3))
    between = document()
    between["frames"][1]["views"]["west"][0]["emb_index"] = 0.5
    with pytest.raises(InvalidInputError, match=r"emb_index 0\.5, but"):
        read_uniform_json(write(tmp_path / "two.json", between), embedding="osnet")
    (tmp_path / "two.npz").write_bytes(b"PK\3\4 broken")
    with pytest.raises(FileFormatError, match=r"two\.npz .* not a readable"):
        read_uniform_json(path, embedding="osnet")


def test_a_sequence_without_boxes_has_no_embeddings(tmp_path):
    content = document()
    for frame in content["frames"]:
        frame["views"] = {}
    np.savez(tmp_path / "two.npz", osnet=np.eye(3))
    path = write(tmp_path / "two.json", content)
    assert read_uniform_json(path, embedding="osnet").detections.embedding.shape == (0, 3)


def test_a_world_behind_all_cameras_is_refused(tmp_path):
    content = document()
    for camera, R in zip(content["cameras"], (LOOKING_WEST, LOOKING_EAST), strict=True):
        camera["R"], camera["t"] = R, [0.0, 2.0, -10.0]
    with pytest.raises(InvalidInputError, match="behind every camera"):
        read_uniform_json(write(tmp_path / "two.json", content))


@pytest.mark.slow
@given(where=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_anywhere_is_named(where, tmp_path_factory):
    path = write(tmp_path_factory.mktemp("cut") / "two.json", document())
    text = path.read_text()
    path.write_text(text[: int(where * len(text))])
    with pytest.raises(FileFormatError, match=r"two\.json .* not valid JSON"):
        read_uniform_json(path)


def test_no_file_and_no_text(tmp_path):
    with pytest.raises(InvalidInputError, match=r"no file .*none\.json"):
        read_uniform_json(tmp_path / "none.json")
    (tmp_path / "image.json").write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(FileFormatError, match=r"image\.json .* not readable text"):
        read_uniform_json(tmp_path / "image.json")
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(FileFormatError, match=r"list\.json: the file must be an object"):
        read_uniform_json(tmp_path / "list.json")


REAL = {
    "wildtrack_0_715": (7, 144, 22.3),
    "cmc1": (4, 261, 7.4),
    "cmc3": (4, 263, 7.4),
    "multiviewx_demo10": (6, 10, 22.7),
    "multiviewx_demo10_yolo26x": (6, 10, 22.7),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_sequences(name, shared):
    sequence = read_uniform_json(shared / "data" / "real" / f"{name}.json")
    cameras, frames, extent = REAL[name]
    assert sequence.scene is not None
    assert (sequence.camera_count, len(sequence.frames)) == (cameras, frames)
    assert abs(float(sequence.scene.extent) - extent) < 0.1
    assert np.isin(sequence.detections.frame, sequence.frames).all()
    assert np.isin(sequence.ground_truth[:, 0], sequence.frames).all()
    assert (np.asarray(sequence.scene.rig.centers)[:, 2] > 1).all()  # meters above the ground


def test_true_positions_fall_into_the_annotated_boxes(shared):
    sequence = read_uniform_json(shared / "data" / "real" / "multiviewx_demo10.json")
    assert sequence.rig is not None
    assert sequence.identity is not None
    people = {tuple(row[:2].astype(int)): row[2:] for row in sequence.ground_truth}
    boxes = sequence.detections
    inside = []
    for frame, camera, box, person in zip(
        boxes.frame, boxes.camera, boxes.box, sequence.identity, strict=True
    ):
        point = sequence.rig.K[camera] @ (
            sequence.rig.R[camera] @ [*people[int(frame), int(person)], 0] + sequence.rig.t[camera]
        )
        assert point[2] > 0
        u, v = point[:2] / point[2]
        width, height = box[2] - box[0], box[3] - box[1]
        inside.append(
            abs(u - (box[0] + box[2]) / 2) < 0.5 * width and abs(v - box[3]) < 0.15 * height
        )
    assert np.mean(inside) > 0.98


def test_real_embeddings_and_ankles(shared):
    path = shared / "data" / "real" / "multiviewx_demo10_yolo26x.json"
    for name, width in (("osnet", 512), ("reid0287", 256)):
        boxes = read_uniform_json(path, embedding=name).detections
        assert boxes.embedding is not None
        assert boxes.embedding.shape == (1667, width)
        np.testing.assert_allclose(np.linalg.norm(boxes.embedding, axis=-1), 1, atol=2e-3)
        assert boxes.ankles_confirmed is not None
        assert 0.5 < boxes.ankles_confirmed.mean() < 0.9


@pytest.mark.slow
def test_fairmot_boxes_of_the_room(shared):
    path = shared / "data" / "real" / "cmc1.json"
    assert read_uniform_json(path).detections.score is None
    fairmot = read_uniform_json(path, views="views_fairmot")
    assert fairmot.detections.score is not None
    assert len(fairmot.detections) == 3344
    assert set(fairmot.ground_truth[:, 1]) == {1, 2, 3}
