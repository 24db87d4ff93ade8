import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.adapters import Reconstructor, VggtOnnx
from catfree.adapters.reconstructors._vggt import decode_pose
from catfree.errors import FileFormatError, InvalidInputError

QUATERNION = [0.1, -0.3, 0.2, 0.9]


def answers(width, height, *, pose=(1, 2, 3, *QUATERNION, 0.8, 1.1), confidence=None):
    """Make the fake network's answer for each view; points contain their column and row."""
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    return {
        "pose_enc": np.array(pose, np.float32),
        "world_points": np.stack([columns, rows, np.ones_like(rows)], axis=-1),
        "world_points_conf": np.full((height, width), 2.0) if confidence is None else confidence,
    }


@pytest.fixture
def make(constant_graph):
    def write(width=168, height=112, views="views", mode="crop", **options):
        known = {k: options.pop(k) for k in ("pose", "confidence") if k in options}
        path = constant_graph([1, views, 3, height, width], answers(width, height, **known), lead=2)
        return VggtOnnx(path, mode, **options)

    return write


def blank(width, height):
    return np.zeros((height, width, 3), np.uint8)


def project(K, R, t, point):
    camera = K @ (R @ point + t)
    return camera[:2] / camera[2]


@pytest.mark.parametrize("mode", ["crop", "pad"])
@pytest.mark.parametrize("size", [(1920, 1080), (641, 359), (333, 500), (97, 1201), (50, 33)])
def test_a_point_projects_to_the_same_spot_of_the_picture(make, mode, size):
    """Pixels of the network's input map to the same spots of the original picture."""
    reconstructor = make(mode=mode)
    assert isinstance(reconstructor, Reconstructor)
    result = reconstructor([blank(*size), blank(640, 480)])
    (placement, _), target = reconstructor.preprocess([size, (640, 480)])
    assert target == (168, 112)
    K_input, R, t, _ = decode_pose(np.array([[1, 2, 3, *QUATERNION, 0.8, 1.1]]), target)
    for point in np.random.default_rng(0).normal([0, 0, 6], 1, (5, 3)):
        np.testing.assert_allclose(
            project(result.K[0], result.R[0], result.t[0], point),
            placement.to_original(project(K_input[0], R[0], t[0], point)),
            atol=1e-3 * max(size),
        )
    # The principal point is the middle of the picture to within half an input pixel of padding.
    np.testing.assert_allclose(
        result.K[0][:2, 2], np.array(size) / 2, atol=0.5 * max(size) / 112 + 1e-9
    )


def test_intrinsics_by_hand(make):
    """640 x 480 fills 168 columns with 126 rows, of which 7 are cut at top and bottom."""
    result = make(pose=(0, 0, 0, 0, 0, 0, 1, 0.8, 1.1))([blank(640, 480)])
    fx, fy = 84 / np.tan(0.55) * 640 / 168, 56 / np.tan(0.4) * 480 / 126
    np.testing.assert_allclose(
        result.K[0], [[fx, 0, 320], [0, fy, 240], [0, 0, 1]], rtol=1e-6, atol=1e-9
    )


@given(
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.floats(0.2, 2.5),
    st.floats(0.2, 2.5),
)
def test_pose_decoding_agrees_with_scipy(quaternion, vertical, horizontal):
    K, R, t, determined = decode_pose(
        np.array([[1, 2, 3, *quaternion, vertical, horizontal]]), (200, 100)
    )
    np.testing.assert_allclose(R[0], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(t, [[1, 2, 3]])
    np.testing.assert_allclose(2 * np.arctan(50 / K[0, 1, 1]), vertical)
    np.testing.assert_allclose(2 * np.arctan(100 / K[0, 0, 0]), horizontal)
    assert determined.all()


@pytest.mark.parametrize(
    "pose",
    [
        (0, 0, 0, 0, 0, 0, 1, 0, 0),
        (0, 0, 0, 0, 0, 0, 0, 1, 1),
        (np.nan, 0, 0, 0, 0, 0, 1, 1, 1),
        (0, 0, 0, np.nan, 0, 0, 1, 1, 1),
        (0, 0, 0, 0, 0, 0, 1, np.inf, 1),
        (0, 0, 0, 0, 0, 0, 1, 4, 1),
    ],
)
def test_an_undetermined_camera_is_flagged_and_finite(make, pose):
    result = make(pose=pose)([blank(64, 48)])
    assert not result.registered.any()
    assert np.isfinite(result.K).all()
    np.testing.assert_allclose(np.linalg.det(result.R), 1)


@pytest.mark.parametrize(
    ("mode", "size", "shown"),
    [
        ("crop", (640, 260), (168, 70)),
        ("pad", (100, 300), (42, 112)),
        ("crop", (50, 50), (168, 112)),
    ],
)
def test_the_cloud_shows_the_picture_only(make, mode, size, shown):
    result = make(mode=mode)([blank(*size)])
    assert len(result.points) == shown[0] * shown[1]
    low = (np.array([168, 112]) - shown) // 2
    np.testing.assert_array_equal(result.points[:, :2].min(axis=0), low)
    np.testing.assert_array_equal(result.points[:, :2].max(axis=0), low + shown - 1)
    np.testing.assert_array_equal(result.confidence, np.full(len(result.points), 2))


def test_the_cloud_is_thinned_evenly_and_holds_no_nonsense(make):
    confidence = np.full((112, 168), 2.0)
    confidence[:56], confidence[56, :3] = 0, np.nan
    result = make(confidence=confidence, maximum_points=500)([blank(168, 112)] * 2)
    assert len(result.points) == 500
    assert (result.confidence == 2).all()
    assert result.points[:, 1].min() >= 56
    assert abs(result.points[:, 1].mean() - 83.5) < 1


def test_open_sizes_follow_the_pictures(constant_graph):
    path = constant_graph([1, "s", 3, "h", "w"], answers(14, 14), lead=2, open_outputs=True)
    crop, pad = VggtOnnx(path), VggtOnnx(path, "pad")
    placements, target = crop.preprocess([(1920, 1080), (640, 200)])
    assert target == (518, 294)
    assert [p.size for p in placements] == [(518, 294), (518, 168)]
    assert crop.preprocess([(100, 900)])[1] == (518, 518)
    placements, target = pad.preprocess([(1920, 1080), (200, 640)])
    assert target == (518, 518)
    assert [p.size for p in placements] == [(518, 294), (168, 518)]


def test_wrong_calls(make, constant_graph):
    with pytest.raises(InvalidInputError, match="at least 1 pictures"):
        make()([])
    with pytest.raises(InvalidInputError, match="needs 2 pictures at once, got 3"):
        make(views=2)([blank(8, 8)] * 3)
    outputs = answers(28, 28)
    outputs.pop("world_points")
    with pytest.raises(FileFormatError, match="pose_enc"):
        VggtOnnx(constant_graph([1, "s", 3, 28, 28], outputs, lead=2))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vggt_tiny_random_112x168.onnx", "vggt_tiny_random_294x518.onnx"])
@pytest.mark.parametrize("mode", ["crop", "pad"])
def test_the_real_graphs_contract(shared, name, mode):
    reconstructor = VggtOnnx(shared / "models" / name, mode, maximum_points=20_000)
    rng = np.random.default_rng(1)
    images = [rng.integers(0, 255, (h, w, 3), np.uint8) for w, h in [(320, 180), (101, 97)]]
    result = reconstructor(images)
    assert result.K.shape == (2, 3, 3)
    assert len(result.points) == len(result.confidence) <= 20_000
    assert (result.confidence >= 1).all()
    assert not result.scale_is_metric
    assert len(result.weights_id) == 64
    again = reconstructor(images)
    np.testing.assert_array_equal(again.points, result.points)
    np.testing.assert_array_equal(again.t, result.t)
