"""`Tracks` and `Candidates`: rows, counts and files."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Candidates, Clock, Detections, Fate, Localization, Tracks
from catfree._run._cache import from_arrays, to_arrays
from catfree.errors import FileFormatError, InvalidInputError
from catfree.methods.paper._assemble import empty_localization
from catfree.types.results._tracks import supporting_boxes


def tracks(count: int, dtype=np.float64, *, existence: bool = False) -> Tracks:
    rng = np.random.default_rng(count)
    cameras = rng.integers(0, 5, count)
    return Tracks(
        frame=np.sort(rng.integers(0, 5, count)),
        track_id=rng.integers(0, 3, count),
        position=rng.standard_normal((count, 3)).astype(dtype),
        ground_xy=rng.standard_normal((count, 2)).astype(dtype),
        sigma=np.where(cameras < 2, np.inf, 1.0).astype(dtype),
        covariance=(np.eye(2) + rng.random((count, 2, 2)) / 2).astype(dtype),
        supporting_cameras=cameras,
        origin=rng.integers(0, 3, count),
        existence=rng.random(count).astype(dtype) if existence else None,
        support=rng.integers(-1, 9, (count, 4)),
        velocity=rng.standard_normal((count, 2)).astype(dtype),
        velocity_covariance=np.full((count, 2, 2), np.nan, dtype),
        design_sigma=rng.random(count).astype(dtype) if existence else None,
        whole_views=rng.integers(0, 5, count) if existence else None,
    )


@pytest.mark.slow
@given(st.integers(0, 6), st.sampled_from([np.float32, np.float64]), st.booleans())
def test_a_file_gives_back_every_bit(tmp_path, count, dtype, existence):
    wanted = tracks(count, dtype, existence=existence)
    wanted.save(tmp_path / "tracks.npz")
    again = Tracks.load(tmp_path / "tracks.npz")
    for name, value in vars(wanted).items():
        back = getattr(again, name)
        if value is None:
            assert back is None
        else:
            assert (back.dtype, back.shape) == (value.dtype, value.shape)
            assert back.tobytes() == value.tobytes()


def test_a_file_without_a_column_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", catfree_kind=np.array("Tracks"), frame=np.zeros(0, int))
    with pytest.raises(FileFormatError, match="lacks track_id"):
        Tracks.load(tmp_path / "a.npz")


OLD = ("frame", "track_id", "position", "ground_xy", "sigma", "covariance")
OLD += ("supporting_cameras", "origin", "existence")


@pytest.mark.parametrize("existence", [False, True])
def test_a_file_of_version_0_1_loads(tmp_path, existence):
    wanted = tracks(5, existence=existence)
    columns = {name: getattr(wanted, name) for name in OLD if getattr(wanted, name) is not None}
    np.savez_compressed(tmp_path / "old.npz", catfree_kind=np.array("Tracks"), **columns)
    again = Tracks.load(tmp_path / "old.npz")
    for name, value in columns.items():
        np.testing.assert_array_equal(getattr(again, name), value)
    assert again.support.shape == (5, 0)
    assert again.velocity.shape == (5, 2)
    assert again.velocity_covariance.shape == (5, 2, 2)
    assert np.isnan(again.velocity).all()
    assert np.isnan(again.velocity_covariance).all()


def test_a_localization_of_version_0_1_loads():
    old = to_arrays(empty_localization(3))
    rows = tracks(5)
    old |= {f"tracks.{name}": getattr(rows, name) for name in OLD if name != "existence"}
    for name in ("support", "velocity", "velocity_covariance"):
        del old[f"tracks.{name}"]
    del old["detection_count"]
    again = from_arrays(Localization, old)
    np.testing.assert_array_equal(again.tracks.position, rows.position)
    assert (again.tracks.support == -1).all()
    assert np.isnan(again.tracks.velocity).all()
    assert again.identity.shape == (0,)
    with pytest.raises(InvalidInputError, match=r"version 0\.1"):
        again.require_detections(Detections([0], [0], [[0, 0, 1, 1]]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"support": np.full((5, 4), -2)}, r"support\[0, 0\] is -2; it must be a row"),
        ({"support": np.zeros(5, int)}, r"support must have shape \(5, n\)"),
        ({"support": np.full((5, 4), 0.5)}, r"support\[0, 0\] is 0.5; it must be a whole number"),
        ({"velocity": np.zeros((5, 3))}, r"velocity must have shape \(5, 2\)"),
        ({"velocity_covariance": np.zeros((4, 2, 2))}, "velocity_covariance must have shape"),
        ({"track_id": np.zeros(4, int)}, r"track_id must have shape \(5\)"),
        ({"design_sigma": np.zeros(4)}, r"design_sigma must have shape \(5\)"),
        ({"whole_views": np.zeros((5, 2), int)}, r"whole_views must have shape \(5\)"),
        ({"whole_views": np.full(5, 0.5)}, r"whole_views\[0\] is 0.5; it must be a whole number"),
        ({"frame": np.full(5, 0.5)}, r"frame\[0\] is 0.5; it must be a whole number"),
        ({"track_id": ["a"] * 5}, "track_id must hold whole numbers"),
    ],
)
def test_columns_that_do_not_fit_are_named(change, message):
    with pytest.raises(InvalidInputError, match=message):
        Tracks(**(vars(tracks(5)) | change))


def test_lists_are_columns_too():
    some = tracks(5, existence=True)
    lists = {name: value.tolist() for name, value in vars(some).items() if value is not None}
    for name, value in vars(Tracks(**lists)).items():
        np.testing.assert_array_equal(value, getattr(some, name))
    with pytest.raises(InvalidInputError, match=r"sigma must have shape \(5\), got \(2,\)"):
        Tracks(**lists | {"sigma": [1, 2]})
    with pytest.raises(InvalidInputError, match=r"frame must have shape \(n\)"):
        Tracks(**lists | {"frame": 3})


@pytest.mark.parametrize("count", [0, 5])
def test_whole_numbers_of_any_type_are_saved(tmp_path, count):
    columns = vars(tracks(count))
    numbers = {name: columns[name].astype(float).tolist() for name in ("frame", "track_id")}
    Tracks(**columns | numbers).save(tmp_path / "tracks.npz")
    for name, values in vars(Tracks.load(tmp_path / "tracks.npz")).items():
        np.testing.assert_array_equal(values, columns[name])


def test_support_beyond_the_detections_is_named():
    nothing = empty_localization(4)
    rest = (nothing.candidates, nothing.thresholds, nothing.reliability)
    some = tracks(5)
    count = int(some.support.max()) + 1
    assert Localization(some, *rest, count).identity.shape == (count,)
    with pytest.raises(InvalidInputError, match=rf"is {count - 1}, but there are {count - 1} det"):
        Localization(some, *rest, count - 1)


@given(st.integers(0, 40), st.integers(0, 5), st.randoms(use_true_random=False))
def test_numbers_follow_from_when_tracks_begin(count, seed, random):
    """The result is independent of track numbers and row order."""
    rng = np.random.default_rng(seed)
    keys = np.unique(rng.integers(0, 7, (count, 2)), axis=0).reshape(-1, 2)
    some = tracks(len(keys))
    frame, track_id = keys[:, 0], keys[:, 1] - 1  # -1 is no track
    some = Tracks(
        **(vars(some) | {"frame": frame, "track_id": track_id, "sigma": rng.random(len(keys))})
    )
    one = some.renumbered()
    names = rng.permutation(7) + 20
    order = list(range(len(keys)))
    random.shuffle(order)
    other = {"track_id": np.where(track_id >= 0, names[track_id], -1)}
    two = Tracks(**(vars(some) | other))[np.array(order, int)].renumbered()
    tracked = one.track_id >= 0
    for name in ("frame", "track_id", "sigma", "support"):
        a, b = getattr(one, name), getattr(two, name)
        np.testing.assert_array_equal(a[tracked], b[two.track_id >= 0])
    np.testing.assert_array_equal(np.lexsort((one.track_id, one.frame)), np.arange(len(one)))
    assert set(one.track_id[tracked]) == set(range(len(set(track_id[track_id >= 0]))))
    begin = [
        (one.frame[rows[0]], one.sigma[rows[0]])
        for rows in (
            np.flatnonzero(one.track_id == k) for k in range(one.track_id.max(initial=-1) + 1)
        )
    ]
    assert begin == sorted(begin)


def test_rows_are_chosen_as_in_numpy():
    some = tracks(5, existence=True)
    chosen = some[some.origin > 0]
    assert some.existence is not None
    np.testing.assert_array_equal(chosen.existence, some.existence[some.origin > 0])
    np.testing.assert_array_equal(some[2].position, some.position[[2]])


def test_rows_for_the_evaluation():
    some = tracks(4)
    np.testing.assert_array_equal(some.to_rows()[:, 0], some.frame)
    np.testing.assert_array_equal(some.to_rows()[:, 2:], some.ground_xy)
    other = np.ones((4, 2))
    np.testing.assert_array_equal(some.to_rows(other)[:, 2:], other)
    for wrong in (some.position, other[:3]):
        with pytest.raises(InvalidInputError, match=r"xy must have shape \(4, 2\)"):
            some.to_rows(wrong)


def test_every_fate_is_counted():
    fate = np.array([Fate.ACCEPTED, Fate.SUPPRESSED, Fate.ACCEPTED], np.int64)
    numbers = np.zeros(3)
    candidates = Candidates(
        frame=np.zeros(3, int),
        position=np.zeros((3, 3)),
        sigma=numbers,
        ground_distance=numbers,
        rms_angle=numbers,
        support=np.zeros((3, 2), int),
        score=numbers,
        fate=fate,
    )
    counts = candidates.count_by_fate()
    assert counts["accepted"] == 2
    assert counts["suppressed"] == 1
    assert sum(counts.values()) == len(candidates) == 3
    assert counts.keys() == {fate.name.lower() for fate in Fate}


def supported():
    """Make two people in two frames; only camera 0 sees the second person, in frame 3."""
    boxes = Detections(
        [3, 3, 3, 8, 8],
        [0, 1, 0, 0, 1],
        [[0, 0, 1, 2], [0, 0, 2, 2], [0, 0, 3, 2], [0, 0, 4, 2], [0, 0, 5, 2]],
        score=[0.1, 0.2, 0.3, 0.4, 0.5],
    )
    found = tracks(3)
    columns = vars(found) | {
        "frame": np.array([3, 3, 8]),
        "track_id": np.array([5, 9, 5]),
        "support": np.array([[0, 1], [2, -1], [-1, 4]]),
    }
    return Tracks(**columns), boxes


@pytest.mark.slow
def test_boxes_get_the_identity_that_all_cameras_share():
    pytest.importorskip("supervision")
    found, boxes = supported()
    first, second = (found.to_supervision(camera, boxes) for camera in (0, 1))
    assert list(first) == list(second) == [3, 8]
    assert first[3].tracker_id.tolist() == [5, 9]
    np.testing.assert_array_equal(first[3].xyxy, boxes.box[[0, 2]])
    np.testing.assert_array_equal(first[3].confidence, [0.1, 0.3])
    np.testing.assert_array_equal(first[3].data["ground_xy"], found.ground_xy[:2])
    assert len(first[8]) == 0
    assert second[3].tracker_id.tolist() == second[8].tracker_id.tolist() == [5]
    # And back: boxes, frames and cameras are those that support the tracks.
    again = Detections.concatenate(
        [Detections.from_supervision({0: first[t], 1: second[t]}, frame=t) for t in (3, 8)]
    )
    chosen = np.unique(found.support[found.support >= 0])
    assert sorted(map(tuple, again.box.tolist())) == sorted(map(tuple, boxes.box[chosen].tolist()))


def test_boxes_without_a_track_are_left_out():
    pytest.importorskip("supervision")
    found, boxes = supported()
    found = replace(found, track_id=np.array([5, -1, 5]))
    by_frame = found.to_supervision(0, boxes)
    assert by_frame[3].tracker_id.tolist() == [5]
    assert list(by_frame) == [3, 8]


def test_boxes_of_other_detections_are_refused():
    pytest.importorskip("supervision")
    found, boxes = supported()
    for camera, given_boxes, sentence in [
        (2, boxes, "no camera 2; the tracks have boxes of 2 cameras"),
        (0, boxes[:1], "made from other detections"),
        (0, boxes[[1, 0, 2, 3, 4]], "made from other detections"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            found.to_supervision(camera, given_boxes)
    with pytest.raises(InvalidInputError, match="detections must be a Detections, got NoneType"):
        inspect.unwrap(supporting_boxes)(found, None)
    assert tracks(0).to_supervision(0, boxes)[3].tracker_id.tolist() == []


def test_the_table_of_pandas_is_that_of_arrow():
    pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    found = replace(supported()[0], clock=Clock(10))
    table = found.to_pandas()
    assert table.track_id.tolist() == [5, 9, 5]
    np.testing.assert_array_equal(table[["x", "y"]], found.ground_xy)
    np.testing.assert_allclose(table.time_s, [0.3, 0.3, 0.8])
