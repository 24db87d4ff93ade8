"""Every number of worker processes sees what one process sees, and ends as it ends."""

import os
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

import catfree as cf
from catfree._run._cached_detection import detect_with_cache
from catfree._run._camera_detectors import CHUNK, CameraDetectors
from catfree._run._second_look import ExpectedPeople, look_again
from catfree.adapters import BackgroundDetector, ColorEmbedder, FrameDetections, SynchronizedVideos
from catfree.errors import CatFreeError, InvalidInputError
from tests.run.test_run import same_content

CAMERAS, FRAMES = 3, 3 * CHUNK + 2


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Somebody walks through the pictures of each camera; one misses a picture."""
    rng = np.random.default_rng(0)
    paths = [tmp_path_factory.mktemp(f"camera{camera}") for camera in range(CAMERAS)]
    for camera, folder in enumerate(paths):
        empty = rng.integers(90, 110, (90, 160, 3)).astype(np.uint8)
        kept = [frame for frame in range(FRAMES) if (camera, frame) != (1, 4)]
        for frame in kept:
            image = empty.copy()
            image[30:70, 7 * frame + camera : 7 * frame + 14 + camera] = 250
            cv2.imwrite(str(folder / f"{frame:02d}.png"), image)
        times = "".join(f"{at},{frame / 5}\n" for at, frame in enumerate(kept))
        (folder / "timestamps.csv").write_text(f"frame_id,timestamp_s\n{times}")
    return paths


def both_looks(videos, workers):
    expected = ExpectedPeople(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))
    with CameraDetectors(videos, BackgroundDetector(), workers=workers) as cameras:
        found = detect_with_cache(videos, cameras, ColorEmbedder(), None)
        again = look_again(videos, cameras, ColorEmbedder(), expected, found)
    return found, again


@pytest.mark.slow
def test_any_number_of_workers_finds_the_same(folders):
    videos = SynchronizedVideos(folders, fewest_cameras=2)
    assert len(videos.silent) == 1
    expected = both_looks(videos, 1)
    assert len(expected[0]) > FRAMES
    for one, other in zip(expected, both_looks(videos, 8), strict=True):
        assert same_content(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("broken", [CHUNK, CHUNK + 1, FRAMES - 1])
def test_damaged_footage_ends_where_it_ends_in_one_process(tmp_path, folders, broken):
    paths = []
    for camera, folder in enumerate(folders[::2]):
        paths.append(tmp_path / str(camera))
        paths[-1].mkdir()
        for picture in folder.glob("*.png"):
            (paths[-1] / picture.name).write_bytes(picture.read_bytes())
    videos = SynchronizedVideos(paths, on_error="keep")
    fitted = CameraDetectors(videos, BackgroundDetector()).fitted
    (paths[1] / f"{broken:02d}.png").write_bytes(b"no picture")
    found, said = [], []
    for workers in (1, 2):
        with CameraDetectors(videos, BackgroundDetector(), workers=workers) as cameras:
            cameras.__dict__["fitted"] = fitted
            found.append(detect_with_cache(videos, cameras, None, None))
        said.append(str(videos.interruption))
    assert found[0].frame.max() == broken - 1
    assert same_content(*found)
    assert said[0] == said[1]
    assert "cannot be decoded" in said[0]


@dataclass
class Fitted:
    """Finds a box or, in one camera, something else from one picture on."""

    fingerprint: str
    wrong_from: int
    calls: int = 0

    def __call__(self, image):
        self.calls += 1
        if self.calls > self.wrong_from:
            return "nobody"
        return FrameDetections(np.array([[1.0, 1, 9, 20]]), np.ones(1))


@dataclass
class Fits:
    """A detector fitted to each camera."""

    fingerprint: str
    wrong_from: int

    def fit(self, images):
        return Fitted(self.fingerprint, self.wrong_from)


@pytest.mark.slow
def test_a_worker_reports_a_wrong_answer_with_camera_and_frame(folders):
    videos = SynchronizedVideos(folders[::2])
    with (
        CameraDetectors(videos, Fits("wrong", CHUNK + 2), workers=2) as cameras,
        pytest.raises(InvalidInputError, match=rf"camera 0 at frame {CHUNK + 2},.*a str"),
    ):
        detect_with_cache(videos, cameras, None, None)


@pytest.mark.slow
def test_a_worker_keeps_its_detectors_until_the_end(folders):
    """The detectors' memory lasts from one pass to the next."""
    videos = SynchronizedVideos(folders[::2])
    calls = videos.frame_count
    with CameraDetectors(videos, Fits("counts", calls), workers=2) as cameras:
        assert len(detect_with_cache(videos, cameras, None, None)) == 2 * calls
        with pytest.raises(InvalidInputError, match="at frame 0,"):
            detect_with_cache(videos, cameras, None, None)


@dataclass
class EndsItsProcess(Fitted):
    """As the system does where memory is short."""

    def __call__(self, image):
        os._exit(1)


@dataclass
class Dies(Fits):
    """Its detectors end their process."""

    def fit(self, images):
        return EndsItsProcess(self.fingerprint, self.wrong_from)


@pytest.mark.slow
def test_a_worker_that_ended_is_said(folders):
    videos = SynchronizedVideos(folders[::2])
    with (
        CameraDetectors(videos, Dies("dies", 0), workers=2) as cameras,
        pytest.raises(CatFreeError, match=r"ended early.*workers=1"),
    ):
        detect_with_cache(videos, cameras, None, None)


def test_work_that_cannot_be_sent_is_done_here(folders):
    videos = SynchronizedVideos(folders[::2])
    with CameraDetectors(videos, Fits("local", FRAMES), workers=2) as cameras:
        found = list(cameras.instants(videos, lambda detectors, frame, pictures: dict(pictures)))
    assert [frame for frame, _ in found] == videos.frames.tolist()
    assert all(list(pictures) == [0, 1] for _, pictures in found)


def test_workers_are_a_whole_number_from_one(folders):
    for workers in (0, -1):
        with pytest.raises(InvalidInputError, match="workers is"):
            cf.run(folders, workers=workers)
