from pathlib import Path

import cv2
import numpy as np
import pytest

from catfree.adapters.video._video_sources import FARTHEST_DECODED, open_source

COUNT = FARTHEST_DECODED + 700


@pytest.fixture(scope="module")
def long_video(tmp_path_factory):
    """Write a video whose pictures show their number in twelve columns; key frames every 12."""
    path = tmp_path_factory.mktemp("long") / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (96, 16))
    assert writer.isOpened()
    for number in range(COUNT):
        bits = np.repeat(number >> np.arange(12) & 1, 8)
        writer.write(
            np.broadcast_to((30 + 190 * bits)[None, :, None], (16, 96, 3)).astype(np.uint8)
        )
    writer.release()
    return path


def number_in(image):
    bits = image.reshape(16, 12, 8, 3).mean((0, 2, 3)) > 125
    return int((bits << np.arange(12)).sum())


@pytest.mark.parametrize("name", ["2026-11-25T12:00:00.mp4", "file:a.mp4", "-b.mp4"])
def test_a_name_is_not_taken_for_an_address(long_video, name, tmp_path, monkeypatch):
    (tmp_path / name).write_bytes(long_video.read_bytes())
    monkeypatch.chdir(tmp_path)
    source = open_source(Path(name))
    assert (source.frame_count, source.timeless) == (COUNT, False)
    assert number_in(source.open().read(3)) == 3


@pytest.mark.parametrize("has_table", [False, True])
def test_a_far_frame_is_reached_without_decoding_all_before_it(long_video, has_table, monkeypatch):
    table = long_video.with_suffix(".timestamps.csv")
    table.unlink(missing_ok=True)
    if has_table:  # on another clock than the file's
        times = 1e9 + 0.2 * np.arange(COUNT)
        rows = (f"{frame},{time:.3f}\n" for frame, time in enumerate(times))
        table.write_text("frame_id,timestamp_s\n" + "".join(rows))
    source = open_source(long_video)
    decoded = []

    class Counting:
        def __init__(self, capture):
            self.capture = capture

        def __getattr__(self, name):
            if name == "grab":
                decoded.append(None)
            return getattr(self.capture, name)

    capture = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda path: Counting(capture(path)))
    reader = source.open()
    assert number_in(reader.read(3)) == 3
    for frame in (COUNT - 200, COUNT - 1):
        assert number_in(reader.read(frame)) == frame
    reader.close()
    assert source.fps == pytest.approx(5.0 if has_table else 10.0)
    assert len(decoded) < COUNT - FARTHEST_DECODED
