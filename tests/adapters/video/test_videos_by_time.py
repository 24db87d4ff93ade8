"""`SynchronizedVideos` of cameras whose frames have times: laws on fake sources, and real files."""

import math
import pickle
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Clock
from catfree._run._input_checks import dropped_instants, footage_warnings, unknown_times
from catfree._run._report import footage_table
from catfree.adapters import FrameDetections, SynchronizedVideos, detect_videos
from catfree.adapters.video._common_clock import REACH, rate_of
from catfree.adapters.video._video_sources import ImageFolder, open_source
from catfree.errors import FileFormatError, InsufficientDataError, InvalidInputError
from tests.adapters.video.test_common_clock import timelines
from tests.adapters.video.test_synchronized_videos import (
    number_in,
    numbers_of,
    truncate,
    write_folder,
    write_video,
)
from tests.adapters.video.test_timestamps import write_table

NOON = 1.7e9


class FakeSource(ImageFolder):
    """Frames that are never decoded."""

    image_size, timeless = (4, 3), False

    def __init__(self, path, count, fps, times=None):
        self.path, self.frame_count, self.fps, self.times = Path(path), count, fps, times

    def content_hash(self):
        return str(self.path)

    def open(self):
        raise NotImplementedError

    def describe(self, frame):
        return f"frame {frame}"


class Blind:
    """A detector that finds no people."""

    fingerprint = "blind"

    def __call__(self, image):
        return FrameDetections(np.zeros((0, 4)), np.zeros(0))


def fake_videos(sources, **options):
    by_name = {source.path.name: source for source in sources}
    place = "catfree.adapters.video._synchronized_videos.open_source"
    with patch(place, lambda path: by_name[path.name]):
        return SynchronizedVideos(list(by_name), **options)


def with_times(times, name="0"):
    return FakeSource(name, len(times), rate_of(times), times)


def shown(videos):
    return {
        tick: [videos._source_frame(camera, tick) for camera in range(videos.camera_count)]
        for tick in videos.frames.tolist()
    }


# Laws.


@given(
    st.lists(
        st.tuples(st.integers(5, 60), st.sampled_from([5.0, 7.5, 10.0, 25.0, 29.97, 30.0])),
        min_size=1,
        max_size=3,
    ),
    st.lists(st.integers(-4, 4), min_size=3, max_size=3),
)
def test_even_footage_is_shown_as_frame_numbers_tell(cameras, offsets):
    sources = [FakeSource(f"{c}", count, fps) for c, (count, fps) in enumerate(cameras)]
    rate = min(fps for _, fps in cameras)
    expected = {}
    for tick in range(100):
        steps = [fps / rate for _, fps in cameras]
        frames = [o + math.floor(tick * s + 0.5) for o, s in zip(offsets, steps, strict=False)]
        if all(0 <= frame < count for frame, (count, _) in zip(frames, cameras, strict=True)):
            expected[tick] = frames
    try:
        videos = fake_videos(sources, offsets=offsets[: len(cameras)])
    except InsufficientDataError:
        assert expected == {}
        return
    assert shown(videos) == expected
    assert videos.clock == Clock(rate)
    assert [one.dropped for one in videos.footage] == [0] * len(cameras)


@pytest.mark.slow
@given(
    st.lists(st.sampled_from([25.0, 25.2, 29.97, 30.0]), min_size=2, max_size=4),
    st.integers(1, 10**5),
)
def test_even_cameras_never_drift_apart(rates, tick):
    videos = fake_videos([FakeSource(f"{c}", 2 * 10**5, fps) for c, fps in enumerate(rates)])
    for camera, fps in enumerate(rates):
        late = videos._source_frame(camera, tick) / fps - tick / min(rates)
        assert abs(late) * fps <= 0.5 + 1e-6


@pytest.mark.slow
@given(st.lists(timelines(), min_size=1, max_size=3), st.integers(1, 3))
def test_a_tick_shows_the_frames_nearest_in_time_or_is_not_delivered(times, stride):
    rate, start = min(map(rate_of, times)), min(own[0] for own in times)
    last = int((max(own[-1] for own in times) - start) * rate) + 2
    seconds = start + np.arange(last) / rate
    away = [np.abs(own[None, :] - seconds[:, None]) for own in times]
    near = np.stack([one.min(1) * rate for one in away], axis=-1)
    if (np.abs(near - REACH) < 1e-6).any():
        return  # depends on rounding
    complete = (near <= REACH).all(1)
    inside = [
        (seconds >= own[0] - REACH / rate) & (seconds <= own[-1] + REACH / rate) for own in times
    ]
    span = np.flatnonzero(np.all(inside, axis=0))[::stride]
    sources = [with_times(own, f"{camera}") for camera, own in enumerate(times)]
    try:
        videos = fake_videos(sources, stride=stride)
    except InsufficientDataError:
        assert not complete[span].any()
        return
    np.testing.assert_array_equal(videos.frames, span[complete[span]])
    for tick, frames in shown(videos).items():
        for frame, one in zip(frames, away, strict=True):
            assert one[tick, frame] == pytest.approx(one[tick].min(), abs=1e-9)
    for camera, one in enumerate(videos.footage):
        assert one.dropped == int((near[span, camera] > REACH).sum())
    assert videos.clock == Clock(rate, start)


@given(
    st.lists(st.one_of(timelines(), st.integers(1, 40)), min_size=1, max_size=4),
    st.integers(1, 4),
    st.integers(1, 3),
)
def test_instants_of_enough_cameras_are_delivered_and_what_they_lack_is_listed(
    footage, fewest, stride
):
    """Compare with all ticks; a number stands for that many even frames at 10 per second."""
    fewest = min(fewest, len(footage))
    times = [np.arange(one) / 10 if isinstance(one, int) else one - one[0] for one in footage]
    rates = [10.0 if isinstance(one, int) else rate_of(one) for one in footage]
    sources = [
        FakeSource(f"{c}", len(own), fps, None if isinstance(one, int) else own)
        for c, (one, own, fps) in enumerate(zip(footage, times, rates, strict=True))
    ]
    rate = min(rates)
    tick = np.arange(int(max(own[-1] for own in times) * rate) + 3)
    reach = [0.5 * rate / 10 if isinstance(one, int) else REACH for one in footage]
    if any(isinstance(one, int) for one in footage) and abs(rate / 10 - 1) > 1e-9:
        return  # even frames are counted, so their ends differ
    near = np.stack([np.abs(own - tick[:, None] / rate).min(1) * rate for own in times], -1)
    if (np.abs(near - reach) < 1e-6).any():
        return  # depends on rounding
    has = near <= reach
    begin = np.sort(has.argmax(0))[fewest - 1]
    expected = np.array([t for t in tick[begin::stride] if has[t].sum() >= fewest], int)
    try:
        videos = fake_videos(sources, fewest_cameras=fewest, stride=stride)
    except InsufficientDataError:
        assert not len(expected)
        return
    np.testing.assert_array_equal(videos.frames, expected)
    lacking = [(t, c) for t in expected for c in np.flatnonzero(~has[t])]
    np.testing.assert_array_equal(videos.silent, np.array(lacking, int).reshape(-1, 2))
    shown = has[expected].sum(0)
    assert [one.pictures for one in videos.footage] == shown.tolist()
    if fewest == len(footage):
        assert len(videos.silent) == 0


@given(st.integers(5, 60), st.integers(5, 60), st.floats(-0.2, 0.2))
def test_even_times_and_no_times_are_the_same(one, two, jitter):
    """Two ways to describe an even camera agree wherever the nearest frame is unique."""
    rng = np.random.default_rng(one)
    times = (np.arange(one) + jitter * rng.uniform(-1, 1, one)) / 30
    times[0] = 0.0
    even = [FakeSource("0", one, 30.0), FakeSource("1", two, 10.0)]
    timed = FakeSource("0", one, 30.0, times)
    by_count, by_time = shown(fake_videos(even)), shown(fake_videos([timed, even[1]]))
    # By time, the last frame of a fast camera is still near the next tick.
    assert by_count.items() <= by_time.items()
    assert len(by_time) <= len(by_count) + 1


@given(timelines(), st.integers(-8, 8))
def test_offsets_that_are_read_can_be_given(times, offset):
    times = times - times[0]
    fixed = FakeSource("1", 60, 25.0)
    videos = fake_videos([with_times(times), fixed], offsets=[offset, 0], frame_rate=1.0)
    assert videos.offsets == (offset, 0)


@given(st.integers(-3, 3), st.integers(-3, 3))
def test_clocks_are_corrected_alike_with_and_without_times(one, two):
    times = np.arange(40) / 10
    even = fake_videos([FakeSource("0", 40, 10.0), FakeSource("1", 80, 20.0)])
    timed = fake_videos(
        [with_times(times, "0"), FakeSource("1", 80, 20.0, np.arange(80) / 20)], frame_rate=10
    )
    a, b = even.without_offsets([one, two]), timed.without_offsets([one, two])
    assert shown(a).items() <= shown(b).items()
    assert a.offsets == b.offsets


# Real files.


def retimed(path, milliseconds):
    """Rewrite a video into Matroska with its packets at other times."""
    if not hasattr(cv2, "VIDEOWRITER_PROP_PTS"):
        pytest.skip("this OpenCV cannot write times")
    packets = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    code = int(packets.get(cv2.CAP_PROP_FOURCC))
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    target = path.with_suffix(".mkv")
    writer = cv2.VideoWriter(str(target), cv2.CAP_FFMPEG, code, 1000, (64, 48), raw)
    for time in milliseconds:
        assert writer.set(cv2.VIDEOWRITER_PROP_PTS, int(time))
        writer.write(packets.read()[1])
    writer.release()
    packets.release()
    return target


def test_frames_that_a_file_dropped_are_missed_by_time_not_by_count(tmp_path):
    dropped = np.delete(np.arange(23) * 100, [8, 9, 15])
    paths = [
        retimed(write_video(tmp_path / "a.mp4", 20), dropped),
        write_video(tmp_path / "b.mp4", 23),
    ]
    videos = SynchronizedVideos(paths)
    numbers = {tick: (a, b) for tick, a, b in numbers_of(videos)}
    assert sorted(numbers) == (dropped // 100).tolist()
    assert [a for a, _ in numbers.values()] == list(range(20))
    assert all(b == tick for tick, (_, b) in numbers.items())
    assert videos.clock == Clock(10.0)
    assert [one.dropped for one in videos.footage] == [3, 0]
    assert videos.footage[0].seconds == pytest.approx(2.3)
    assert footage_warnings(videos) == (
        "Camera 'a' has no frame near 3 instants, which are not used (20 are): it dropped frames, "
        "or its frame rate varies.",
    )
    table = footage_table(videos)
    assert table.header[-1] == "dropped frames"
    assert [row[-1] for row in table.rows] == ["3", "0"]
    # Positions count the delivered instants.
    assert next(videos.instants_from(8))[0] == 10
    assert videos.fingerprint != SynchronizedVideos(paths, end=22).fingerprint


def test_a_varying_rate_is_shown_at_the_times_of_its_frames(tmp_path):
    times = np.cumsum([0, *([40] * 10), *([80] * 10), *([40] * 10)])
    path = retimed(write_video(tmp_path / "a.mp4", 31), times)
    videos = SynchronizedVideos([path], frame_rate=12.5)
    away = {tick: abs(times[frame] - 80 * tick) for tick, frame in numbers_of(videos)}
    assert list(away) == list(range(21))
    assert max(away.values()) == 0
    assert SynchronizedVideos([path]).footage[0].fps == pytest.approx(25)


@pytest.mark.parametrize("start", [17, 2000, 15490])
@pytest.mark.parametrize("step", [[40] * 59, [*([40] * 20), *([80] * 19), *([40] * 20)]])
def test_a_recording_on_a_clock_that_started_before_it_is_as_long_as_it_is(tmp_path, start, step):
    times = start + np.cumsum([0, *step])
    path = retimed(write_video(tmp_path / "a.mp4", 60, fps=25), times)
    videos = SynchronizedVideos([path], frame_rate=12.5)
    assert videos.footage[0].frame_count == 60
    away = [abs(times[frame] - start - 80 * tick) for tick, frame in numbers_of(videos)]
    assert max(away) <= 40
    with pytest.raises(FileFormatError, match=r"frame \d+ of \d+ .* is truncated"):
        list(SynchronizedVideos([truncate(path)]))


def test_even_files_have_no_times_of_their_own_and_nothing_to_say(tmp_path):
    paths = [
        write_video(tmp_path / "a.mp4", 10, fps=30000 / 1001),
        write_video(tmp_path / "b.avi", 10, fps=30),
    ]
    videos = SynchronizedVideos(paths)
    assert numbers_of(videos) == [(k, k, k) for k in range(10)]
    assert videos.clock == Clock(videos.fps or 0)
    assert footage_warnings(videos) == ()


def test_a_file_that_states_a_wrong_rate_is_even_all_the_same(tmp_path):
    path = retimed(write_video(tmp_path / "a.mp4", 20), np.arange(20) * 100)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == 1000
    videos = SynchronizedVideos([path, write_video(tmp_path / "b.avi", 20)])
    assert numbers_of(videos) == [(k, k, k) for k in range(20)]
    assert videos.clock == Clock(10.0)
    assert [source.times for source in videos._sources] == [None, None]


def test_frames_that_the_decoder_leaves_out_do_not_pass_unnoticed(tmp_path):
    path = write_video(tmp_path / "a.mkv", 20)
    source = open_source(path)
    reader = source.open()
    assert reader.read(3) is not None
    reader.capture.grab()  # as if the decoder had lost frame 4
    assert reader.read(4) is None
    assert number_in(reader.read(5)) == 5
    while reader.capture.grab():
        pass
    assert reader.read(8) is None
    assert reader.read(5) is None
    reader.close()


def test_tables_of_absolute_times_put_late_files_in_their_place(tmp_path):
    paths = [write_folder(tmp_path / "a", range(10)), write_video(tmp_path / "b.avi", 10, fps=5)]
    write_table(paths[0] / "timestamps.csv", NOON + np.arange(10) / 5)
    write_table(tmp_path / "b.timestamps.csv", NOON + 0.83 + np.arange(10) / 5)
    videos = SynchronizedVideos(paths)
    assert numbers_of(videos) == [(k, k, k - 4) for k in range(4, 10)]
    assert videos.clock is not None
    assert videos.clock.utc
    assert videos.clock.start == NOON
    assert videos.clock.frame_rate == pytest.approx(5)
    assert unknown_times(videos) == dropped_instants(videos) == ()

    assert detect_videos(videos, Blind()).clock == videos.clock
    # The same recording with another start is another input.
    before = videos.fingerprint
    write_table(paths[0] / "timestamps.csv", NOON + 1 + np.arange(10) / 5)
    assert SynchronizedVideos(paths).fingerprint != before


def test_tables_overrule_the_rate_of_a_file(tmp_path):
    path = write_video(tmp_path / "a.avi", 10, fps=25)
    write_table(tmp_path / "a.timestamps.csv", 3 + np.arange(10) / 2)
    videos = SynchronizedVideos([path])
    assert videos.clock == Clock(2.0, 3.0)
    assert numbers_of(videos) == [(k, k) for k in range(10)]
    assert SynchronizedVideos([path], offsets=[4]).clock == Clock(2.0)
    assert numbers_of(SynchronizedVideos([path], offsets=[4])) == [(k, k + 4) for k in range(6)]


def test_absolute_and_relative_times_do_not_mix(tmp_path):
    paths = [write_folder(tmp_path / "a", range(3)), write_folder(tmp_path / "b", range(3))]
    write_table(paths[0] / "timestamps.csv", NOON + np.arange(3))
    for write in (lambda: None, lambda: write_table(paths[1] / "timestamps.csv", [0, 1, 2])):
        write()
        with pytest.raises(InvalidInputError, match=r"Camera 'a' has absolute .* camera 'b' does"):
            SynchronizedVideos(paths)


def test_a_bad_table_names_camera_file_and_line(tmp_path):
    path = write_video(tmp_path / "a.avi", 3)
    table = write_table(tmp_path / "a.timestamps.csv", [0, 1, 1])
    with pytest.raises(FileFormatError, match=r"Camera 0: .*a\.timestamps\.csv: line 4 has"):
        SynchronizedVideos([path])
    write_table(table, [0, 1])
    with pytest.raises(FileFormatError, match=r"ends with line 3, for 2 frames.* has 3"):
        SynchronizedVideos([path])


def test_a_cut_file_with_a_whole_table_is_used_up_to_the_cut(tmp_path):
    path = truncate(write_video(tmp_path / "a.avi", 20))
    write_table(tmp_path / "a.timestamps.csv", np.arange(20) / 10)
    with pytest.raises(FileFormatError, match=r"Camera 0 \('a'\): frame \d+ of 20"):
        list(SynchronizedVideos([path]))
    kept = numbers_of(SynchronizedVideos([path], on_error="keep"))
    assert 5 < len(kept) < 15


def test_images_without_times_say_so_if_a_rate_is_given(tmp_path):
    folder = write_folder(tmp_path / "f", range(4))
    assert SynchronizedVideos([folder]).clock is None
    assert footage_warnings(SynchronizedVideos([folder])) == ()
    videos = SynchronizedVideos([folder], frame_rate=2)
    assert videos.clock == Clock(2.0)
    assert footage_warnings(videos) == (
        "There are no times for the frames of camera 'f'; they are assumed to be even, 2 per "
        "second.",
    )


def test_a_file_that_begins_before_its_time_zero(tmp_path):
    early = with_times(np.arange(30) / 10 - 0.5, "0")
    videos = fake_videos([early, FakeSource("1", 20, 10.0)])
    assert shown(videos) == {tick: [tick + 5, tick] for tick in range(20)}
    assert videos.clock is not None
    assert videos.clock.start == 0


def test_open_videos_can_be_sent_to_another_process(tmp_path):
    paths = [
        retimed(write_video(tmp_path / "a.mp4", 8), np.delete(np.arange(9) * 100, 4)),
        write_video(tmp_path / "b.mp4", 9),
    ]
    videos = SynchronizedVideos(paths)
    again = pickle.loads(pickle.dumps(videos))
    assert again.clock == videos.clock
    assert numbers_of(again) == numbers_of(videos)


def test_cameras_that_never_meet(tmp_path):
    apart = [with_times(np.arange(3.0), "0"), with_times(50 + np.arange(3.0), "1")]
    with pytest.raises(InsufficientDataError, match="camera '0' ends after tick 2"):
        fake_videos(apart)
    holes = with_times(np.array([0.0, 0.1, 0.2, 50, 50.1, 50.2]), "0")
    with pytest.raises(InsufficientDataError, match="'0' has no frame near 30 of the 30"):
        fake_videos([holes, with_times(10 + np.arange(30.0) / 10, "1")])


@pytest.mark.slow
def test_nothing_but_one_number_per_frame_is_kept_of_a_day():
    count = 24 * 3600 * 25
    times = np.delete(np.arange(count) / 25, slice(1000, 2000))
    videos = fake_videos([with_times(times, "0"), FakeSource("1", count, 25.0)])
    assert len(videos) == count - 1000
    kept = [value for value in vars(videos).values() if isinstance(value, np.ndarray)]
    assert sum(value.nbytes for value in kept) <= 8 * count
