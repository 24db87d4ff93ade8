import inspect
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linear_sum_assignment

from catfree.adapters import YoloPoseOnnx, ankles_confirmed
from catfree.adapters.detectors._box_suppression import box_overlap
from catfree.adapters.protocols import BatchDetector, Detector
from catfree.errors import FileFormatError, InvalidInputError

SIZES = [(640, 480), (641, 359), (33, 500), (1920, 1080), (97, 101), (7, 5)]


def raw_head(boxes, scores, keypoints=None, classes=1, person=0, anchors=20):
    """Make (4 + classes + 51, anchors) columns: the given cxcywh first, then empty ones."""
    out = np.zeros((4 + classes + 51, anchors), np.float32)
    for i, (box, score) in enumerate(zip(boxes, scores, strict=True)):
        out[:4, i] = box
        out[4 + person, i] = score
        out[-51:, i] = 0 if keypoints is None else np.ravel(keypoints[i])
    return out


def picture_with_red_box(width, height, box):
    image = np.full((height, width, 3), 255, np.uint8)
    x1, y1, x2, y2 = box
    image[y1:y2, x1:x2] = (255, 0, 0)
    return image


# The answer is mapped back to where the network's input puts a picture's content.


@pytest.mark.parametrize(("input_width", "input_height"), [(640, 640), (256, 160), (96, 320)])
def test_a_drawn_person_comes_back_in_original_pixels(red_finder, input_width, input_height):
    detector = YoloPoseOnnx(red_finder(input_width, input_height))
    rng = np.random.default_rng(0)
    for width, height in [(640, 480), (641, 359), (333, 500), (1920, 1080), (397, 401)]:
        x1, y1 = rng.integers(0, [width // 2, height // 2])
        box = np.array([x1, y1, x1 + width // 3, y1 + height // 3])
        found = detector(picture_with_red_box(width, height, box))
        # Resizing blends the edge, so that it is known to one input pixel.
        pixel = max(width / input_width, height / input_height, 1)
        np.testing.assert_allclose(found.box[0], box, atol=pixel)
        np.testing.assert_allclose(found.keypoints[0, :, :2], np.tile(box[2:], (17, 1)), atol=pixel)
        np.testing.assert_allclose(found.score, [0.9])


def test_tiles_find_the_same_place_in_each_window(red_finder):
    detector = YoloPoseOnnx(red_finder(320, 320), tiles=(3, 2))
    box = np.array([700, 500, 760, 640])  # in the overlap of tiles
    found = detector(picture_with_red_box(1283, 717, box))
    assert len(found) == 1
    np.testing.assert_allclose(found.box[0], box, atol=1283 / 320)


@pytest.mark.slow
@given(
    st.integers(1, 1500),
    st.integers(1, 1500),
    st.tuples(*[st.floats(0, 1)] * 4),
)
@settings(max_examples=40)
def test_constant_boxes_map_back_exactly(shared_graphs, width, height, box):
    detector, side = shared_graphs["known"], 640
    scale = min(side / width, side / height)
    shown = np.array([max(1, round(width * scale)), max(1, round(height * scale))])
    pad = (side - shown) // 2
    found = detector(np.zeros((height, width, 3), np.uint8))
    # The graph answers with the input's quarter points, its keypoints with its middle.
    quarter = np.array([side / 4, side / 4, side * 3 / 4, side * 3 / 4])
    expected = (quarter - np.tile(pad, 2)) * np.tile(np.array([width, height]) / shown, 2)
    expected = np.clip(expected, 0, [width, height, width, height])
    np.testing.assert_allclose(found.box[0], expected, atol=1e-4 * max(width, height))
    middle = (side / 2 - pad) * np.array([width, height]) / shown
    np.testing.assert_allclose(found.keypoints[0, 0, :2], middle, atol=1e-4 * max(width, height))


@pytest.fixture
def shared_graphs(constant_graph):
    keypoints = np.tile([320, 320, 0.7], (1, 17, 1))
    head = raw_head([[320, 320, 320, 320]], [0.8], keypoints)
    return {"known": YoloPoseOnnx(constant_graph([1, 3, 640, 640], {"output0": head}))}


# Both heads, classes, open axes, half precision.


def test_overlapping_boxes_are_suppressed_and_weak_ones_dropped(constant_graph):
    boxes = [[100, 100, 40, 80], [102, 100, 40, 80], [300, 300, 40, 80], [500, 500, 40, 80]]
    path = constant_graph([1, 3, 640, 640], {"o": raw_head(boxes, [0.8, 0.9, 0.7, 0.29])})
    found = YoloPoseOnnx(path)(np.zeros((640, 640, 3), np.uint8))
    np.testing.assert_allclose(found.score, [0.9, 0.7], rtol=1e-6)
    np.testing.assert_allclose(found.box, [[82, 60, 122, 140], [280, 260, 320, 340]])


def test_the_end_to_end_head(constant_graph):
    rows = np.zeros((300, 57), np.float32)
    rows[0, :6] = 10, 20, 50, 120, 0.8, 0
    rows[1, :6] = 12, 20, 50, 120, 0.7, 0  # the head suppresses boxes itself, so both stay
    rows[2, :6] = 10, 20, 50, 120, 0.9, 1  # another class
    rows[3, :6] = 10, 20, 50, 120, 0.1, 0
    rows[:, 6:] = np.tile([30, 110, 0.6], 17)
    found = YoloPoseOnnx(constant_graph([1, 3, 640, 640], {"o": rows}))(
        np.zeros((320, 320, 3), np.uint8)
    )
    np.testing.assert_allclose(found.box, [[5, 10, 25, 60], [6, 10, 25, 60]])
    np.testing.assert_allclose(found.keypoints[0, 16], [15, 55, 0.6], rtol=1e-6)
    np.testing.assert_array_equal(ankles_confirmed(found.keypoints), [True, True])


def test_the_person_class_is_found_by_name(constant_graph):
    head = raw_head([[100, 100, 40, 80]], [0.9], classes=3, person=2)
    metadata = {"task": "pose", "names": "{0: 'dog', 1: 'cat', 2: 'person'}"}
    path = constant_graph([1, 3, 640, 640], {"o": head}, metadata=metadata)
    assert len(YoloPoseOnnx(path)(np.zeros((640, 640, 3), np.uint8))) == 1


@pytest.mark.parametrize("open_outputs", [False, True])
@pytest.mark.parametrize("half", [False, True])
def test_open_axes_take_the_size_asked_for(constant_graph, open_outputs, half):
    head = raw_head([[96, 64, 64, 64]], [0.75])
    path = constant_graph(
        ["batch", 3, "height", "width"], {"o": head}, open_outputs=open_outputs, half=half
    )
    found = YoloPoseOnnx(path, image_size=(120, 190))(np.zeros((256, 384, 3), np.uint8))
    np.testing.assert_allclose(found.box, [[128, 64, 256, 192]])  # 128 x 192 input, gain 1/2


def test_open_axes_default_to_the_exporters_size(constant_graph):
    path = constant_graph(
        ["batch", 3, "height", "width"],
        {"o": raw_head([[96, 64, 64, 64]], [0.75])},
        metadata={"imgsz": "[128, 192]"},
    )
    found = YoloPoseOnnx(path)(np.zeros((256, 384, 3), np.uint8))
    np.testing.assert_allclose(found.box, [[128, 64, 256, 192]])


@pytest.mark.parametrize("batch", [1, 3, "batch"])
def test_a_batch_equals_the_pictures_one_by_one(red_finder, batch):
    detector = YoloPoseOnnx(red_finder(160, 160, batch=batch))
    assert isinstance(detector, Detector)
    assert isinstance(detector, BatchDetector)
    images = [
        picture_with_red_box(w, h, [w // 4, h // 4, w // 2 + 2, h // 2 + 2])
        for w, h in [(160, 90), (641, 359), (100, 300), (64, 64)]
    ]
    together = detector.detect_batch(images)
    for image, found in zip(images, together, strict=True):
        alone = detector(image)
        np.testing.assert_array_equal(found.box, alone.box)
        np.testing.assert_array_equal(found.keypoints, alone.keypoints)
    assert detector.detect_batch([]) == []


def test_nobody_gives_no_rows(constant_graph):
    found = YoloPoseOnnx(constant_graph([1, 3, 64, 64], {"o": raw_head([], [])}))(
        np.zeros((9, 8, 3), np.uint8)
    )
    assert found.box.shape == (0, 4)
    assert found.keypoints.shape == (0, 17, 3)


# Wrong files and parameters.


@pytest.mark.parametrize(
    ("input_shape", "value", "found"),
    [
        ([1, 3, 64, 64], np.zeros((84, 8400)), r"\[1, 84, 8400\]"),  # detection, 80 classes
        ([1, 3, 64, 64], np.zeros((39, 8400)), r"\[1, 39, 8400\]"),  # 17 x 2 keypoints
        ([1, 3, 64, 64], np.zeros(512), r"\[1, 512\]"),
        ([1, 1, 64, 64], np.zeros((56, 8400)), r"\[1, 1, 64, 64\]"),
    ],
)
def test_other_networks_are_refused(constant_graph, input_shape, value, found):
    path = constant_graph(input_shape, {"out": value.astype(np.float32)})
    with pytest.raises(FileFormatError, match=found) as caught:
        YoloPoseOnnx(path)
    assert "YOLO pose export" in str(caught.value)


def test_another_task_in_the_metadata_is_refused(constant_graph):
    path = constant_graph([1, 3, 64, 64], {"o": raw_head([], [])}, metadata={"task": "detect"})
    with pytest.raises(FileFormatError, match="task is 'detect'"):
        YoloPoseOnnx(path)


def test_a_fixed_graph_refuses_another_size(constant_graph):
    path = constant_graph([1, 3, 64, 96], {"o": raw_head([], [])})
    with pytest.raises(InvalidInputError, match="fixed to an input of 64 x 96"):
        YoloPoseOnnx(path, image_size=640)
    YoloPoseOnnx(path, image_size=(64, 96))


@pytest.mark.parametrize("options", [{"confidence": 1.5}, {"iou": 0}, {"tiles": 0}])
def test_impossible_parameters(constant_graph, options):
    path = constant_graph([1, 3, 64, 64], {"o": raw_head([], [])})
    with pytest.raises(InvalidInputError):
        YoloPoseOnnx(path, **options)(np.zeros((8, 8, 3), np.uint8))


def test_the_fingerprint_follows_weights_and_parameters(constant_graph):
    path = constant_graph([1, 3, 64, 64], {"o": raw_head([], [])})
    other = constant_graph([1, 3, 64, 64], {"o": raw_head([[9, 9, 9, 9]], [0.9])}, name="b.onnx")
    prints = [
        YoloPoseOnnx(path).fingerprint,
        YoloPoseOnnx(path, confidence=0.5).fingerprint,
        YoloPoseOnnx(path, tiles=2).fingerprint,
        YoloPoseOnnx(other).fingerprint,
    ]
    assert len(set(prints)) == 4
    assert YoloPoseOnnx(path).fingerprint == prints[0]


def test_ankles_need_both_feet():
    keypoints = np.zeros((4, 17, 3))
    keypoints[:, 15, 2] = [0.5, 0.9, 0.2, 0.9]
    keypoints[:, 16, 2] = [0.5, 0.49, 0.9, 0.9]
    np.testing.assert_array_equal(ankles_confirmed(keypoints), [True, False, False, True])
    np.testing.assert_array_equal(ankles_confirmed(keypoints, 0.3), [True, True, False, True])
    assert ankles_confirmed(np.zeros((0, 17, 3))).shape == (0,)
    with pytest.raises(InvalidInputError, match=r"keypoints must have shape \(n, 17, 3\)"):
        inspect.unwrap(ankles_confirmed)(keypoints[0])


# The real network.


def real_picture(shared: Path) -> np.ndarray:
    clips = sorted((shared / "data/real/mmptrack_retail").glob("*.mp4"))
    if not clips:
        pytest.skip("no real clip")
    video = cv2.VideoCapture(str(clips[0]))
    video.set(cv2.CAP_PROP_POS_FRAMES, 200)
    return np.ascontiguousarray(video.read()[1][:, :, ::-1])


@pytest.mark.slow
def test_real_decode_agrees_with_an_independent_one(shared):
    import onnxruntime

    path = shared / "models/yolo11n-pose.onnx"
    image = real_picture(shared)
    height, width = image.shape[:2]
    gain = 640 / width
    canvas = cv2.copyMakeBorder(
        cv2.resize(image, (640, round(height * gain))), 140, 140, 0, 0, cv2.BORDER_CONSTANT,
        value=(114, 114, 114),
    )  # fmt: skip
    blob = cv2.dnn.blobFromImage(canvas, 1 / 255)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    head = session.run(None, {"images": blob})[0][0].T
    xywh = np.concatenate([head[:, :2] - head[:, 2:4] / 2, head[:, 2:4]], axis=1)
    kept = np.ravel(cv2.dnn.NMSBoxes(xywh.tolist(), head[:, 4].tolist(), 0.30, 0.7))
    expected = xywh[kept] - [0, 140, 0, 0]
    found = YoloPoseOnnx(path)(image)
    assert len(found) == len(kept) >= 3
    np.testing.assert_allclose(found.score, head[kept, 4], rtol=1e-4)
    np.testing.assert_allclose(
        found.box,
        np.clip(np.concatenate([expected[:, :2], expected[:, :2] + expected[:, 2:]], 1) / gain,
                0, [width, height, width, height]),
        atol=1e-2,
    )  # fmt: skip
    np.testing.assert_allclose(
        found.keypoints[:, 3, :2], (head[kept][:, 14:16] - [0, 140]) / gain, atol=1e-2
    )


@pytest.mark.slow
def test_real_network_finds_shrunken_people_only_in_tiles(shared):
    path = shared / "models/yolo11n-pose.onnx"
    image = real_picture(shared)
    canvas = np.full((1440, 2560, 3), 114, np.uint8)
    people = YoloPoseOnnx(path, confidence=0.5)(image)
    # The picture stands small in a corner of a large one, inside one tile.
    small = cv2.resize(image, (320, 180), interpolation=cv2.INTER_AREA)
    canvas[700:880, 1700:2020] = small
    expected = people.box / 2 + np.array([1700, 700, 1700, 700])
    recalls = []
    for tiles in (None, 4):
        found = YoloPoseOnnx(path, tiles=tiles)(canvas)
        overlap = box_overlap(expected.astype(np.float32), found.box.astype(np.float32))
        recalls.append(float((overlap.max(axis=1, initial=0) > 0.5).mean()))
    assert recalls[1] >= 0.75
    assert recalls[1] > recalls[0]


def annotated_pictures(shared: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Read the MultiviewX pictures of one instant as RGB, and the boxes of all people in each."""
    data = shared / "data/real"
    frame = json.loads((data / "multiviewx_demo10.json").read_text())["frames"][0]
    pictures = []
    for camera, name in frame["images"].items():
        place = data / "multiviewx_demo10_original" / Path(name).relative_to("multiviewx")
        file = next(place.parent.glob(place.stem + ".*"), None)
        if file is None:
            pytest.skip("no MultiviewX pictures")
        image = cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB)
        boxes = np.array([view["box"] for view in frame["views"][camera]], np.float32)
        pictures.append((image, boxes))
    return pictures


@pytest.mark.slow
def test_finer_tiles_find_more_people_and_nobody_twice(shared):
    """People in these pictures are 46 px tall in the network's input, 83 and 120 px in tiles."""
    pictures = annotated_pictures(shared)
    recall = []
    for tiles in (None, 2, 3):
        detector = YoloPoseOnnx(shared / "models/yolo11n-pose.onnx", tiles=tiles, iou=0.5)
        people = 0
        for image, boxes in pictures:
            found = detector(image).box
            # One box per person: the same person in several windows is one detection.
            assert np.triu(box_overlap(found, found), 1).max(initial=0) <= 0.5
            shows = box_overlap(boxes, found) > 0.5
            people += shows[linear_sum_assignment(shows, maximize=True)].sum()
        recall.append(people)
    assert recall[0] < recall[1] < recall[2]
