"""Any number of worker processes gives the results and errors of one process."""

import multiprocessing
import time

import cv2
import numpy as np
import pytest

import catfree as cf
from catfree._run._cache import StageCache
from catfree._run.detection._cached_detection import detect_with_cache
from catfree._run.detection._camera_detectors import CHUNK, CameraDetectors
from catfree._run.detection._second_look import ExpectedPeople, look_again
from catfree.adapters import BackgroundDetector, ColorEmbedder, SynchronizedVideos
from catfree.errors import CatFreeError, InsufficientDataError, InvalidInputError
from tests.run.detection.failing_detectors import (
    EndsItsProcess,
    FailsAlone,
    Fits,
    FittedFails,
    FittedLocked,
    Locked,
    LooksOfTwoLengths,
    WrongInBright,
)
from tests.run.test_run import same_content

CAMERAS, FRAMES = 3, 3 * CHUNK + 2


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Draw a person who walks through the pictures of each camera; one lacks a picture."""
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


def both_looks(videos, workers, cache=None):
    """Return detections of both passes, and the progress calls during fitting."""
    expected = ExpectedPeople(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))
    calls = []

    def note(*call):
        if call[0] == "fit":
            calls.append(call)

    with CameraDetectors(videos, BackgroundDetector(), cache, note, workers=workers) as cameras:
        found = detect_with_cache(cameras, ColorEmbedder())
        again = look_again(videos, cameras, ColorEmbedder(), expected, found)
    return found, again, calls


@pytest.mark.slow
def test_any_number_of_workers_finds_the_same(folders):
    videos = SynchronizedVideos(folders, fewest_cameras=2)
    assert len(videos.silent) == 1
    *expected, calls = both_looks(videos, 1)
    assert len(expected[0]) > FRAMES
    *found, told = both_looks(videos, 8)
    assert all(same_content(*pair) for pair in zip(expected, found, strict=True))
    pictures = CAMERAS * FRAMES - 1
    assert calls[-1] == told[-1] == ("fit", pictures, pictures)
    assert [done for _, done, _ in told] == sorted(done for _, done, _ in told)


@pytest.mark.slow
def test_a_background_that_is_known_is_not_learned_again(folders, tmp_path):
    videos, cache = SynchronizedVideos(folders[::2]), StageCache(tmp_path)
    *expected, _ = both_looks(videos, 2, cache)
    for path in (*cache.folder.glob("boxes-*"), *cache.folder.glob("looks-*")):
        path.unlink()
    next(iter(cache.folder.glob("background-*"))).unlink()
    *found, told = both_looks(videos, 2, cache)
    assert told[-1] == ("fit", FRAMES, FRAMES)  # one camera
    assert both_looks(videos, 2, cache)[2] == []
    assert all(same_content(*pair) for pair in zip(expected, found, strict=True))


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
    (paths[1] / f"{broken:02d}.png").write_bytes(b"no picture")
    found, said = [], []
    for workers in (1, 2):
        with CameraDetectors(videos, Fits("finds", FRAMES), workers=workers) as cameras:
            found.append(detect_with_cache(cameras, None))
        said.append(str(videos.interruption))
        assert videos.whole == broken
        np.testing.assert_array_equal(videos.before_interruption().frames, np.arange(broken))
    assert found[0].frame.max() == broken - 1
    assert same_content(*found)
    assert said[0] == said[1]
    assert "cannot be decoded" in said[0]


@pytest.mark.slow
def test_a_worker_reports_a_wrong_answer_with_camera_and_frame(folders):
    videos = SynchronizedVideos(folders[::2])
    with (
        CameraDetectors(videos, Fits("wrong", CHUNK + 2), workers=2) as cameras,
        pytest.raises(InvalidInputError, match=rf"camera 0 at frame {CHUNK + 2},.*type str"),
    ):
        detect_with_cache(cameras, None)


@pytest.mark.slow
def test_a_worker_keeps_its_detectors_until_the_end(folders):
    """The detectors' memory lasts from one pass to the next."""
    videos = SynchronizedVideos(folders[::2])
    calls = videos.frame_count
    with CameraDetectors(videos, Fits("counts", calls), workers=2) as cameras:
        assert len(detect_with_cache(cameras, None)) == 2 * calls
        with pytest.raises(InvalidInputError, match="at frame 0,"):
            detect_with_cache(cameras, None)


@pytest.mark.slow
def test_a_worker_that_ended_is_said(folders):
    videos = SynchronizedVideos(folders[::2])
    with (
        CameraDetectors(videos, Fits("dies", 0, EndsItsProcess), workers=2) as cameras,
        pytest.raises(CatFreeError, match=r"ended early.*workers=1"),
    ):
        detect_with_cache(cameras, None)


def pictures_of(tmp_path, colors, frames=2, **options):
    """Write videos of plain pictures."""
    for camera, color in enumerate(colors):
        folder = tmp_path / str(camera)
        folder.mkdir()
        for frame in range(frames):
            cv2.imwrite(str(folder / f"{frame:02d}.png"), np.full((32, 32, 3), color, np.uint8))
    return SynchronizedVideos([tmp_path / str(c) for c in range(len(colors))], **options)


@pytest.mark.slow
def test_after_an_error_nobody_waits_for_the_other_processes(tmp_path):
    videos = pictures_of(tmp_path, (0, 100))
    before = set(multiprocessing.active_children())
    with (
        pytest.raises(InsufficientDataError, match="nothing to learn"),
        CameraDetectors(videos, FailsAlone("fails", 0), workers=2) as cameras,
    ):
        _ = cameras.fitted
    end = time.monotonic() + 60
    while set(multiprocessing.active_children()) - before:
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.slow
def test_an_exception_of_somebody_elses_keeps_its_words(tmp_path):
    videos = pictures_of(tmp_path, (0, 100))
    with (
        CameraDetectors(videos, Fits("fails", 0, FittedFails), workers=2) as cameras,
        pytest.raises(CatFreeError, match="TwoWordsError: network down"),
    ):
        detect_with_cache(cameras, None)


@pytest.mark.slow
def test_what_one_process_would_not_have_met_is_not_met(tmp_path):
    """The footage of one camera ends before the other's detector fails."""
    videos = pictures_of(tmp_path, (100, 0), frames=3 * CHUNK, on_error="keep")
    end = CHUNK + 1
    (tmp_path / "1" / f"{end:02d}.png").write_bytes(b"no picture")
    found, detector = [], Fits("wrong", end + 2, WrongInBright)
    for workers in (1, 2):
        with CameraDetectors(videos, detector, workers=workers) as cameras:
            found.append(detect_with_cache(cameras, None))
    assert len(found[0]) == end
    assert same_content(*found)


@pytest.mark.slow
def test_detectors_that_cannot_be_sent_work_here_or_say_so(tmp_path):
    videos = pictures_of(tmp_path, (0, 100))
    with CameraDetectors(videos, Locked("locked", 9), workers=2) as cameras:
        assert len(detect_with_cache(cameras, None)) == 4
    with (
        CameraDetectors(videos, Fits("locked", 9, FittedLocked), workers=2) as cameras,
        pytest.raises(CatFreeError, match=r"is of type FittedLocked, which cannot be pickled.*=1"),
    ):
        detect_with_cache(cameras, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "said"),
    [(1, "LooksOfTwoLengths, called for camera 1 at frame 0"), (2, "rows of 3 and of 4 numbers")],
)
def test_looks_of_two_lengths_are_refused_across_processes(tmp_path, workers, said):
    videos = pictures_of(tmp_path, (0, 100))
    with (
        CameraDetectors(videos, Fits("finds", 9), workers=workers) as cameras,
        pytest.raises(InvalidInputError, match=said),
    ):
        detect_with_cache(cameras, LooksOfTwoLengths())


@pytest.mark.slow
def test_work_that_cannot_be_sent_is_done_here(folders):
    videos = SynchronizedVideos(folders[::2])
    with CameraDetectors(videos, Fits("local", FRAMES), workers=2) as cameras:
        work = lambda detectors, frame, pictures: dict(pictures)  # noqa: E731
        found = list(cameras.instants(videos, work, stage="work"))
    assert [frame for frame, _ in found] == videos.frames.tolist()
    assert all(list(pictures) == [0, 1] for _, pictures in found)


def test_workers_are_a_whole_number_from_one(folders):
    for workers in (0, -1):
        with pytest.raises(InvalidInputError, match="workers is"):
            cf.run(folders, workers=workers)
