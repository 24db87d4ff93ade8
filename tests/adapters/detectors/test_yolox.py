import cv2
import numpy as np
import pytest

from catfree.adapters import YoloPoseOnnx, YoloxOnnx
from catfree.adapters.detectors._box_suppression import box_overlap
from catfree.errors import FileFormatError

ANCHORS_64 = 8 * 8 + 4 * 4 + 2 * 2


def head(anchor, values):
    out = np.zeros((ANCHORS_64, 85), np.float32)
    out[anchor, : len(values)] = values
    return out


def test_anchors_of_each_stride_decode_by_hand(constant_graph):
    out = np.zeros((ANCHORS_64, 85), np.float32)
    # offset, log size, object, person; row 1, column 2 of the stride-8 grid
    out[1 * 8 + 2, :6] = 0.5, 0.25, np.log(2), np.log(3), 0.9, 0.8
    # row 0, column 1 of the stride-32 grid
    out[64 + 16 + 1, :6] = 0.5, 0.5, np.log(0.5), np.log(0.5), 0.8, 0.5
    out[30, :8] = 0, 0, 1, 1, 0.9, 0.1, 0.9, 0.9  # another class
    path = constant_graph([1, 3, 64, 64], {"output": out})
    found = YoloxOnnx(path)(np.zeros((64, 64, 3), np.uint8))
    np.testing.assert_allclose(found.score, [0.72, 0.4], rtol=1e-6)
    np.testing.assert_allclose(
        found.box, [[20 - 8, 10 - 12, 28, 22], [40, 8, 56, 24]] * np.array([[1, 0, 1, 1], [1] * 4])
        + np.zeros((2, 4)), atol=1e-4,
    )  # fmt: skip
    assert found.keypoints is None


@pytest.mark.parametrize(("width", "height"), [(128, 128), (127, 51), (31, 90)])
def test_the_letterbox_starts_at_the_top_left(constant_graph, width, height):
    out = head(0, [1, 1, np.log(1), np.log(1), 1, 1])  # center (8, 8), size 8
    path = constant_graph([1, 3, 64, 64], {"output": out})
    found = YoloxOnnx(path)(np.zeros((height, width, 3), np.uint8))
    scale = min(64 / width, 64 / height)
    factor = np.array([width / round(width * scale), height / round(height * scale)])
    expected = np.array([4, 4, 12, 12]) * np.tile(factor, 2)
    np.testing.assert_allclose(
        found.box[0], np.clip(expected, 0, [width, height, width, height]), atol=1e-3
    )


def test_huge_logarithms_stay_finite(constant_graph):
    path = constant_graph([1, 3, 64, 64], {"output": head(0, [0, 0, 500, 500, 1, 1])})
    found = YoloxOnnx(path)(np.zeros((32, 32, 3), np.uint8))
    np.testing.assert_allclose(found.box, [[0, 0, 32, 32]])


def test_other_networks_are_refused(constant_graph):
    path = constant_graph([1, 3, 64, 64], {"out": np.zeros((99, 85), np.float32)})
    with pytest.raises(FileFormatError, match="84 anchors were expected"):
        YoloxOnnx(path)


@pytest.mark.slow
def test_the_real_network_sees_what_the_pose_network_sees(shared):
    clips = sorted((shared / "data/real/mmptrack_retail").glob("*.mp4"))
    if not clips:
        pytest.skip("no real clip")
    video = cv2.VideoCapture(str(clips[0]))
    video.set(cv2.CAP_PROP_POS_FRAMES, 200)
    image = np.ascontiguousarray(video.read()[1][:, :, ::-1])
    found = YoloxOnnx(shared / "models/yolox_nano_416.onnx", confidence=0.5)(image)
    pose = YoloPoseOnnx(shared / "models/yolo11n-pose.onnx")(image)
    assert len(found) >= 3
    assert (box_overlap(found.box, pose.box).max(axis=1) > 0.7).all()
