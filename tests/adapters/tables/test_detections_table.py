"""Tables of detections are read back as written, whole or in a range of frames."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import (
    read_detections,
    read_detections_parquet,
    write_detections_parquet,
)
from catfree.adapters.tables._detections_table import frame_range
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Clock, Detections

pytest.importorskip("pyarrow", reason="pyarrow is not installed")


def boxes(seed, count, frames, width, with_options, clock):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 500, (count, 2))
    options = {}
    if with_options:
        options = {
            "score": rng.uniform(0, 1, count),
            "ankles_confirmed": rng.random(count) > 0.5,
            "embedding": rng.normal(size=(count, width)),
            "keypoints": rng.uniform(0, 1, (count, 17, 3)),
        }
    return Detections(
        rng.integers(0, frames, count), rng.integers(0, 4, count),
        np.hstack([corner, corner + rng.uniform(1, 90, (count, 2))]), clock=clock, **options,
    )  # fmt: skip


def assert_equal(one, two):
    assert one.clock == two.clock
    for name in ("frame", "camera", "box", "score", "ankles_confirmed", "embedding", "keypoints"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.slow
@given(
    st.integers(0, 2**16), st.integers(0, 40), st.integers(1, 20), st.integers(1, 5),
    st.booleans(), st.none() | st.just(Clock(12.5, 1e9 + 0.1, True)), st.data(),
)  # fmt: skip
def test_any_range_of_frames_is_read_as_it_was_written(
    tmp_path_factory, seed, count, frames, width, with_options, clock, data
):
    written = boxes(seed, count, frames, width, with_options, clock)
    path = write_detections_parquet(tmp_path_factory.mktemp("boxes") / "b.parquet", written)
    ordered = written[np.lexsort((written.camera, written.frame))]
    assert_equal(read_detections_parquet(path), ordered)
    first, stop = (data.draw(st.none() | st.integers(-2, frames + 2)) for _ in range(2))
    low, high = -np.inf if first is None else first, np.inf if stop is None else stop
    inside = (ordered.frame >= low) & (ordered.frame < high)
    assert_equal(read_detections_parquet(path, first, stop), ordered[inside])


def test_a_table_without_boxes_keeps_its_columns(tmp_path):
    nobody = boxes(0, 0, 1, 5, True, None)
    assert_equal(read_detections_parquet(write_detections_parquet(tmp_path / "b", nobody)), nobody)


def test_a_folder_of_tables_is_one_table(tmp_path):
    whole = boxes(0, 30, 10, 3, True, Clock(5.0))
    whole = whole[np.lexsort((whole.camera, whole.frame))]
    for index, half in enumerate((whole[whole.frame < 5], whole[whole.frame >= 5])):
        write_detections_parquet(tmp_path / f"{index}.parquet", half)
    assert_equal(read_detections_parquet(tmp_path), whole)


def test_other_files_beside_tables_are_named(tmp_path):
    write_detections_parquet(tmp_path / "a.parquet", boxes(0, 30, 10, 3, True, Clock(5.0)))
    (tmp_path / "_SUCCESS").touch()
    assert len(read_detections_parquet(tmp_path)) == 30
    (tmp_path / "notes.md").touch()
    with pytest.raises(InvalidInputError, match=r"other files, such as notes\.md\. Name the file"):
        read_detections_parquet(tmp_path)


def test_lists_of_one_length_are_vectors(tmp_path):
    import pyarrow
    import pyarrow.parquet

    written = boxes(0, 7, 3, 5, True, None)
    ordered = written[np.lexsort((written.camera, written.frame))]
    path = write_detections_parquet(tmp_path / "b.parquet", written)
    table = pyarrow.parquet.read_table(path)
    for name in ("embedding", "keypoints"):  # in pandas' form
        at = table.schema.get_field_index(name)
        table = table.set_column(at, name, pyarrow.array(table[name].to_pylist()))
    pyarrow.parquet.write_table(table, path)
    assert_equal(read_detections_parquet(path), ordered)
    assert len(read_detections_parquet(path, stop=-1)) == 0
    for lists in ([[1.0]] * 6 + [[1.0, 2.0]], [[1.0]] * 6 + [None]):
        uneven = table.set_column(at - 1, "embedding", pyarrow.array(lists))
        pyarrow.parquet.write_table(uneven, path)
        with pytest.raises(FileFormatError, match=r"b\.parquet .* have different lengths"):
            read_detections_parquet(path)


def test_other_files_are_refused(tmp_path):
    import pyarrow
    import pyarrow.parquet

    with pytest.raises(InvalidInputError, match=r"no table of detections .*none\.parquet"):
        read_detections_parquet(tmp_path / "none.parquet")
    path = tmp_path / "b.parquet"
    path.write_text("no table")
    with pytest.raises(FileFormatError, match=r"b\.parquet is not readable Parquet"):
        read_detections_parquet(path)
    pyarrow.parquet.write_table(pyarrow.table({"frame": [1], "camera": [0]}), path)
    with pytest.raises(FileFormatError, match="has no column 'x1'"):
        read_detections_parquet(path)
    table = {name: [1.0] for name in ("camera", "x1", "y1", "x2", "y2")} | {"frame": ["one"]}
    pyarrow.parquet.write_table(pyarrow.table(table), path)
    with pytest.raises((FileFormatError, InvalidInputError), match=r"b\.parquet"):
        read_detections_parquet(path)


def test_a_text_file_is_refused_with_what_reads_it(tmp_path):
    path = tmp_path / "boxes.csv"
    path.write_text("frame,camera,x1,y1,x2,y2\n0,0,1,2,3,4\n")
    with pytest.raises(FileFormatError, match=r"Read it with `cf\.read_detections`"):
        read_detections_parquet(path)


@pytest.mark.parametrize(
    ("clock", "sentence"),
    [
        ("five", "is not a clock"),
        ("[1]", "is not a clock"),
        ('{"frame_rate": 5}', "is not a clock: 'start'"),
        ('{"frame_rate": 0, "start": 0, "utc": false}', "frame_rate is 0"),
    ],
)
def test_a_damaged_clock_is_refused(tmp_path, clock, sentence):
    import pyarrow.parquet

    path = write_detections_parquet(tmp_path / "b.parquet", boxes(0, 3, 3, 0, False, Clock(5.0)))
    table = pyarrow.parquet.read_table(path).replace_schema_metadata({"clock": clock})
    pyarrow.parquet.write_table(table, path)
    with pytest.raises(InvalidInputError, match=r"b\.parquet: .*" + sentence):
        read_detections_parquet(path)


@pytest.mark.parametrize("kind", ["timestamp[ns]", "duration[s]", "date32", "bool"])
def test_boxes_are_numbers(tmp_path, kind):
    import pyarrow.parquet

    write_detections_parquet(tmp_path / "a.parquet", boxes(0, 3, 5, 2, False, None))
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    at = table.schema.get_field_index("y1")
    table = table.set_column(at, "y1", pyarrow.nulls(3, pyarrow.type_for_alias(kind)))
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    for read in (read_detections_parquet, read_detections):
        with pytest.raises((FileFormatError, InvalidInputError), match=r"a\.parquet"):
            read(tmp_path / "a.parquet")


@pytest.mark.parametrize("name", ["frame", "camera", "y1", "score", "embedding", "keypoints"])
def test_a_column_that_occurs_twice_is_named(tmp_path, name):
    import pyarrow.parquet

    write_detections_parquet(tmp_path / "a.parquet", boxes(0, 3, 5, 2, True, None))
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    pyarrow.parquet.write_table(table.append_column(name, table[name]), tmp_path / "a.parquet")
    for read, path in (
        (read_detections_parquet, tmp_path / "a.parquet"),
        (read_detections, tmp_path / "a.parquet"),
        (read_detections, tmp_path),
    ):
        with pytest.raises(FileFormatError, match=f"two columns '{name}'|duplicate field"):
            read(path)


def test_names_of_columns_that_are_no_text_are_refused(tmp_path):
    write_detections_parquet(tmp_path / "a.parquet", boxes(0, 3, 5, 2, False, None))
    content = (tmp_path / "a.parquet").read_bytes()
    (tmp_path / "a.parquet").write_bytes(content.replace(b"frame", b"\xf8rame"))
    for read in (read_detections_parquet, read_detections, frame_range):
        with pytest.raises((FileFormatError, InvalidInputError), match=r"a\.parquet"):
            read(tmp_path / "a.parquet")


@pytest.mark.parametrize("frame", [["x", "y"], [None, None], [0.5, 1.0], [float("nan"), 1.0]])
def test_frames_of_a_range_are_whole_numbers(frame, tmp_path):
    import pyarrow.parquet

    columns = {"frame": frame} | {name: [0, 1] for name in ("camera", "x1", "y1", "x2", "y2")}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    with pytest.raises((FileFormatError, InvalidInputError), match=r"a\.parquet"):
        frame_range(tmp_path / "a.parquet")


def test_a_range_of_a_damaged_table_is_refused(tmp_path):
    write_detections_parquet(tmp_path / "a.parquet", boxes(0, 300, 5, 2, False, None))
    content = bytearray((tmp_path / "a.parquet").read_bytes())
    content[4:60] = bytes(56)
    (tmp_path / "a.parquet").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"a\.parquet is not readable Parquet"):
        frame_range(tmp_path / "a.parquet")


@given(st.data())
def test_a_flipped_bit_gives_no_other_boxes(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("boxes") / "b.parquet"
    written = boxes(0, 30, 9, 3, True, None)
    content = bytearray(write_detections_parquet(path, written).read_bytes())
    expected = read_detections_parquet(path)
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    content[data.draw(st.integers(4, footer - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    with contextlib.suppress(FileFormatError, InvalidInputError):
        assert_equal(read_detections_parquet(path), expected)


def test_tables_of_named_cameras_keep_ankles_and_clock(tmp_path):
    import pyarrow.parquet

    box = [[0, 0, 5, 9]] * 2
    saved = Detections([0, 1], [0, 1], box, None, [True, False], clock=Clock(5))
    path = write_detections_parquet(tmp_path / "a.parquet", saved)
    table = pyarrow.parquet.read_table(path)
    at = table.schema.get_field_index("camera")
    pyarrow.parquet.write_table(table.set_column(at, "camera", [["east", "west"]]), path)
    found, names = read_detections(path)
    assert (names, found.clock) == (("east", "west"), saved.clock)
    np.testing.assert_array_equal(found.ankles_confirmed, saved.ankles_confirmed)
