"""`Tracks.to_arrow` and `Tracks.from_arrow`: every number, and the view of other programs."""

import inspect
import json
import warnings

import numpy as np
import pyarrow
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.errors import FileFormatError, InvalidInputError
from catfree.methods.paper._assemble import empty_localization
from catfree.types import Clock, Plane, Tracks

COLUMNS = ["time_s", "frame", "track_id", "x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy"]
COLUMNS += ["existence", "sigma", "origin", "cameras"]
NAMES = ("north", "east", "south")
clocks = st.none() | st.builds(Clock, st.floats(0.01, 1e3), st.floats(-1e3, 2e9), st.booleans())


@st.composite
def any_tracks(draw, cameras=3):
    """Draw arguments of `Tracks` with and without clock, existence, velocities and support."""
    count = draw(st.integers(0, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    unknown = rng.random((count, 1)) < 0.3
    supported = draw(st.booleans())
    return {
        "frame": np.sort(rng.integers(-100, 2**40, count)),
        "track_id": rng.integers(-1, 9, count),
        "position": rng.standard_normal((count, 3)),
        "ground_xy": rng.standard_normal((count, 2)) * 10.0 ** rng.integers(-3, 4),
        "sigma": rng.random(count),
        "covariance": np.tile(np.cov(rng.standard_normal((2, 9))), (count, 1, 1)),
        "supporting_cameras": rng.integers(0, 4, count),
        "origin": rng.integers(0, 3, count),
        "existence": rng.random(count) if draw(st.booleans()) else None,
        "support": rng.integers(-1, 5, (count, cameras)) if supported else None,
        "velocity": np.where(unknown, np.nan, rng.standard_normal((count, 2))),
        "clock": draw(clocks),
    }


def one_track(**changes):
    values = {
        "frame": np.array([0, 5]),
        "track_id": np.array([2, 2]),
        "position": np.zeros((2, 3)),
        "ground_xy": np.array([[1.0, 2], [3, 4]]),
        "sigma": np.array([0.5, np.inf]),
        "covariance": np.tile(np.array([[1.0, 2], [2, 5]]), (2, 1, 1)),
        "supporting_cameras": np.array([2, 1]),
        "origin": np.array([0, 2]),
        "support": np.array([[7, -1, 0], [-1, 3, -1]]),
        "velocity": np.array([[0.5, 1], [np.nan, np.nan]]),
        "clock": Clock(10.0, 100.0),
    }
    return Tracks(**(values | changes))


@given(any_tracks())
def test_a_table_that_was_read_is_the_same_table(drawn):
    tracks = Tracks(**drawn)
    table = tracks.to_arrow(NAMES)
    again = Tracks.from_arrow(table).to_arrow(NAMES)
    assert again.equals(table, check_metadata=True)


@given(any_tracks())
def test_tracks_that_were_read_are_the_same_tracks(drawn):
    tracks = Tracks(**drawn)
    again = Tracks.from_arrow(tracks.to_arrow())
    assert again.clock == tracks.clock
    for name in ("frame", "track_id", "ground_xy", "sigma", "origin"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tracks, name), strict=True)
    np.testing.assert_array_equal(again.covariance[:, 0], tracks.covariance[:, 0])
    np.testing.assert_array_equal(again.covariance[:, 1, 1], tracks.covariance[:, 1, 1])
    if tracks.existence is None:
        assert again.existence is None
    else:
        np.testing.assert_array_equal(again.existence, tracks.existence)
    if tracks.clock is None:
        assert np.isnan(again.velocity).all()
    else:
        np.testing.assert_allclose(again.velocity, tracks.velocity, rtol=3e-16)
    counts = (tracks.support >= 0).sum(1)
    np.testing.assert_array_equal(again.supporting_cameras, counts)


def test_the_columns_and_what_they_hold():
    table = one_track().to_arrow(NAMES)
    assert table.column_names == COLUMNS
    assert table.to_pylist() == [
        {
            "time_s": 100.0, "frame": 0, "track_id": 2, "x": 1.0, "y": 2.0, "vx": 5.0, "vy": 10.0,
            "cov_xx": 1.0, "cov_xy": 2.0, "cov_yy": 5.0, "existence": None, "sigma": 0.5,
            "origin": "detected", "cameras": 0b101,
        },
        {
            "time_s": 100.5, "frame": 5, "track_id": 2, "x": 3.0, "y": 4.0, "vx": None, "vy": None,
            "cov_xx": 1.0, "cov_xy": 2.0, "cov_yy": 5.0, "existence": None, "sigma": float("inf"),
            "origin": "interpolated", "cameras": 0b010,
        },
    ]  # fmt: skip
    kinds = dict(zip(table.column_names, map(str, table.schema.types), strict=True))
    assert kinds["frame"] == kinds["track_id"] == "int64"
    assert kinds["cameras"] == "uint64"
    assert {kinds[name] for name in COLUMNS[3:12]} == {"double"} == {kinds["time_s"]}


def test_without_a_clock_there_is_no_time_and_no_speed():
    table = one_track(clock=None, existence=np.array([0.5, 1])).to_arrow()
    assert table["time_s"].null_count == table["vx"].null_count == 2
    assert table["existence"].to_pylist() == [0.5, 1.0]
    assert table.schema.metadata[b"time_zero"] == b"unknown"


def test_the_metadata_can_be_read_by_people_and_programs():
    noon = Clock(25.0, 1.7e9, utc=True)
    about = one_track(clock=noon).to_arrow(NAMES).schema.metadata
    text = {key.decode(): value.decode() for key, value in about.items()}
    assert text["time_zero"] == "1970-01-01T00:00:00Z"
    assert text["frame_zero"] == "2023-11-14T22:13:20Z"
    assert json.loads(text["clock"]) == {"frame_rate": 25.0, "start": 1.7e9, "utc": True}
    assert json.loads(text["camera_names"]) == list(NAMES)
    assert text["catfree_version"] == cf.__version__
    assert "vx, vy: scene units per second" in text["units"]
    assert "ground" in text["frame_of_reference"]
    recorded = one_track().to_arrow().schema.metadata
    assert recorded[b"time_zero"] == b"start of recording"


def test_a_table_without_rows_has_the_columns_and_types_of_one_with_rows():
    nobody = empty_localization(3).tracks.to_arrow()
    assert nobody.schema.equals(one_track().to_arrow().schema)
    assert len(Tracks.from_arrow(nobody)) == 0
    found = Tracks.from_arrow(empty_localization(3, existence=True).tracks.to_arrow())
    assert found.existence is not None


def test_parts_are_read_as_one():
    table = one_track().to_arrow(NAMES)
    both = pyarrow.concat_tables([table, table.slice(1), table.slice(0, 0)])
    assert Tracks.from_arrow(both).frame.tolist() == [0, 5, 5]
    assert Tracks.from_arrow(both).cameras.tolist() == [5, 2, 2]


def test_a_column_that_occurs_twice_is_refused():
    table = one_track().to_arrow()
    with pytest.raises(FileFormatError, match="two columns 'x'"):
        Tracks.from_arrow(table.append_column("x", table["x"]))


@pytest.mark.parametrize("speed", [np.finfo(float).max, np.inf])
def test_velocities_beyond_all_people_are_read_or_refused_without_a_warning(speed):
    table = one_track(clock=Clock(5.0)).to_arrow()
    at = table.schema.get_field_index("vx")
    table = table.set_column(at, table.schema.field(at), pyarrow.array([speed, None]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if np.isfinite(speed):
            assert Tracks.from_arrow(table).velocity[0, 0] * 5 == speed
        else:
            with pytest.raises(InvalidInputError, match="velocity"):
                Tracks.from_arrow(table)


def test_positions_lie_on_the_ground():
    ground = Plane([0.1, -0.2, 1.0], 3.0)
    again = Tracks.from_arrow(one_track().to_arrow(), ground)
    np.testing.assert_allclose(ground.signed_distance(again.position), 0, atol=1e-12)
    np.testing.assert_allclose(again.position @ ground.basis, again.ground_xy)
    assert np.isnan(Tracks.from_arrow(one_track().to_arrow()).position).all()


def test_64_cameras_have_bits_and_65_have_not():
    support = np.full((2, 64), -1)
    support[0, 63] = support[1, 0] = 4
    tracks = one_track(support=support)
    assert tracks.to_arrow()["cameras"].to_pylist() == [2**63, 1]
    np.testing.assert_array_equal(Tracks.from_arrow(tracks.to_arrow()).supporting_cameras, [1, 1])
    more = one_track(support=np.full((2, 65), -1))
    with pytest.raises(InvalidInputError, match="at most 64 cameras, but there are 65: camera 64"):
        more.to_arrow()
    with pytest.raises(InvalidInputError, match="camera 'c64' has none"):
        more.to_arrow([f"c{camera}" for camera in range(65)])
    with pytest.raises(InvalidInputError, match="2 names, but there are 3 cameras"):
        one_track().to_arrow(["a", "b"])
    with pytest.raises(InvalidInputError, match="camera_names must be a list, got set"):
        inspect.unwrap(Tracks.to_arrow)(one_track(), {"a", "b", "c"})


def changed(name, values, kind):
    table = one_track().to_arrow()
    at = table.column_names.index(name)
    return table.set_column(at, name, pyarrow.array(values, kind))


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda t: t.drop_columns(["x"]), FileFormatError, "no column 'x'"),
        (lambda t: t.replace_schema_metadata({}), FileFormatError, "metadata do not say"),
        (
            lambda t: t.replace_schema_metadata({"table": "catfree tracks, version 1"}),
            FileFormatError,
            "metadata of a table of tracks are damaged",
        ),
        (
            lambda t: t.replace_schema_metadata(
                t.schema.metadata | {b"clock": b'{"frame_rate": 0, "start": 0, "utc": false}'}
            ),
            FileFormatError,
            "damaged: frame_rate is 0",
        ),
        (
            lambda t: changed("frame", [0.5, 1], pyarrow.float64()).replace_schema_metadata(
                t.schema.metadata
            ),
            FileFormatError,
            "Column 'frame' has type double, not int64",
        ),
        (lambda t: changed("x", [1.0, None], None), FileFormatError, "row of column 'x'"),
        (lambda t: changed("cameras", [1, None], pyarrow.uint64()), FileFormatError, "'cameras'"),
        (lambda t: changed("origin", ["detected", "lost"], None), FileFormatError, "'lost'"),
        (lambda t: changed("sigma", [1.0, -1], None), InvalidInputError, r"sigma\[1\] is .*-1"),
        (lambda t: t.to_pandas(), InvalidInputError, "got DataFrame"),
    ],
)
def test_what_is_not_a_table_of_tracks(make, error, message):
    with pytest.raises(error, match=message):
        Tracks.from_arrow(make(one_track().to_arrow()))
