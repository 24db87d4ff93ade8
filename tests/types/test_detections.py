"""`Detections`: input that construction accepts or refuses, with its place in errors, and files."""

import inspect
import itertools
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Clock, Detections
from catfree.errors import InvalidInputError


def boxes(count: int) -> np.ndarray:
    corner = np.arange(2.0 * count).reshape(count, 2)
    return np.hstack([corner, corner + np.array([20.0, 50.0])])


def detections(count: int = 4, **columns) -> Detections:
    return Detections(
        columns.pop("frame", np.arange(count)),
        columns.pop("camera", np.arange(count) % 2),
        columns.pop("box", boxes(count)),
        **columns,
    )


def test_other_numbers_become_float64_and_floats_keep_their_width():
    assert detections(box=boxes(4).astype(int)).box.dtype == np.float64
    assert detections(box=boxes(4).tolist()).box.dtype == np.float64
    assert detections(box=boxes(4).astype(np.float16)).box.dtype == np.float64
    assert detections(box=boxes(4).astype(np.float32)).box.dtype == np.float32
    assert detections(box=jnp.asarray(boxes(4), jnp.int32)).box.dtype == np.float32
    assert detections(frame=[0.0, 1.0, 2.0, 3.0]).frame.dtype == np.int64
    ankles = detections(ankles_confirmed=[0, 1, 1, 0]).ankles_confirmed
    assert ankles is not None
    assert ankles.dtype == bool


def test_no_detections_need_no_shapes():
    empty = Detections([], [], [])
    assert len(empty) == 0
    assert empty.box.shape == (0, 4)
    assert empty.foot.shape == (0, 2)


def test_foot_is_the_bottom_centre_and_height_the_side():
    seen = Detections([0], [0], [[10.0, 20.0, 30.0, 80.0]])
    np.testing.assert_array_equal(seen.foot, [[20.0, 80.0]])
    np.testing.assert_array_equal(seen.height, [60.0])


@given(st.integers(1, 8), st.data())
def test_an_error_names_the_first_bad_entry(count, data):
    bad = data.draw(st.lists(st.integers(0, count - 1), min_size=1, unique=True))
    kind = data.draw(st.sampled_from(["box", "nan", "camera", "frame", "score", "ankles"]))
    columns = {
        "box": boxes(count),
        "camera": np.zeros(count),
        "frame": np.zeros(count),
        "score": np.full(count, 0.5),
        "ankles_confirmed": np.zeros(count),
    }
    column, value, name = {
        "box": ("box", [5.0, 5.0, 5.0, 9.0], rf"box\[{min(bad)}\]"),
        "nan": ("box", [np.nan, 0.0, 1.0, 1.0], rf"box\[{min(bad)}, 0\]"),
        "camera": ("camera", -1, rf"camera\[{min(bad)}\]"),
        "frame": ("frame", 0.5, rf"frame\[{min(bad)}\]"),
        "score": ("score", 1.5, rf"score\[{min(bad)}\]"),
        "ankles": ("ankles_confirmed", 2, rf"ankles_confirmed\[{min(bad)}\]"),
    }[kind]
    columns[column][bad] = value
    with pytest.raises(InvalidInputError, match=name):
        detections(count, **columns)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"box": boxes(3)}, r"box must have shape \(4, 4\), got \(3, 4\)"),
        ({"camera": [0, 1]}, r"camera must have shape \(4\), got \(2,\)"),
        ({"camera": [0, 1, 21234567, 3]}, r"camera\[2\] is 21234567. Number cameras from 0"),
        ({"frame": np.zeros((4, 1))}, r"frame must have shape \(n\)"),
        ({"frame": [True] * 4}, "frame must hold whole numbers"),
        ({"frame": ["a"] * 4}, "frame must hold whole numbers"),
        ({"frame": [0, 0, 0, 1e30]}, r"frame\[3\]"),
        ({"box": [["a"] * 4] * 4}, "Expected numbers"),
        ({"box": [[0, 0, 9, 9]] * 3 + [[0, 0, 9, 1e300]]}, r"box\[3\] .* within 1e\+09 pixels"),
        ({"score": np.zeros(3)}, r"score must have shape \(4\)"),
        ({"score": [0, 0, np.nan, 0]}, r"score\[2\] is not finite"),
        ({"ankles_confirmed": np.zeros(3)}, "ankles_confirmed must have shape"),
        ({"embedding": np.zeros((4, 0))}, r"embedding has shape \(4, 0\).*Pass None"),
        ({"embedding": np.zeros(4)}, r"embedding must have shape \(4, n\)"),
        ({"embedding": [[0.0], [np.inf], [0.0], [0.0]]}, r"embedding\[1, 0\] is not finite"),
        ({"keypoints": np.zeros((4, 16, 3))}, r"keypoints must have shape \(4, 17, 3\)"),
        ({"keypoints": np.full((4, 17, 3), np.nan)}, r"keypoints\[0, 0, 0\] is not finite"),
    ],
)
def test_what_is_refused(columns, message):
    with pytest.raises(InvalidInputError, match=message):
        detections(**columns)


def complete(count: int, dtype=np.float64) -> Detections:
    rng = np.random.default_rng(count)
    return detections(
        count,
        frame=rng.integers(-5, 5, count),
        box=boxes(count).astype(dtype),
        score=rng.random(count).astype(dtype),
        ankles_confirmed=rng.random(count) < 0.5,
        embedding=rng.standard_normal((count, 3)).astype(dtype),
        keypoints=rng.standard_normal((count, 17, 3)).astype(dtype),
    )


def test_rows_are_chosen_as_in_numpy():
    seen = complete(5)
    for rows in (slice(1, 4), np.array([True, False, True, False, True]), np.array([4, 0]), 2):
        chosen = seen[rows]
        wanted = np.arange(5)[rows].reshape(-1)
        for name, column in vars(seen).items():
            if column is not None:
                np.testing.assert_array_equal(getattr(chosen, name), column[wanted])


def test_rows_that_do_not_exist_are_told():
    seen = complete(5)
    for rows in (np.ones(4, bool), [7], "frame", [0.5], [[0], [1, 2]]):
        with pytest.raises(InvalidInputError, match="5 rows are selected by a slice, a mask of as"):
            seen[rows]
    assert len(list(seen)) == 5


@pytest.mark.slow
@given(
    st.integers(0, 5),
    st.sampled_from([np.float32, np.float64]),
    st.sets(st.sampled_from(["score", "ankles_confirmed", "embedding", "keypoints"])),
)
def test_a_file_gives_back_every_bit(tmp_path, count, dtype, absent):
    whole = vars(complete(count, dtype))
    seen = Detections(**(whole | dict.fromkeys(absent)))
    seen.save(tmp_path / "seen.npz")
    again = Detections.load(tmp_path / "seen.npz")
    for name, column in vars(seen).items():
        back = getattr(again, name)
        if column is None:
            assert back is None
        else:
            assert (back.dtype, back.shape) == (column.dtype, column.shape)
            assert back.tobytes() == column.tobytes()


def random_detections(rng, n=20, cameras=3):
    corner, size = rng.uniform(0, 100, (n, 2)), rng.uniform(1, 50, (n, 2))
    return Detections(
        rng.integers(0, 5, n),
        rng.integers(0, cameras, n),
        np.concatenate([corner, corner + size], -1),
        score=rng.uniform(0, 1, n),
    )


@given(cuts=st.lists(st.integers(0, 20), max_size=3), seed=st.integers(0, 99))
def test_concatenate_undoes_cutting(cuts, seed):
    whole = random_detections(np.random.default_rng(seed))
    parts = [whole[a:b] for a, b in itertools.pairwise([0, *sorted(cuts), 20])]
    joined = Detections.concatenate(parts)
    for name, value in vars(whole).items():
        np.testing.assert_array_equal(getattr(joined, name), value)


def test_concatenate_names_what_does_not_fit():
    one = random_detections(np.random.default_rng(0))
    bare = Detections(one.frame, one.camera, one.box)
    none = Detections([], [], [])
    assert Detections.concatenate([none, one, none]).score is not None
    assert len(Detections.concatenate([none])) == 0
    embedded = [replace(one, embedding=np.ones((len(one), width))) for width in (3, 4)]
    for parts, sentence in [
        ([], "at least one part"),
        ([one, bare], "Part 1 with rows has no score, but part 0 has"),
        (embedded, "embedding has 3 and 4 numbers per row"),
        ([one, replace(one, clock=Clock(5))], "different clocks"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            Detections.concatenate(parts)


@pytest.mark.parametrize("library", ["pandas", "polars", "pyarrow", "dict"])
def test_tables_become_detections_and_back(library):
    whole = random_detections(np.random.default_rng(1))
    columns = {"t": whole.frame, "view": np.array(["b", "a", "c"])[whole.camera]}
    columns |= dict(zip(("l", "t0", "r", "b"), whole.box.T, strict=True))
    columns["conf"] = whole.score
    if library == "dict":
        table = columns
    else:
        module = pytest.importorskip(library)
        table = module.table(columns) if library == "pyarrow" else module.DataFrame(columns)
    found = Detections.from_table(
        table,
        frame="t",
        camera="view",
        box=("l", "t0", "r", "b"),
        score="conf",
        camera_names=["b", "a", "c"],
        clock=Clock(5),
    )
    for name in ("frame", "camera", "box", "score"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert found.clock == Clock(5)


@pytest.mark.parametrize("library", ["pandas", "polars", "dictionary"])
def test_a_table_without_rows_names_no_camera(library):
    columns: Any = {name: [] for name in ("frame", "camera", "x1", "y1", "x2", "y2")}
    if library == "pandas":
        table = pytest.importorskip("pandas").DataFrame([], columns=list(columns))
    else:
        table = (
            columns if library == "dictionary" else pytest.importorskip(library).DataFrame(columns)
        )
    for names in (None, ["a", "b"]):
        assert len(Detections.from_table(table, camera_names=names)) == 0


def test_the_table_of_pandas_has_the_usual_names():
    pytest.importorskip("pandas")
    whole = random_detections(np.random.default_rng(2))
    found = Detections.from_table(whole.to_pandas())
    for name in ("frame", "camera", "box", "score"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    bare = Detections(whole.frame, whole.camera, whole.box)
    assert Detections.from_table(bare.to_pandas()).score is None


def test_sizes_instead_of_corners_and_one_camera():
    table = {"frame": [3], "x": [1.0], "y": [2.0], "w": [3.0], "h": [4.0]}
    found = Detections.from_table(table, camera=2, box=("x", "y", "w", "h"), form="xywh")
    assert found.camera.tolist() == [2]
    assert found.box.tolist() == [[1, 2, 4, 6]]


def test_tables_that_do_not_fit_are_named():
    table = {"frame": [0], "camera": ["a"], "x1": [0], "y1": [0], "x2": [1], "y2": [1]}
    for given_table, options, sentence in [
        (table, {}, "Cameras are named, as 'a'. Pass camera_names="),
        (table, {"camera_names": ["b"]}, "camera 'a', which is not among camera_names"),
        (table, {"camera_names": ["a", "a"]}, "a name twice"),
        (table, {"camera_names": "a"}, "must be a list of names in order, got 'a'"),
        (table, {"camera_names": {"a"}}, "must be a list of names in order, got {'a'}"),
        (table, {"camera_names": iter("a")}, "must be a list of names in order"),
        (table, {"frame": "time"}, "no column 'time'; it has 'frame', 'camera', 'x1'"),
        (table, {"camera": 0, "score": "sure"}, "no column 'sure'"),
        (table, {"camera": 0, "box": ("x1", "y1")}, "A box is four columns"),
        (table | {"x2": [None]}, {"camera": 0}, "not finite"),
        (table | {"x2": [1, 2]}, {"camera": 0}, r"column 'x2' must have shape \(1\), got \(2,\)"),
        (3, {}, "Expected a table of pandas, polars or Arrow, got int"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            inspect.unwrap(Detections.from_table.__func__)(Detections, given_table, **options)


def test_double_columns_and_lazy_tables_are_named():
    pandas, polars = (pytest.importorskip(name) for name in ("pandas", "polars"))
    row = {"frame": [0], "camera": [0], "x1": [0.0], "y1": [0.0], "x2": [1.0], "y2": [1.0]}
    table = pandas.DataFrame(row)
    with pytest.raises(InvalidInputError, match="several columns 'x1'"):
        Detections.from_table(pandas.concat([table, table[["x1"]]], axis=1))
    with pytest.raises(InvalidInputError, match="collect"):
        Detections.from_table(polars.DataFrame(row).lazy())


def test_boxes_of_supervision():
    sv = pytest.importorskip("supervision")
    boxes = np.array([[0.0, 0, 10, 20], [5, 5, 8, 9]])
    image = sv.Detections(xyxy=boxes, confidence=np.array([0.5, 0.25]))
    found = Detections.from_supervision(
        {"north": image, "south": [image[:1], sv.Detections.empty()]},
        frame=7,
        camera_names=["south", "north"],
    )
    assert found.frame.tolist() == [7, 7, 7]
    assert found.camera.tolist() == [1, 1, 0]
    np.testing.assert_array_equal(found.score, [0.5, 0.25, 0.5])
    assert len(Detections.from_supervision({})) == 0
    for given_boxes, sentence in [
        ({0: 3}, "Camera 0 has a value of type int instead of supervision.Detections"),
        ({0: [3]}, "has a value of type int in frame 0"),
        ({"a": image}, "Cameras are named"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            Detections.from_supervision(given_boxes)


@pytest.mark.parametrize("names", [None, ["a", "b"]])
@pytest.mark.parametrize("boxes", [{(0, 1): []}, {0.5: []}, {0: [], None: []}])
def test_boxes_of_supervision_are_by_camera(boxes, names):
    with pytest.raises(
        InvalidInputError, match="boxes must be a dictionary from the index or name"
    ):
        Detections.from_supervision(boxes, camera_names=names)
