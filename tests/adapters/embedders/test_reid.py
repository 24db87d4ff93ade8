import cv2
import numpy as np
import onnx
import pytest
from hypothesis import given, strategies as st
from onnx import helper

from catfree.adapters import Embedder, ReIdOnnx
from catfree.adapters.embedders._crops import clip_boxes
from catfree.errors import FileFormatError, InvalidInputError


@pytest.fixture
def mean_colour(tmp_path):
    """Write a graph whose vector is the mean color of its input: it shows the network's input."""

    def write(batch=1, producer="pytorch"):
        graph = helper.make_graph(
            [helper.make_node("ReduceMean", ["in"], ["out"], axes=[2, 3], keepdims=0)],
            "graph",
            [helper.make_tensor_value_info("in", 1, [batch, 3, 256, 128])],
            [helper.make_tensor_value_info("out", 1, [batch, 3])],
        )
        model = helper.make_model(
            graph,
            producer_name=producer,
            opset_imports=[helper.make_opsetid("", 17)],
            ir_version=8,
        )
        path = tmp_path / f"mean_{batch}_{producer}.onnx"
        onnx.save(model, path)
        return path

    return write


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


IMAGE = np.zeros((60, 50, 3), np.uint8)
IMAGE[:, :25] = (200, 100, 50)
IMAGE[:, 25:] = (10, 20, 30)
BOXES = np.array([[2, 5, 22, 55], [27, 5, 48, 55.0]])


@pytest.mark.parametrize("batch", [1, 3, "batch"])
def test_the_two_conventions_of_the_input(mean_colour, batch):
    raw = ReIdOnnx(mean_colour(batch, "openvino2onnx"))
    assert isinstance(raw, Embedder)
    assert raw.preprocessing == "bgr_raw"
    np.testing.assert_allclose(
        raw(IMAGE, BOXES), [unit([50, 100, 200]), unit([30, 20, 10])], rtol=1e-5
    )
    scaled = ReIdOnnx(mean_colour(batch))
    assert scaled.preprocessing == "rgb_imagenet"
    mean, deviation = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    expected = [
        unit((np.array(rgb) / 255 - mean) / deviation) for rgb in ([200, 100, 50], [10, 20, 30])
    ]
    np.testing.assert_allclose(scaled(IMAGE, BOXES), expected, rtol=1e-4)
    declared = ReIdOnnx(mean_colour(batch), preprocessing="bgr_raw")
    np.testing.assert_array_equal(declared(IMAGE, BOXES), raw(IMAGE, BOXES))
    assert declared.fingerprint != scaled.fingerprint


def test_crops_end_at_the_border(mean_colour):
    embed = ReIdOnnx(mean_colour(), preprocessing="bgr_raw")
    inside = embed(IMAGE, [[0, 0, 25, 60]])
    np.testing.assert_allclose(embed(IMAGE, [[-40, -9, 25, 90]]), inside)
    np.testing.assert_allclose(embed(IMAGE, [[-40.0, -9, -20, 90]]), inside, rtol=1e-5)


@given(
    st.integers(1, 40), st.integers(1, 40),
    st.lists(st.tuples(*[st.floats(-99, 99)] * 4), max_size=5),
)  # fmt: skip
def test_clipped_boxes_hold_a_pixel_of_the_picture(width, height, boxes):
    clipped = clip_boxes(np.array(boxes).reshape(-1, 4), width, height)
    assert clipped.shape == (len(boxes), 4)
    assert (clipped[:, :2] >= 0).all()
    assert (clipped[:, 2:] <= [width, height]).all()
    assert (clipped[:, 2:] > clipped[:, :2]).all()


@pytest.mark.parametrize("open_outputs", [False, True])
def test_no_boxes_give_no_rows_of_the_right_width(constant_graph, open_outputs):
    path = constant_graph([1, 3, 256, 128], {"o": np.ones(7)}, open_outputs=open_outputs)
    assert ReIdOnnx(path)(IMAGE, np.zeros((0, 4))).shape == (0, 7)


@pytest.mark.parametrize("open_outputs", [False, True])
def test_pooled_maps_are_vectors_and_other_maps_are_not(constant_graph, open_outputs):
    pooled = np.array([3.0, 4.0])[:, None, None]
    path = constant_graph([1, 3, 256, 128], {"o": pooled}, open_outputs=open_outputs)
    np.testing.assert_allclose(ReIdOnnx(path)(IMAGE, BOXES), [[0.6, 0.8], [0.6, 0.8]])
    path = constant_graph([1, 3, 256, 128], {"o": np.ones((2, 5, 1))}, open_outputs=open_outputs)
    with pytest.raises(FileFormatError, match=r"maps|\[1, 2, 5, 1\]"):
        ReIdOnnx(path)(IMAGE, BOXES)


def test_a_zero_vector_still_becomes_a_unit(constant_graph):
    path = constant_graph([1, 3, 256, 128], {"o": np.zeros(4)})
    np.testing.assert_array_equal(ReIdOnnx(path)(IMAGE, BOXES[:1]), [[1, 0, 0, 0]])


def test_wrong_files_and_parameters(constant_graph, mean_colour):
    with pytest.raises(FileFormatError, match=r"\[1, 56, 10\]"):
        ReIdOnnx(constant_graph([1, 3, 256, 128], {"o": np.zeros((56, 10))}))
    with pytest.raises(InvalidInputError, match="box must have shape"):
        ReIdOnnx(mean_colour())(IMAGE, np.zeros((3, 5)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "dimension", "preprocessing"),
    [
        ("osnet_x0_25_msmt17.onnx", 512, "rgb_imagenet"),
        ("person-reidentification-retail-0287.onnx", 256, "bgr_raw"),
    ],
)
def test_real_networks_know_a_person_again(shared, name, dimension, preprocessing):
    embed = ReIdOnnx(shared / "models" / name)
    assert embed.preprocessing == preprocessing
    clips = sorted((shared / "data/real/mmptrack_retail").glob("*.mp4"))
    if not clips:
        pytest.skip("no real clip")
    video = cv2.VideoCapture(str(clips[0]))
    images = []
    for frame in (200, 203):
        video.set(cv2.CAP_PROP_POS_FRAMES, frame)
        images.append(np.ascontiguousarray(video.read()[1][:, :, ::-1]))
    # Three people who hardly move within three frames.
    boxes = np.array([[40, 193, 153, 358], [357, 131, 416, 270], [165, 230, 299, 359]])
    first, second = (embed(image, boxes) for image in images)
    assert first.shape == (3, dimension)
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1, rtol=1e-5)
    distance = 1 - first @ second.T
    same, other = np.diag(distance), distance[~np.eye(3, dtype=bool)]
    assert same.max() < 0.5 * other.min()
