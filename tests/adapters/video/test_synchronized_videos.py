import os
import threading
from itertools import islice

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import SynchronizedVideos
from catfree.adapters.files._camera_names import natural_order
from catfree.errors import FileFormatError, InsufficientDataError, InvalidInputError


def coded(number, width=64, height=48):
    """Draw a number that survives lossy coding, as eight bright or dark columns."""
    image = np.random.default_rng(number).integers(-20, 20, (height, width, 3))
    for bit in range(8):
        image[:, bit * width // 8 : (bit + 1) * width // 8] += 220 if number >> bit & 1 else 30
    return image.astype(np.uint8)


def number_in(image):
    edge = [bit * image.shape[1] // 8 for bit in range(9)]
    return sum(int(image[:, edge[i] : edge[i + 1]].mean() > 125) << i for i in range(8))


def write_video(path, count, fps=10.0, size=(64, 48)):
    code = "MJPG" if path.suffix == ".avi" else "mp4v"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), fps, size)
    assert writer.isOpened()
    for number in range(count):
        writer.write(coded(number, *size))
    writer.release()
    return path


def write_folder(path, numbers, size=(64, 48), name="image{}.png", grey=False):
    path.mkdir()
    for number in numbers:
        image = coded(number, *size)
        cv2.imwrite(str(path / name.format(number)), image[:, :, 0] if grey else image)
    return path


def numbers_of(videos):
    return [(frame, *map(number_in, images)) for frame, images in videos]


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_a_video_comes_frame_by_frame_in_rgb(tmp_path, suffix):
    videos = SynchronizedVideos([write_video(tmp_path / f"a{suffix}", 12)])
    assert numbers_of(videos) == [(i, i) for i in range(12)]
    assert numbers_of(videos) == [(i, i) for i in range(12)]  # again from the start
    assert videos.frame_count == len(videos) == 12
    assert videos.fps == 10
    np.testing.assert_array_equal(videos.image_size, [[64, 48]])


def test_channels_are_red_green_blue(tmp_path):
    folder = tmp_path / "f"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.full((4, 5, 3), (10, 20, 200), np.uint8))  # BGR
    _, (image,) = next(iter(SynchronizedVideos([folder])))
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, np.full((4, 5, 3), (200, 20, 10)))


@pytest.mark.parametrize("size", [(65, 47), (33, 121)])
def test_odd_sizes(tmp_path, size):
    paths = [
        write_video(tmp_path / "a.mp4", 3, size=size),
        write_folder(tmp_path / "b", range(3), (9, 5)),
    ]
    videos = SynchronizedVideos(paths)
    # The encoder may round odd sides down to even ones; the folder keeps them.
    even = [side // 2 * 2 for side in size]
    assert videos.image_size[0].tolist() in (list(size), even)
    np.testing.assert_array_equal(videos.image_size[1], (9, 5))
    for frame, images in videos:
        assert [(i.shape[1], i.shape[0]) for i in images] == [
            tuple(size) for size in videos.image_size.tolist()
        ]
        assert [number_in(i) for i in images] == [frame, frame]


def test_the_slowest_camera_sets_the_clock(tmp_path):
    paths = [
        write_video(tmp_path / "slow.avi", 10, fps=5),
        write_video(tmp_path / "fast.avi", 60, fps=15),
        write_video(tmp_path / "odd.avi", 30, fps=12.5),
    ]
    videos = SynchronizedVideos(paths)
    assert videos.fps == 5
    assert numbers_of(videos) == [(k, k, 3 * k, int(2.5 * k + 0.5)) for k in range(10)]
    slower = SynchronizedVideos(paths, frame_rate=2.5)
    assert numbers_of(slower) == [(k, 2 * k, 6 * k, 5 * k) for k in range(5)]
    with pytest.raises(InvalidInputError, match="'slow' has only 5 frames per second"):
        SynchronizedVideos(paths, frame_rate=10)


def test_different_lengths_end_with_the_shortest(tmp_path):
    paths = [write_video(tmp_path / f"{n}.avi", n) for n in (9, 6, 14)]
    assert len(SynchronizedVideos(paths)) == 6


def test_pictures_that_do_not_exist_are_black_and_listed(tmp_path):
    paths = [write_video(tmp_path / f"{n}.avi", n) for n in (9, 6, 14)]
    videos = SynchronizedVideos(paths, fewest_cameras=2)
    np.testing.assert_array_equal(videos.frames, np.arange(9))
    assert videos.silent.tolist() == [[6, 1], [7, 1], [8, 1]]
    assert [one.pictures for one in videos.footage] == [9, 6, 9]
    for (tick, images), (same, pictures) in zip(videos, videos.pictures_from(), strict=True):
        assert tick == same
        assert list(pictures) == ([0, 1, 2] if tick < 6 else [0, 2])
        for camera, image in enumerate(images):
            known = pictures.get(camera, np.zeros_like(image))
            np.testing.assert_array_equal(image, known)
    assert sum(1 for _ in videos.pictures_of(1)) == 6
    # The middle one is late by four ticks: it ends at tick 2 of the corrected clock.
    assert videos.without_offsets([0, 4, 0]).silent.tolist() == [[t, 1] for t in range(2, 9)]
    assert videos.between(5, 8).silent.tolist() == [[6, 1], [7, 1]]
    assert videos.fingerprint != SynchronizedVideos(paths, end=6).fingerprint
    with pytest.raises(InvalidInputError, match="between 1 and the number of videos"):
        SynchronizedVideos(paths, fewest_cameras=4)


def test_offsets_shift_each_camera_by_its_own_frames(tmp_path):
    paths = [write_video(tmp_path / "a.avi", 20), write_video(tmp_path / "b.avi", 40, fps=20)]
    videos = SynchronizedVideos(paths, offsets=[3, 5])
    assert numbers_of(videos) == [(k, k + 3, 2 * k + 5) for k in range(17)]
    later = SynchronizedVideos(paths, offsets=[0, -7])
    assert numbers_of(later)[0] == (4, 4, 1)  # tick 3 would be frame -1 of the second camera
    assert numbers_of(later)[-1] == (19, 19, 31)


def test_stride_start_and_end(tmp_path):
    path = write_video(tmp_path / "a.avi", 20)
    videos = SynchronizedVideos([path], stride=4, start=3, end=16)
    assert numbers_of(videos) == [(k, k) for k in (3, 7, 11, 15)]
    np.testing.assert_array_equal(videos.frames, [3, 7, 11, 15])
    assert videos.fps == 2.5
    assert len(SynchronizedVideos([path], end=1000)) == 20
    for end in (3, -5):
        with pytest.raises(InvalidInputError, match=f"end is {end}, but the first instant"):
            SynchronizedVideos([path], start=3, end=end)


@given(
    st.lists(
        st.tuples(st.integers(1, 30), st.sampled_from([5.0, 7.5, 10.0, 12.0])),
        min_size=1,
        max_size=3,
    ),
    st.lists(st.integers(-4, 4), min_size=3, max_size=3),
)
def test_every_delivered_tick_exists_in_every_camera_and_no_other(cameras, offsets):
    """Check the clock's range against a search through all ticks."""
    videos = object.__new__(SynchronizedVideos)
    videos._sources = [FakeSource(count, fps) for count, fps in cameras]
    videos._offsets, videos.camera_names = offsets, [str(i) for i in range(3)]
    videos._rate, videos._fewest = min(fps for _, fps in cameras), len(cameras)
    expected = [
        tick
        for tick in range(60)
        if all(
            0 <= videos._source_frame(c, tick) < source.frame_count
            for c, source in enumerate(videos._sources)
        )
    ]
    if expected:
        assert list(videos._shared_ticks(None, None, 1)) == expected
    else:
        with pytest.raises(InsufficientDataError):
            videos._shared_ticks(None, None, 1)


class FakeSource:
    times = None

    def __init__(self, count, fps):
        self.frame_count, self.fps = count, fps


# Image folders.


def test_folders_are_read_in_natural_order(tmp_path):
    folder = write_folder(tmp_path / "f", [10, 9, 2, 100])
    (folder / "notes.txt").write_text("not an image")
    (folder / ".hidden.png").write_bytes(b"")
    assert numbers_of(SynchronizedVideos([folder])) == [(0, 2), (1, 9), (2, 10), (3, 100)]
    assert SynchronizedVideos([folder]).fps is None
    assert SynchronizedVideos([folder], frame_rate=2, stride=2).fps == 1


@given(st.lists(st.integers(0, 10**12), min_size=2, max_size=6, unique=True))
def test_natural_order_is_numeric(numbers):
    names = [f"frame_{n}.png" for n in numbers]
    assert sorted(names, key=natural_order) == [f"frame_{n}.png" for n in sorted(numbers)]


def test_numbers_of_any_length_have_an_order():
    long = "9" * 5000
    assert sorted([long, "a", "10", "09"], key=natural_order) == ["09", "10", long, "a"]


def test_grey_images_become_rgb_and_mix_with_videos(tmp_path):
    paths = [
        write_folder(tmp_path / "grey", range(5), grey=True),
        write_video(tmp_path / "b.avi", 7),
    ]
    videos = SynchronizedVideos(paths)
    assert numbers_of(videos) == [(k, k, k) for k in range(5)]
    assert videos.fps == 10
    assert next(iter(videos))[1][0].shape == (48, 64, 3)


def test_names_tell_cameras_apart(tmp_path):
    paths = []
    for camera in ("cam1", "cam2"):
        (tmp_path / camera).mkdir()
        paths.append(write_video(tmp_path / camera / "video.avi", 2))
    assert SynchronizedVideos(paths).camera_names == ["cam1/video", "cam2/video"]
    assert SynchronizedVideos(paths[:1]).camera_names == ["video"]


def test_videos_that_differ_in_suffix_only(tmp_path):
    paths = [write_video(tmp_path / f"cam{suffix}", 2) for suffix in (".mp4", ".avi")]
    assert SynchronizedVideos(paths).camera_names == ["cam.mp4", "cam.avi"]
    with pytest.raises(InvalidInputError, match="Cameras 0 and 1 are the same file"):
        SynchronizedVideos([paths[0], paths[0]])


# Invalid input.


def test_a_path_that_is_no_text_is_refused_when_opened(tmp_path):
    name = os.fsdecode(b"gr\xf6\xdfe")
    video = tmp_path / f"{name}.avi"
    video.write_bytes(write_video(tmp_path / "a.avi", 2).read_bytes())
    folder = write_folder(tmp_path / "f", range(2)).rename(tmp_path / name)
    for path in (video, folder):
        with pytest.raises(InvalidInputError, match=r"Camera 0: The path .*gr\\udcf6.*Rename it"):
            SynchronizedVideos([path])


def truncate(path, share=0.5):
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    return path


def test_a_truncated_file_names_camera_and_frame(tmp_path):
    paths = [write_video(tmp_path / "good.avi", 20), write_video(tmp_path / "bad.avi", 20)]
    truncate(paths[1])
    seen = []
    with pytest.raises(FileFormatError, match=r"Camera 1 \('bad'\): frame (\d+) of 20") as caught:
        seen.extend(frame for frame, _ in SynchronizedVideos(paths))
    assert 5 < len(seen) < 15
    assert f"frame {len(seen)} of 20" in str(caught.value)
    videos = SynchronizedVideos(paths, on_error="keep")
    assert numbers_of(videos) == [(k, k, k) for k in seen]
    assert "Camera 1 ('bad')" in str(videos.interruption)


def test_damage_ahead_matters_to_those_who_get_there_only(tmp_path):
    path = truncate(write_video(tmp_path / "bad.avi", 20))
    kept = sum(1 for _ in SynchronizedVideos([path], on_error="keep"))
    threads = threading.active_count()
    instants = iter(SynchronizedVideos([path]))
    assert [frame for frame, _ in islice(instants, kept)] == list(range(kept))
    instants.close()
    assert threading.active_count() == threads


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_damage_in_the_middle_never_passes_unnoticed(tmp_path, suffix):
    path = write_video(tmp_path / f"a{suffix}", 30)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + len(content) // 8] = bytes(len(content) // 8)
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"Camera 0 \('a'\): frame \d+ of 30"):
        list(SynchronizedVideos([path]))
    videos = SynchronizedVideos([path], on_error="keep")
    assert numbers_of(videos)[:10] == [(k, k) for k in range(10)]
    assert videos.interruption is not None


@pytest.mark.parametrize("content", [b"", b"no video at all" * 100])
def test_a_file_that_is_no_video(tmp_path, content):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"Camera 0: .*a\.mp4 cannot be decoded"):
        SynchronizedVideos([path])


def test_a_text_file_is_not_decoded_as_ansi_art(tmp_path):
    rows = (f"{frame},1,{frame}.0,100.0,40.0,120.0,0.9,-1,-1,-1" for frame in range(1, 300))
    (tmp_path / "boxes.txt").write_text("\n".join(rows))
    with pytest.raises(FileFormatError, match=r"boxes\.txt is a text file, not a video.*read_mot"):
        SynchronizedVideos([tmp_path / "boxes.txt"])


def test_an_mp4_cut_off_while_recording(tmp_path):
    path = truncate(write_video(tmp_path / "a.mp4", 20))
    with pytest.raises(FileFormatError, match=r"Camera 0: .*a\.mp4 cannot be decoded"):
        SynchronizedVideos([path], on_error="keep")


def test_a_broken_or_resized_image_names_its_file(tmp_path):
    folder = write_folder(tmp_path / "f", range(4))
    (folder / "image2.png").write_bytes(b"broken")
    with pytest.raises(FileFormatError, match=r"Camera 0 \('f'\): frame 2 \(.*image2\.png\)"):
        list(SynchronizedVideos([folder]))
    cv2.imwrite(str(folder / "image2.png"), coded(2, 32, 16))
    with pytest.raises(FileFormatError, match="is 32 x 16 px, but the camera started with 64 x 48"):
        list(SynchronizedVideos([folder]))
    assert len(list(SynchronizedVideos([folder], on_error="keep"))) == 2


def test_an_empty_folder_and_a_missing_path(tmp_path):
    with pytest.raises(InvalidInputError, match=r"Camera 0: The folder .* holds no images"):
        SynchronizedVideos([tmp_path])
    with pytest.raises(InvalidInputError, match="no video file or image folder"):
        SynchronizedVideos([tmp_path / "absent.mp4"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stride": 0}, "stride"),
        ({"offsets": [0, 0]}, "one number per camera"),
        ({"frame_rate": 0}, "frame_rate"),
        ({"offsets": [-3], "start": 1}, "first picture at tick 3"),
        ({"offsets": [5]}, "offset of camera 'a' is 5, but it has only 5 frames"),
    ],
)
def test_impossible_parameters(tmp_path, options, message):
    path = write_video(tmp_path / "a.avi", 5)
    with pytest.raises(InvalidInputError, match=message):
        SynchronizedVideos([path], **options)


def test_no_shared_instant(tmp_path):
    paths = [write_video(tmp_path / "a.avi", 5), write_video(tmp_path / "b.avi", 5)]
    with pytest.raises(InsufficientDataError, match="'a' ends after tick 4"):
        SynchronizedVideos(paths, offsets=[0, -9])
    with pytest.raises(InvalidInputError, match="one video per camera"):
        SynchronizedVideos(str(paths[0]))


def test_the_fingerprint_follows_content_and_timing(tmp_path):
    path = write_video(tmp_path / "a.avi", 8)
    copy = tmp_path / "copy.avi"
    copy.write_bytes(path.read_bytes())
    print_of = SynchronizedVideos([path]).fingerprint
    assert SynchronizedVideos([copy]).fingerprint == print_of
    assert SynchronizedVideos([path], stride=2).fingerprint != print_of
    assert SynchronizedVideos([path], offsets=[1], end=5).fingerprint != print_of
    other = write_video(tmp_path / "b.avi", 9)
    assert SynchronizedVideos([other], end=8).fingerprint != print_of


@pytest.mark.slow
def test_real_clips(shared):
    clips = sorted((shared / "data/real/mmptrack_retail").glob("*.mp4"))
    if not clips:
        pytest.skip("no real clips")
    videos = SynchronizedVideos(clips, stride=100)
    assert videos.camera_count == 3
    assert videos.fps == pytest.approx(0.18)
    np.testing.assert_array_equal(videos.image_size, [[640, 360]] * 3)
    frames = [(frame, [image.mean() for image in images]) for frame, images in videos]
    assert [frame for frame, _ in frames] == [0, 100, 200, 300, 400]
    assert all(min(means) > 10 for _, means in frames)
