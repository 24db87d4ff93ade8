"""MOTChallenge text and tables of tracks."""

import builtins
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import (
    read_mot,
    read_tracks_csv,
    read_tracks_parquet,
    write_mot_boxes,
    write_mot_ground,
    write_tracks_csv,
    write_tracks_parquet,
)
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError, MissingDependencyError
from catfree.methods.paper._assemble import empty_localization
from catfree.types import Clock, Detections, Tracks

FINITE = st.floats(-1e6, 1e6, allow_nan=False)
POSITIVE = st.floats(1e-3, 1e4)


@st.composite
def track_arguments(draw) -> dict:
    """Draw arguments of `Tracks` with any numbers."""
    row = st.tuples(
        st.integers(-50, 5000),
        st.integers(-1, 300),
        st.tuples(*[FINITE] * 5),
        st.tuples(*[POSITIVE] * 3),
        st.integers(0, 9),
        st.integers(0, 2),
        st.floats(0, 1),
    )
    rows = draw(st.lists(row, max_size=6))
    has_existence, has_velocity = draw(st.booleans()), draw(st.booleans())
    numbers = np.array([r[2] for r in rows]).reshape(-1, 5)
    spread = np.array([r[3] for r in rows]).reshape(-1, 3)
    common = numbers[:, 4] / 1e6 * np.sqrt(spread[:, 1] * spread[:, 2])
    covariance = np.stack([spread[:, 1], common, common, spread[:, 2]], -1)
    return {
        "frame": np.array([r[0] for r in rows], np.int64),
        "track_id": np.array([r[1] for r in rows], np.int64),
        "position": numbers[:, :3],
        "ground_xy": numbers[:, 2:4],
        "sigma": spread[:, 0],
        "covariance": covariance.reshape(-1, 2, 2),
        "supporting_cameras": np.array([r[4] for r in rows], np.int64),
        "origin": np.array([r[5] for r in rows], np.int64),
        "existence": np.array([r[6] for r in rows], np.float64) if has_existence else None,
        "velocity": numbers[:, :2] if has_velocity else np.full((len(rows), 2), np.nan),
        "velocity_covariance": 2 * covariance.reshape(-1, 2, 2),
    }


@pytest.mark.slow
@given(drawn=track_arguments())
def test_csv_gives_back_the_tracks_bit_for_bit(drawn, tmp_path_factory):
    path = tmp_path_factory.mktemp("csv") / "tracks.csv"
    write_tracks_csv(path, Tracks(**drawn))
    again = read_tracks_csv(path)
    for name, value in drawn.items():
        np.testing.assert_array_equal(getattr(again, name), value)


@given(
    drawn=track_arguments(),
    clock=st.builds(
        Clock,
        st.sampled_from([5.0, 25.0, 29.97, 30000 / 1001, 10.123456789]),
        st.sampled_from([0.0, 12.34, 1.7e9, 1.7e9 + 1 / 3]),
    ),
)
def test_csv_keeps_the_clock(drawn, clock, tmp_path_factory):
    path = tmp_path_factory.mktemp("csv") / "tracks.csv"
    tracks = Tracks(**drawn, clock=clock)
    again = read_tracks_csv(write_tracks_csv(path, tracks))
    if len(np.unique(tracks.frame)) < 2:
        assert again.clock is None
    else:
        np.testing.assert_allclose(again.time, tracks.time, atol=1e-6)
        assert again.clock.utc == (clock.start > 1e9)
    if len(tracks) and np.ptp(tracks.frame) > 100 and clock.start < 1e9:
        assert again.clock.frame_rate == pytest.approx(clock.frame_rate, rel=1e-9)


def test_common_clocks_come_back_from_csv_as_they_were(tmp_path):
    for clock in (Clock(25.0), Clock(30000 / 1001, 12.5), Clock(5.0, 1.7e9, utc=True), None):
        path = write_tracks_csv(tmp_path / "tracks.csv", one_track(clock=clock))
        assert read_tracks_csv(path).clock == clock


@given(st.sampled_from([1.0, 12.5, 25.0, 29.97, 1000.0]), st.integers(1, 200), st.integers(1, 200))
def test_frames_that_count_from_1970_come_back_from_csv(tmp_path_factory, rate, one, two):
    clock = Clock(rate, 0.0, utc=True)
    first = int(1.7e9 * rate)
    tracks = one_track(clock=clock, frame=np.array([first, first + one, first + one + two]))
    path = tmp_path_factory.mktemp("csv") / "tracks.csv"
    assert read_tracks_csv(write_tracks_csv(path, tracks)).clock == clock


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("velocity_x", "1e400", r"velocity\[1, 0\] is inf, not a velocity"),
        ("velocity_y", "-inf", r"velocity\[1, 1\] is -inf, not a velocity"),
        ("velocity_covariance_xx", "-1.0", r"velocity_covariance\[1, 0, 0\] is -1.0, not a var"),
        ("covariance_yy", "-0.5", r"covariance\[1, 1, 1\] is -0.5, not a variance"),
        ("supporting_cameras", "-1", r"supporting_cameras\[1\] is -1, not a number of cameras"),
    ],
)
def test_numbers_that_no_track_has_are_refused(column, value, said, tmp_path):
    path = write_tracks_csv(tmp_path / "tracks.csv", one_track())
    header, first, second, *rest = (line.split(",") for line in path.read_text().splitlines())
    second[header.index(column)] = value
    path.write_text("\n".join(",".join(line) for line in (header, first, second, *rest)))
    with pytest.raises(InvalidInputError, match=rf"tracks\.csv: {said}"):
        read_tracks_csv(path)


@pytest.mark.parametrize("times", [(0.0, 1.0, 1.5), (2.0, 1.0, 0.0), (0, 0, 0), (0, "nan", 2)])
def test_times_of_no_clock_are_refused(times, tmp_path):
    path = write_tracks_csv(tmp_path / "tracks.csv", one_track())
    lines = path.read_text().splitlines()
    assert lines[0].endswith(",time_s")
    rows = [f"{line}{time}" for line, time in zip(lines[1:], times, strict=True)]
    path.write_text("\n".join([lines[0], *rows]))
    with pytest.raises(FileFormatError, match=r"tracks\.csv: column 'time_s' is invalid"):
        read_tracks_csv(path)


def test_a_table_of_version_0_2_gives_no_clock(tmp_path):
    path = write_tracks_csv(tmp_path / "tracks.csv", one_track())
    path.write_text(
        "".join(f"{line.rpartition(',')[0]}\n" for line in path.read_text().splitlines())
    )
    assert "time_s" not in path.read_text()
    assert read_tracks_csv(path).clock is None


@pytest.mark.slow
@given(drawn=track_arguments(), clock=st.none() | st.builds(Clock, POSITIVE, FINITE))
def test_parquet_gives_back_the_table_bit_for_bit(drawn, clock, tmp_path_factory):
    path = tmp_path_factory.mktemp("parquet") / "t.parquet"
    tracks = Tracks(**drawn, clock=clock)
    again = read_tracks_parquet(write_tracks_parquet(path, tracks))
    assert again.to_arrow().equals(tracks.to_arrow(), check_metadata=True)
    assert again.clock == clock


def test_pandas_reads_parquet_without_us(tmp_path):
    clock = Clock(25.0, 1.7e9, utc=True)
    tracks = one_track(clock=clock, support=np.array([[0, 1, 2], [0, 1, -1], [-1, 3, 4]]))
    path = write_tracks_parquet(tmp_path / "t.parquet", tracks, ["a", "b", "c"])
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = pandas.read_parquet(path)
    np.testing.assert_array_equal(frame["time_s"], tracks.time)
    assert frame["cameras"].tolist() == [7, 3, 6]
    assert frame["origin"].tolist() == ["detected", "detected", "extended"]
    assert frame["existence"].isna().all()
    # Tracks are also read from another program's table with the metadata of the file.
    about = pyarrow.parquet.read_schema(path).metadata
    later = pyarrow.Table.from_pandas(frame[frame["frame"] > 0], preserve_index=False)
    again = Tracks.from_arrow(later.replace_schema_metadata(about))
    np.testing.assert_array_equal(again.ground_xy, tracks.ground_xy[1:])
    assert again.clock == clock


def test_the_documented_way_to_read_it(tmp_path, monkeypatch, capsys):
    tracks = one_track(
        clock=Clock(5.0, 1.7e9, utc=True), support=np.array([[0, 1], [0, -1], [-1, 3]])
    )
    (tmp_path / "results").mkdir()
    write_tracks_parquet(tmp_path / "results" / "tracks.parquet", tracks)
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[3] / "docs" / "table.md"
    first, second, *_ = re.findall(
        r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE
    )
    found: dict = {}
    exec(first, found)
    assert len(found["north"]) == 2
    assert str(found["tracks"]["when"][0]) == "2023-11-14 22:13:20+00:00"
    exec(second, found)
    assert capsys.readouterr().out == "1970-01-01T00:00:00Z\n"


@pytest.mark.slow
def test_polars_reads_parquet_without_us(tmp_path):
    polars = pytest.importorskip("polars", reason="polars is not installed")
    tracks = one_track(clock=Clock(25.0))
    path = write_tracks_parquet(tmp_path / "t.parquet", tracks)
    frame = polars.read_parquet(path)
    assert frame["time_s"].to_list() == tracks.time.tolist()
    assert frame["origin"].to_list() == ["detected", "detected", "extended"]
    assert frame["cameras"].null_count() == 3
    assert polars.scan_parquet(path).filter(polars.col("frame") > 0).collect().height == 2
    again = frame.to_arrow().replace_schema_metadata(pyarrow.parquet.read_schema(path).metadata)
    assert Tracks.from_arrow(again).to_arrow().equals(tracks.to_arrow())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: b"", "is not readable Parquet"),
        (lambda content: content[:-20], "is not readable Parquet"),
        (lambda content: content.replace(b"detected", b"guessing"), "is not readable Parquet.*CRC"),
    ],
)
def test_damaged_parquet_is_named(change, message, tmp_path):
    path = write_tracks_parquet(tmp_path / "t.parquet", one_track())
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(FileFormatError, match=r"t\.parquet.*" + message):
        read_tracks_parquet(path)


def test_parquet_of_earlier_versions_is_named(tmp_path):
    path = tmp_path / "t.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"frame": [0], "position_x": [1.0]}), path)
    with pytest.raises(FileFormatError, match=r"t\.parquet: The table has no column 'time_s'"):
        read_tracks_parquet(path)
    with pytest.raises(InvalidInputError, match="There is no file"):
        read_tracks_parquet(tmp_path / "absent.parquet")


def test_a_table_of_version_0_1_gives_no_velocities(tmp_path):
    path = write_tracks_csv(tmp_path / "tracks.csv", one_track())
    lines = [line.split(",") for line in path.read_text().splitlines()]
    kept = [at for at, name in enumerate(lines[0]) if not name.startswith("velocity")]
    path.write_text("".join(",".join(line[at] for at in kept) + "\n" for line in lines))
    again = read_tracks_csv(path)
    np.testing.assert_array_equal(again.position, one_track().position)
    assert np.isnan(again.velocity).all()
    assert np.isnan(again.velocity_covariance).all()


def one_track(**changes) -> Tracks:
    values = {
        "frame": np.array([0, 5, 15]),
        "track_id": np.array([0, 0, 0]),
        "position": np.array([[1.0, 2, 0], [1.5, 2, 0], [2, 2, 0]]),
        "ground_xy": np.array([[1.0, 2], [1.5, 2], [2, 2]]),
        "sigma": np.full(3, 0.1),
        "covariance": np.tile(0.01 * np.eye(2), (3, 1, 1)),
        "supporting_cameras": np.array([3, 3, 2]),
        "origin": np.array([0, 0, 1]),
    }
    return Tracks(**(values | changes))


def test_parquet_without_pyarrow(tmp_path, monkeypatch):
    original = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingDependencyError, match=r"pip install 'catfree\[parquet\]'"):
        write_tracks_parquet(tmp_path / "t.parquet", one_track())
    with pytest.raises(MissingDependencyError, match=r"pip install 'catfree\[parquet\]'"):
        read_tracks_parquet(tmp_path / "t.parquet")


def test_parquet_without_rows_has_the_columns_of_one_with_rows(tmp_path):
    nobody = empty_localization(2).tracks
    schemas = [
        pyarrow.parquet.read_schema(write_tracks_parquet(tmp_path / "t.parquet", tracks))
        for tracks in (one_track(), nobody)
    ]
    assert schemas[0].equals(schemas[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "no column 'frame'"),
        (lambda text: text.replace("sigma", "spread"), "no column 'sigma'"),
        (lambda text: text.replace("detected", "guessed"), "column 'origin'"),
        (lambda text: text[:-30], "line 4 has"),
        (lambda text: text.replace("\n0,", "\n99999999999999999999,"), "column 'frame'"),
        (lambda text: text + "x" * 200_000, "is not valid CSV"),
        (lambda text: text.replace("0.1", "wide"), "column 'sigma'"),
        (lambda text: text.replace("\n", ",9\n").replace(",9", ",x", 1), "two columns 'x'"),
    ],
)
def test_damaged_csv_is_named(change, message, tmp_path):
    path = write_tracks_csv(tmp_path / "tracks.csv", one_track())
    path.write_text(change(path.read_text()))
    with pytest.raises(FileFormatError, match=r"tracks\.csv.*" + message):
        read_tracks_csv(path)


BOX = st.tuples(FINITE, FINITE, POSITIVE, POSITIVE)


@pytest.mark.slow
@given(
    rows=st.lists(
        st.tuples(st.integers(0, 5), BOX, st.floats(0, 1), st.integers(-1, 9)), max_size=6
    ),
    step=st.integers(1, 7),
    start=st.integers(-20, 2000),
)
def test_boxes_round_trip(rows, step, start, tmp_path_factory):
    path = tmp_path_factory.mktemp("mot") / "det.txt"
    frames = start + step * np.arange(6)
    box = np.array([(x, y, x + w, y + h) for _, (x, y, w, h), _, _ in rows]).reshape(-1, 4)
    frame = frames[[row[0] for row in rows]] if rows else np.empty(0, np.int64)
    score = np.array([row[2] for row in rows])
    boxes = Detections(frame, np.full(len(rows), 2), box, score=score)
    identity = np.array([row[3] for row in rows], np.int64)
    write_mot_boxes(path, boxes, frames, identity)
    table = read_mot(path, frames=frames)
    order = np.lexsort((identity, frame))
    np.testing.assert_array_equal(table.frame, frame[order])
    np.testing.assert_allclose(table.box, box[order], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(
        np.where(table.identity > 0, table.identity - 1, -1), identity[order]
    )
    if rows:
        again = table.detections(camera=2)
        np.testing.assert_array_equal(again.score, score[order])
        np.testing.assert_array_equal(again.camera, 2)


def test_mot_example(tmp_path):
    path = tmp_path / "det.txt"
    path.write_text("1,-1,100,200,50,80.5,0.9,-1,-1,-1\n\n3, 7, 10, 20, 5, 8, 0.5, 1.5, 2.5, 0\n")
    table = read_mot(path)
    np.testing.assert_array_equal(table.frame, [1, 3])
    np.testing.assert_array_equal(table.identity, [-1, 7])
    np.testing.assert_array_equal(table.box, [[100, 200, 150, 280.5], [10, 20, 15, 28]])
    np.testing.assert_array_equal(table.to_rows(), [[1, -1, -1, -1], [3, 7, 1.5, 2.5]])
    (tmp_path / "six.txt").write_text("1 2 3 4 5 6\n")
    six = read_mot(tmp_path / "six.txt")
    assert six.confidence is None
    assert six.world is None
    assert six.detections().score is None
    with pytest.raises(InvalidInputError, match=r"six\.txt has no world positions"):
        six.to_rows()


def test_unknown_confidences_are_no_scores(tmp_path):
    path = tmp_path / "det.txt"
    path.write_text("1,1,1,1,2,2,-1,-1,-1,-1\n")
    assert read_mot(path).detections().score is None
    path.write_text("1,1,1,1,2,2,37.5,-1,-1,-1\n")
    with pytest.raises(InvalidInputError, match=r"det\.txt: score in line 1 is 37\.5"):
        read_mot(path).detections()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3,4,5\n", "line 1 has 5 columns"),
        ("1,2,3,4,5,6,1\n1,2,3,4,5,6\n", "line 2 has 6 columns instead of 7"),
        ("1,2,3,4,5,six\n", "line 1 has a value that is not a number"),
        ("1,2,3,4,5,nan\n", "line 1 has a number that is not finite"),
        ("1.5,2,3,4,5,6\n", "column 1 of line 1 is 1.5, not a whole"),
        ("1e23,2,3,4,5,6\n", r"column 1 of line 1 is 1e\+23, not a whole number below"),
        (
            "1,2,3,4,5,6\n1,-9007199254740993,3,4,5,6\n",
            "column 2 of line 2 is -9.*, not a whole number below",
        ),
        ("1,2,3,4,5,6\n\n1,2,3,4,0,6\n", "box in line 3 is"),
    ],
)
def test_damaged_mot_is_named(text, message, tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text(text)
    with pytest.raises(CatFreeError, match=r"gt\.txt.*" + message):
        read_mot(path).detections()


def test_frames_outside_the_sequence(tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text("4,1,1,1,2,2\n")
    with pytest.raises(
        InvalidInputError, match="frame in line 1 is 4, but the sequence has frames 1 to 3"
    ):
        read_mot(path, frames=[0, 5, 10])
    with pytest.raises(InvalidInputError, match="frame 15 is not among the 2 frames"):
        write_mot_ground(path, one_track(), [0, 5])
    with pytest.raises(InvalidInputError, match="2 cameras"):
        write_mot_boxes(path, Detections([0, 0], [0, 1], [[0, 0, 1, 1]] * 2), [0])


def test_a_range_of_frames_is_the_list_of_its_frames(tmp_path):
    path = tmp_path / "tracks.txt"
    for frames in (range(-5, 16, 5), range(0, 16), range(15, -1, -5)):
        listed = write_mot_ground(path, one_track(), list(frames)).read_text()
        assert write_mot_ground(path, one_track(), frames).read_text() == listed
    for frames in (range(0, 15, 5), range(5, 20, 5), range(0, 20, 2)):
        with pytest.raises(InvalidInputError, match=f"not among the {len(frames)} frames"):
            write_mot_ground(path, one_track(), frames)
    assert write_mot_ground(path, one_track(), range(0, 10**12, 5)).read_text()


def test_numbers_that_no_reader_takes_are_not_written(tmp_path):
    path, boxes = tmp_path / "gt.txt", Detections([0, 5], [0, 0], [[0, 0, 1, 1]] * 2)
    lost = one_track(ground_xy=np.array([[1.0, 2], [np.nan, 2], [2, 2]]))
    with pytest.raises(InvalidInputError, match=r"position in row 1 \(frame 5\) is not finite"):
        write_mot_ground(path, lost, [0, 5, 15])
    unsure = one_track(existence=np.array([1.0, 0.5, np.nan]))
    with pytest.raises(InvalidInputError, match=r"score in row 2 \(frame 15\) is not finite"):
        write_mot_ground(path, unsure, [0, 5, 15])
    with pytest.raises(InvalidInputError, match="threshold is inf"):
        write_mot_ground(path, one_track(), [0, 5, 15], threshold=np.inf)
    for frames in ([0, np.nan], ["first", "second"], [0.5, 5]):
        with pytest.raises(InvalidInputError, match="frames"):
            write_mot_ground(path, one_track(), frames)
        with pytest.raises(InvalidInputError, match="frames"):
            write_mot_boxes(path, boxes, frames)
    with pytest.raises(InvalidInputError, match=r"identity\[1\] is nan"):
        write_mot_boxes(path, boxes, [0, 5], [0, np.nan])
    assert list(tmp_path.iterdir()) == []


def test_ground_squares_overlap_by_half_at_the_threshold(tmp_path):
    frames = [0, 5, 10, 15]
    shifted = one_track(ground_xy=np.array([[1.6, 2], [2.1, 2], [2.6, 2]]))
    paths = [
        write_mot_ground(tmp_path / f"{at}.txt", tracks, frames, threshold=0.6)
        for at, tracks in enumerate((one_track(), shifted))
    ]
    first, second = (read_mot(path) for path in paths)
    np.testing.assert_array_equal(first.frame, [1, 2, 4])
    np.testing.assert_array_equal(first.identity, 1)
    np.testing.assert_allclose(
        (first.box[:, :2] + first.box[:, 2:]) / 2, one_track().ground_xy, atol=1e-12
    )
    low = np.maximum(first.box[:, :2], second.box[:, :2])
    high = np.minimum(first.box[:, 2:], second.box[:, 2:])
    common = (high - low).prod(-1)
    area = (first.box[:, 2:] - first.box[:, :2]).prod(-1)
    np.testing.assert_allclose(common / (2 * area - common), 0.5)
    # TrackEval takes column 8 as the class, which must be pedestrian: 1.
    assert all(line.split(",")[6:] == ["1.0", "1", "1"] for line in lines(paths[0]))


def lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


@pytest.mark.parametrize("write", [write_tracks_csv, write_tracks_parquet])
def test_writers_need_the_folder(write, tmp_path):
    with pytest.raises(InvalidInputError, match="does not exist"):
        write(tmp_path / "nowhere" / "tracks", one_track())


def test_true_positions_are_written_as_tracks_are(tmp_path):
    rows = np.array([[5, 1, 0.5, 2.0], [0, 0, -1.0, 3.0]])
    one = Tracks(
        frame=rows[:, 0].astype(np.int64),
        track_id=rows[:, 1].astype(np.int64),
        position=np.zeros((2, 3)),
        ground_xy=rows[:, 2:],
        sigma=np.ones(2),
        covariance=np.zeros((2, 2, 2)),
        supporting_cameras=np.ones(2, np.int64),
        origin=np.zeros(2, np.int64),
    )
    truth = write_mot_ground(tmp_path / "gt.txt", rows, [0, 5])
    assert truth.read_text() == write_mot_ground(tmp_path / "tracks.txt", one, [0, 5]).read_text()
    assert write_mot_ground(tmp_path / "none.txt", [], [0]).read_text() == ""
    nameless = write_mot_ground(tmp_path / "all.txt", rows - np.array([0, 7, 0, 0]), [0, 5])
    np.testing.assert_array_equal(read_mot(nameless).identity, [-1, -1])
    with pytest.raises(InvalidInputError, match=r"must have shape \(n, 4\), got \(2, 3\)"):
        write_mot_ground(tmp_path / "a.txt", rows[:, :3], [0, 5])
