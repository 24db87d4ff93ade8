import inspect

import cv2
import numpy as np
import pytest

from catfree.adapters import (
    BackgroundDetector,
    ColorEmbedder,
    FrameDetections,
    SynchronizedVideos,
    YoloPoseOnnx,
    detect_videos,
)
from catfree.adapters.video._detect_videos import detect_instant
from catfree.adapters.video._validate_plugin_output import Describer
from catfree.errors import InsufficientDataError, InvalidInputError


class BrightSpot:
    """A detector that boxes the bright pixels: ten lines are enough to plug one in."""

    fingerprint = "bright spot"

    def __call__(self, image):
        rows, columns = np.nonzero(image[:, :, 0] > 200)
        if not rows.size:
            return FrameDetections(np.zeros((0, 4)), np.zeros(0))
        box = [columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0]
        return FrameDetections([box], [0.9])


def write_folders(path, cameras=2, frames=12):
    """Draw a red block on gray that moves to the right and is gone in every fourth frame."""
    for camera in range(cameras):
        (path / f"c{camera}").mkdir()
        for frame in range(frames):
            image = np.full((60, 100 + 10 * camera, 3), 90, np.uint8)
            if frame % 4:
                image[20:50, 5 * frame : 5 * frame + 12] = (40, 60, 255)
            cv2.imwrite(str(path / f"c{camera}/{frame:03d}.png"), image)
    return SynchronizedVideos([path / f"c{camera}" for camera in range(cameras)])


def test_rows_come_in_order_of_frame_and_camera(tmp_path):
    videos = write_folders(tmp_path)
    calls = []
    found = detect_videos(
        videos, BrightSpot(), ColorEmbedder(), progress=lambda *call: calls.append(call)
    )
    expected = [frame for frame in range(12) if frame % 4]
    np.testing.assert_array_equal(found.frame, np.repeat(expected, 2))
    np.testing.assert_array_equal(found.camera, np.tile([0, 1], len(expected)))
    np.testing.assert_array_equal(found.box[:, 0], 5 * found.frame)
    assert found.embedding is not None
    np.testing.assert_allclose(np.linalg.norm(found.embedding, axis=1), 1, rtol=1e-5)
    assert found.keypoints is None
    assert found.ankles_confirmed is None
    assert calls == [("detect", done, 12) for done in range(1, 13)]


def test_nobody_at_all(tmp_path):
    videos = write_folders(tmp_path, frames=1)
    found = detect_videos(videos, BrightSpot(), ColorEmbedder())
    assert len(found) == 0
    assert found.box.shape == (0, 4)


def test_no_picture_that_can_be_decoded(tmp_path):
    write_folders(tmp_path, cameras=1)
    (tmp_path / "c0/005.png").write_bytes(b"broken")
    videos = SynchronizedVideos([tmp_path / "c0"], start=5, on_error="keep")
    with pytest.raises(InsufficientDataError, match=r"No instant .*frame 5"):
        detect_videos(videos, BrightSpot())


@pytest.mark.slow
def test_a_pose_network_sees_all_cameras_at_once(tmp_path, red_finder):
    videos = write_folders(tmp_path)
    found = detect_videos(videos, YoloPoseOnnx(red_finder(128, 64, batch="batch")))
    expected = detect_videos(videos, BrightSpot())
    np.testing.assert_array_equal(found.frame, expected.frame)
    np.testing.assert_allclose(found.box, expected.box, atol=1.5)
    assert found.keypoints.shape == (len(found), 17, 3)
    assert found.ankles_confirmed.all()


@pytest.mark.slow
def test_a_background_detector_is_fitted_to_each_camera(tmp_path):
    videos = write_folders(tmp_path, frames=24)
    calls = []
    detector = BackgroundDetector()
    found = detect_videos(videos, detector, progress=lambda *call: calls.append(call))
    assert [call[0] for call in calls] == ["fit"] * 48 + ["detect"] * 24
    assert calls[47] == ("fit", 48, 48)
    assert set(found.camera.tolist()) == {0, 1}
    assert len(found) >= 0.8 * 2 * 18
    (tmp_path / "short").mkdir()
    short = write_folders(tmp_path / "short", frames=4)
    with pytest.raises(
        InsufficientDataError, match=r"Camera 0 \('c0'\): .*at least 8.*longer footage"
    ):
        detect_videos(short, detector)


@pytest.mark.slow
def test_a_camera_with_too_few_pictures_finds_nobody_and_stops_no_other(tmp_path):
    videos = write_folders(tmp_path, cameras=3, frames=24)
    whole = detect_videos(videos, BackgroundDetector())
    for late in sorted((tmp_path / "c1").glob("*.png"))[4:]:
        late.unlink()
    with pytest.raises(InsufficientDataError, match="at least 8"):
        detect_videos(
            SynchronizedVideos([one.path for one in videos.footage]), BackgroundDetector()
        )
    short = SynchronizedVideos([one.path for one in videos.footage], fewest_cameras=2)
    calls = []
    found = detect_videos(short, BackgroundDetector(), progress=lambda *call: calls.append(call))
    assert set(found.camera.tolist()) == {0, 2}
    others = whole[whole.camera != 1]
    np.testing.assert_array_equal(found.frame, others.frame)
    np.testing.assert_array_equal(found.box, others.box)
    assert [call for call in calls if call[0] == "fit"][-1] == ("fit", 52, 52)


class Answers:
    """A detector and embedder that answers well until it sees the bright block."""

    fingerprint = "answers"

    def __init__(self, people=None, vectors=None):
        self.people, self.vectors, self.nobody = people, vectors, np.zeros((0, 3))

    def __call__(self, image, box=None):
        if box is None:
            return self.people if (image[:, :, 0] > 200).any() else BrightSpot()(image)
        return self.vectors if len(box) else self.nobody


class Batch(Answers):
    def detect_batch(self, images):
        return self.people


@pytest.mark.parametrize(
    ("people", "message"),
    [
        ([[0, 0, 1, 1]], "returned a value of type list; it must return FrameDetections"),
        (None, "returned nothing; it must return FrameDetections"),
        (np.zeros((1, 4)), r"returned an array of shape \(1, 4\)"),
    ],
)
def test_detectors_that_answer_something_else_are_named(people, message, tmp_path):
    videos = write_folders(tmp_path)
    with pytest.raises(
        InvalidInputError, match="Answers, called for camera 0 at frame 1, " + message
    ):
        detect_videos(videos, Answers(people))
    frame, pictures = next(videos.pictures_from(1))
    with pytest.raises(
        InvalidInputError, match="Answers, called for camera 1 at frame 1, " + message
    ):
        detect_instant(pictures, [BrightSpot(), Answers(people)], frame)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (BackgroundDetector, r"is the class BackgroundDetector. Pass an instance of it: Backg"),
        ("yolox.onnx", "must be a callable such as those of catfree.adapters, got 'yolox.onnx'"),
    ],
)
def test_what_is_no_detector_or_embedder_is_named(part, message, tmp_path):
    unchecked = inspect.unwrap(detect_videos)  # bypass the tests' type checks
    videos = write_folders(tmp_path, frames=1)
    with pytest.raises(InvalidInputError, match="^detector " + message):
        unchecked(videos, part)
    with pytest.raises(InvalidInputError, match="^embedder " + message):
        unchecked(videos, BrightSpot(), part)


def test_boxes_that_are_none_name_their_picture(tmp_path):
    class Upside(BrightSpot):
        def __call__(self, image):
            found = super().__call__(image)
            return FrameDetections(found.box[:, [2, 3, 0, 1]], found.score)

    message = r"Upside, called for camera 0 at frame 1, failed: box\[0\] is"
    with pytest.raises(InvalidInputError, match=message):
        detect_videos(write_folders(tmp_path), Upside())


def test_batches_have_an_answer_a_picture(tmp_path):
    videos, nobody = write_folders(tmp_path), FrameDetections(np.zeros((0, 4)), np.zeros(0))
    for answers in ([nobody], None):
        with pytest.raises(InvalidInputError, match=r"2 pictures of frame 0, must return 2"):
            detect_videos(videos, Batch(answers))
    with pytest.raises(InvalidInputError, match="at frame 0, returned a value of type dict"):
        detect_videos(videos, Batch([nobody, {}]))


@pytest.mark.parametrize(
    ("vectors", "message"),
    [
        (None, "returned nothing for 1 boxes"),
        ([], "returned a value of type list for 1 boxes"),
        (np.zeros((2, 3)), r"returned an array of shape \(2, 3\) for 1 boxes.*\(1, D\)"),
        (np.zeros((1, 0)), r"shape \(1, 0\)"),
        ([["a"]], "failed: Expected numbers"),
        ([[np.nan]], "returned NaN or infinity"),
    ],
)
def test_embedders_that_answer_something_else_are_named(vectors, message, tmp_path):
    videos = write_folders(tmp_path)
    with pytest.raises(
        InvalidInputError, match="Answers, called for camera 0 at frame 1.*" + message
    ):
        detect_videos(videos, BrightSpot(), Answers(vectors=vectors))


def test_all_rows_of_an_embedder_are_of_one_length():
    embedder = Answers(vectors=np.ones((1, 3)))
    describe, picture = Describer(embedder), np.zeros((4, 4, 3), np.uint8)
    box = np.array([[0.0, 0, 1, 1]])
    assert describe(picture, box[:0], 0, 0).shape == (0, 3)
    assert describe(picture, box, 0, 1).shape == (1, 3)
    assert describe(picture, box[:0], 0, 2).shape == (0, 3)
    embedder.nobody = np.zeros((0, 0))
    assert describe(picture, box[:0], 0, 2).shape == (0, 3)
    embedder.vectors = None
    with pytest.raises(InvalidInputError, match="returned nothing"):
        describe(picture, box, 0, 2)
    embedder.vectors = np.ones((1, 4))
    with pytest.raises(InvalidInputError, match=r"\(1, 4\) for 1 boxes; .* \(1, 3\)"):
        describe(picture, box, 5, 3)


@pytest.mark.slow
def test_real_clips_give_real_people(shared):
    clips = sorted((shared / "data/real/mmptrack_retail").glob("*.mp4"))
    if not clips:
        pytest.skip("no real clips")
    videos = SynchronizedVideos(clips, stride=140)
    found = detect_videos(videos, YoloPoseOnnx(shared / "models/yolo11n-pose.onnx"))
    assert set(found.camera.tolist()) == {0, 1, 2}
    assert len(found) >= 9
    assert found.ankles_confirmed.any()


def test_an_embedder_that_changes_its_boxes_moves_nobody(tmp_path):
    class Widening(Answers):
        def __call__(self, image, box):
            box[:, 0] -= 5
            return np.ones((len(box), 3))

    videos = write_folders(tmp_path)
    plain, embedded = (detect_videos(videos, BrightSpot(), e) for e in (None, Widening()))
    np.testing.assert_array_equal(embedded.box, plain.box)


def test_a_fit_that_returns_no_detector_names_its_camera(tmp_path):
    class Forgetful(BrightSpot):
        def fit(self, pictures):
            list(pictures)

    with pytest.raises(InvalidInputError, match=r"Forgetful.fit returned NoneType for camera 0"):
        detect_videos(write_folders(tmp_path), Forgetful())
