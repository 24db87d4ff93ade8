"""Times of frames: tables beside the footage, and packets of video files."""

from fractions import Fraction

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters.video._timestamps import packet_times, read_timestamps, sidecar_of
from catfree.errors import FileFormatError, InvalidInputError


def write_table(path, times, header="frame_id,timestamp_s"):
    rows = (f"{frame},{time!r}" for frame, time in enumerate(map(float, times)))
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@given(st.lists(st.floats(-1e9, 9e10), min_size=1, max_size=30, unique=True).map(sorted))
def test_a_table_gives_back_every_bit(tmp_path_factory, times):
    path = write_table(tmp_path_factory.mktemp("t") / "timestamps.csv", times)
    np.testing.assert_array_equal(read_timestamps(path, len(times)), times)


def test_a_table_of_a_spreadsheet(tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes(b"\xef\xbb\xbfframe_id, timestamp_s\r\n0, 0.5\r\n1, 1\r\n\r\n\r\n")
    assert read_timestamps(path, 2).tolist() == [0.5, 1.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1 is '', not the header frame_id,timestamp_s"),
        ("0,0.5\n1,0.6\n2,0.7\n", "line 1 is '0,0.5', not the header"),
        ("frame_id,timestamp_s\n0,0.5\n1,0.6\n", "ends with line 3, for 2 frames.* has 3"),
        ("frame_id,timestamp_s\n0,0\n1,1\n2,2\n3,3\n", "ends with line 5, for 4 frames.* has 3"),
        ("frame_id,timestamp_s\n0,0.5\n1,0.5\n2,1\n", "line 3 has timestamp_s 0.5.*not after 0.5"),
        ("frame_id,timestamp_s\n0,0.5\n2,0.6\n", "line 3 has frame_id 2, but frame 1 is next"),
        ("frame_id,timestamp_s\n0,0.5\n1;0.6\n", "line 3 is '1;0.6', not the number of a frame"),
        ("frame_id,timestamp_s\n0,0.5\n1,0.6,7\n", "line 3 is '1,0.6,7'"),
        ("frame_id,timestamp_s\n0,0.5\n\n1,0.6\n", "line 3 is empty"),
        ("frame_id,timestamp_s\n0,0.5\n\n\n1,0.6\n2,0.7\n", "line 3 is empty"),
        ("frame_id,timestamp_s\n0,nan\n", "line 2 has timestamp_s nan, which is not a time"),
        ("frame_id,timestamp_s\n0,1.7e12\n", "line 2 has timestamp_s 1.7e.12, which is not a time"),
        ("frame_id,timestamp_s\n0," + "9" * 1000, "line 2 is .* not the number|line 2 has"),
        ("frame_id,timestamp_s\n0,\udcff", "is not readable text"),
    ],
)
def test_a_malformed_table_is_refused_by_line(tmp_path, text, message):
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(FileFormatError, match=rf"t\.csv.*{message}"):
        read_timestamps(path, 3)


def test_a_missing_table(tmp_path):
    with pytest.raises(InvalidInputError, match="There is no file"):
        read_timestamps(tmp_path / "t.csv", 3)


def test_where_the_table_is(tmp_path):
    folder, video = tmp_path / "images", tmp_path / "north.mp4"
    folder.mkdir()
    assert sidecar_of(folder) is None
    assert sidecar_of(video) is None
    inside, beside = folder / "timestamps.csv", tmp_path / "north.timestamps.csv"
    inside.touch()
    beside.touch()
    assert sidecar_of(folder) == inside
    assert sidecar_of(video) == beside


@pytest.mark.parametrize(
    ("suffix", "code"), [(".mp4", "mp4v"), (".avi", "MJPG"), (".mkv", "mp4v"), (".webm", "VP80")]
)
@pytest.mark.parametrize("rate", [10.0, 30000 / 1001])
def test_packets_have_the_times_of_decoded_frames(tmp_path, suffix, code, rate):
    path = tmp_path / f"a{suffix}"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), rate, (64, 48))
    for level in range(30):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    times = packet_times(path)
    assert times is not None
    np.testing.assert_allclose(times, np.arange(30) / rate, atol=1e-3)
    capture, decoded = cv2.VideoCapture(str(path)), []
    while capture.grab():
        decoded.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    np.testing.assert_array_equal(times, decoded)


def test_b_frames_come_in_the_order_of_showing(tmp_path):
    av = pytest.importorskip("av", reason="needs PyAV to write B-frames")
    path = tmp_path / "b.mp4"
    wanted = np.cumsum([0, *([40] * 20), 120, *([40] * 20)])
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"bf": "3", "b-adapt": "0"}
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for time in wanted.tolist():
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), time % 250, np.uint8))
            frame.pts, frame.time_base = time, stream.time_base
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    times = packet_times(path)
    assert times is not None
    np.testing.assert_allclose(times, wanted / 1000, atol=1e-4)


def test_what_has_no_times(tmp_path, monkeypatch):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"no video at all")
    assert packet_times(path) is None

    class Nowhere:
        """A capture that cannot deliver raw packets."""

        def __init__(self, *_):
            pass

        def isOpened(self):
            return True

        def set(self, *_):
            return False

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoCapture", Nowhere)
    assert packet_times(path) is None
