"""Tracks in the forms of other programs, read back by those programs if installed."""

import contextlib
import dataclasses
import inspect
import io
import json

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree import Clock, Detections, Tracks
from catfree.adapters import (
    GeoReference,
    read_ai_city_tracks,
    to_movement,
    write_ai_city_tracks,
    write_geojson,
    write_pedpy,
    write_trackeval,
    write_tracks_csv,
    write_tracks_parquet,
)
from catfree.adapters.tables.tracks._tracked_rows import tracked
from catfree.errors import FileFormatError, InvalidInputError, MissingDependencyError
from catfree.methods.paper._assemble import empty_localization
from catfree.synthetic import make_layout


def walking(people=3, frames=8, step=5, clock: Clock | None = None) -> Tracks:
    """Make people who walk along x side by side; the last row belongs to no track."""
    frame = np.repeat(np.arange(frames) * step, people)
    person = np.tile(np.arange(people), frames)
    xy = np.column_stack([0.25 * frame / step, 1.5 * person])
    n = len(frame)
    return Tracks(
        frame=np.append(frame, frames * step),
        track_id=np.append(person, -1),
        position=np.zeros((n + 1, 3)),
        ground_xy=np.concatenate([xy, [[50.0, 50.0]]]),
        sigma=np.full(n + 1, 0.1),
        covariance=np.tile(0.01 * np.eye(2), (n + 1, 1, 1)),
        supporting_cameras=np.full(n + 1, 2),
        origin=np.zeros(n + 1, int),
        existence=np.full(n + 1, 0.75),
        support=np.stack([np.arange(n + 1), np.full(n + 1, -1)], axis=-1),
        clock=clock,
    )


def rows_of(tracks: Tracks) -> np.ndarray:
    rows = tracks.to_rows()[tracks.track_id >= 0]
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


@pytest.mark.parametrize("write", [write_tracks_csv, write_tracks_parquet, tracked])
def test_a_result_is_told_to_pass_its_tracks(write, tmp_path):
    unchecked, result = inspect.unwrap(write), empty_localization(2)  # as without type checks
    arguments = (result, "a table") if write is tracked else (tmp_path / "tracks", result)
    with pytest.raises(InvalidInputError, match=r"got Localization. Pass its \.tracks"):
        unchecked(*arguments)
    assert not any(tmp_path.iterdir())


def test_a_sequence_of_trackeval_may_have_any_name(tmp_path):
    rows = rows_of(walking())
    write_trackeval(tmp_path, rows, rows, rows[:, 0], sequence="50% [ü]")
    written = (tmp_path / "gt" / "50% [ü]" / "seqinfo.ini").read_text()
    assert "name = 50% [ü]" in written


@pytest.mark.slow
def test_pedpy_reads_positions_rate_and_unit(tmp_path):
    pedpy = pytest.importorskip("pedpy", reason="PedPy is not installed")
    tracks = walking(clock=Clock(10))
    path = write_pedpy(tmp_path / "tracks.txt", tracks)
    loaded = pedpy.load_trajectory(trajectory_file=path)
    assert loaded.frame_rate == 2  # ten frame numbers per second, of which every fifth is used
    table = loaded.data.sort_values(["frame", "id"])
    expected = rows_of(tracks)
    np.testing.assert_array_equal(table.frame * 5, expected[:, 0])
    np.testing.assert_array_equal(table.id - 1, expected[:, 1])
    np.testing.assert_array_equal(table[["x", "y"]], expected[:, 2:])
    with pytest.raises(InvalidInputError, match="their frame rate is not known"):
        write_pedpy(tmp_path / "tracks.txt", walking())
    assert "framerate: 3.0 fps" in write_pedpy(path, walking(), 15).read_text()


def test_trackeval_scores_the_folders(tmp_path):
    with contextlib.redirect_stdout(io.StringIO()):
        trackeval = pytest.importorskip("trackeval", reason="TrackEval is not installed")
    tracks = walking()
    kept = tracks[tracks.track_id >= 0]
    truth = np.add(rows_of(tracks), [0, 7, 0, 0.1])
    missed = np.add(truth[truth[:, 1] == 7][:2], [0, 3, 9, 9])
    truth = np.concatenate([truth, missed])
    frames = np.arange(0, 40, 5)
    for sequence in ("first", "second"):
        write_trackeval(tmp_path, kept, truth, frames, sequence=sequence, threshold=1)
    options = {
        "GT_FOLDER": str(tmp_path / "gt"),
        "TRACKERS_FOLDER": str(tmp_path / "trackers"),
        "SKIP_SPLIT_FOL": True,
        "PRINT_CONFIG": False,
    }
    with contextlib.redirect_stdout(io.StringIO()):
        data = trackeval.datasets.MotChallenge2DBox(options)
        assert data.seq_list == ["first", "second"]
        raw = data.get_raw_seq_data("catfree", "first")
        scored = data.get_preprocessed_seq_data(raw, "pedestrian")
        metric = trackeval.metrics.CLEAR({"PRINT_CONFIG": False})
        found = metric.eval_sequence(scored)
    expected = cf.evaluation.tracking_metrics(truth, kept.to_rows(), frames, 1.0)
    assert found["CLR_FN"] == 2
    assert found["CLR_FP"] == 0
    np.testing.assert_allclose(100 * found["MOTA"], expected.mota)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sequence": "../up"}, "'../up' cannot be the name of a folder"),
        ({"tracker": 5}, "5 cannot be the name of a folder"),
        ({"threshold": "1 m"}, "threshold is '1 m'; it must be a positive number"),
    ],
)
def test_trackeval_names_what_it_cannot_write(options, message, tmp_path):
    rows, frames = rows_of(walking()), np.arange(0, 40, 5)
    unchecked = inspect.unwrap(write_trackeval)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match=message):
        unchecked(tmp_path, rows, rows, frames, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["tracks", "ground_truth"])
def test_trackeval_names_which_of_both_are_no_rows(name, tmp_path):
    given = {"tracks": walking(), "ground_truth": rows_of(walking())} | {name: np.zeros((3, 2))}
    with pytest.raises(InvalidInputError, match=rf"^{name} .* must have shape \(n, 4\), got"):
        write_trackeval(tmp_path, **given, frames=np.arange(0, 40, 5))


@pytest.mark.parametrize("images", [False, True])
def test_ai_city_gives_back_every_position(images, tmp_path):
    tracks = walking()
    n = len(tracks)
    boxes = Detections(tracks.frame, np.zeros(n, int), np.tile([1.5, 2.0, 9.25, 30.0], (n, 1)))
    options = {"detections": boxes, "camera_ids": [21, 22]} if images else {"scene_id": 81}
    path = write_ai_city_tracks(tmp_path / "track1.txt", tracks, **options)
    found = read_ai_city_tracks(path)
    np.testing.assert_array_equal(found, np.add(rows_of(tracks), [0, 1, 0, 0]))
    first = path.read_text().splitlines()[0].split()
    assert len(first) == (9 if images else 11)
    expected = ["21", "1", "0", "1", "2", "9", "28"] if images else ["81", "0", "1", "0"]
    assert first[: len(expected)] == expected


def test_ai_city_takes_people_of_one_sequence(tmp_path):
    path = tmp_path / "track1.txt"
    path.write_text("1 0 5 0 1 2 .8 .6 .6 1.6 0\n1 1 5 0 9 9 .8 1 1 1 0\n2 0 5 0 3 4 .8 1 1 1 0\n")
    with pytest.raises(InvalidInputError, match="holds the scenes 1, 2"):
        read_ai_city_tracks(path)
    far = path.with_name("far.txt")
    far.write_text(path.read_text() + "1e300 0 5 0 3 4 .8 1 1 1 0\n")
    with pytest.raises(InvalidInputError, match=r"holds the scenes 1, 2, 1e\+300"):
        read_ai_city_tracks(far)
    np.testing.assert_array_equal(read_ai_city_tracks(path, 1), [[0, 5, 1, 2]])
    with pytest.raises(InvalidInputError, match="scene_id must hold whole numbers"):
        inspect.unwrap(read_ai_city_tracks)(path, "1")
    path.write_text("\n")
    assert read_ai_city_tracks(path).shape == (0, 4)
    for text, sentence in [
        ("1 2 3\n", "line 1 has 3 columns instead of 11 or 9"),
        ("1 1 0 1 1 2 2 3 4\n1 0 5 0 1 2 .8 .6 .6 1.6 0\n", "line 2 has 11 columns instead of 9"),
        ("1 1 0 1 1 2 2 3 y\n", "line 1 has a value that is not a number"),
        ("1 1 0 1 1 2 2 3 nan\n", "line 1 has a number that is not finite"),
    ]:
        path.write_text(text)
        with pytest.raises((FileFormatError, InvalidInputError), match=sentence):
            read_ai_city_tracks(path)


def test_ai_city_refuses_other_detections(tmp_path):
    tracks = walking()
    n = len(tracks)
    boxes = Detections(tracks.frame, np.zeros(n, int), np.tile([1.5, 2.0, 9.25, 30.0], (n, 1)))
    later, beside = (
        dataclasses.replace(boxes, **{name: getattr(boxes, name) + 1})
        for name in ("frame", "camera")
    )
    for others in (boxes[:1], later, beside):
        with pytest.raises(InvalidInputError, match="made from other detections"):
            write_ai_city_tracks(tmp_path / "track1.txt", tracks, detections=others)
    with pytest.raises(InvalidInputError, match=r"camera_ids must have shape \(2\), got \(1,\)"):
        write_ai_city_tracks(tmp_path / "track1.txt", tracks, detections=boxes, camera_ids=[1])
    unsupported = dataclasses.replace(tracks, support=None)
    with pytest.raises(InvalidInputError, match="do not say which boxes"):
        write_ai_city_tracks(tmp_path / "track1.txt", unsupported, detections=boxes)


degrees = st.tuples(st.floats(-179, 179), st.floats(-70, 70))


@pytest.mark.slow
@given(place=degrees, bearing=st.floats(0, 6.28), unit=st.floats(0.01, 10))
def test_anchors_give_place_turn_and_scale(place, bearing, unit):
    points = np.array([[0.0, 0], [40, 0], [40, 30], [-5, 20]]) / unit
    north = GeoReference.from_anchors([[0.0, 0], [0, 1000]], [place, np.add(place, [0, 0.01])])
    turn = unit * np.array(
        [[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]]
    )
    scale = north.meters_per_unit
    anchors = north.to_longitude_latitude(points @ turn.T / scale)
    found = GeoReference.from_anchors(points, anchors)
    np.testing.assert_allclose(found.meters_per_unit, unit, rtol=1e-6)
    assert found.residual(points, anchors).max() < 1e-6
    np.testing.assert_allclose(found.to_xy(found.to_longitude_latitude(points)), points, atol=1e-4)


def test_a_degree_has_its_length_on_earth():
    # On the WGS 84 ellipsoid at 45 degrees: 111.132 km along the meridian, 78.847 km across.
    east = GeoReference.from_anchors([[0, 0], [788.47, 0]], [[10, 45], [10.01, 45]])
    north = GeoReference.from_anchors([[0, 0], [0, 1111.32]], [[10, 44.995], [10, 45.005]])
    np.testing.assert_allclose([east.meters_per_unit, north.meters_per_unit], 1, rtol=1e-5)
    np.testing.assert_allclose([east.heading, north.heading], 0, atol=0.01)


def test_anchors_that_are_no_places_are_refused():
    for xy, place, sentence in [
        ([[0, 0]], [[1, 1]], "at least 2 different points"),
        ([[0, 0], [0, 0]], [[1, 1], [1, 2]], "at least 2 different points"),
        ([[0, 0], [1, 0]], [[10, 95], [10, 96]], "other order"),
        ([[0, 0], [1, 0]], [[10, 5], [14, 5]], "km from the others"),
        ([[0, 0], [1, np.nan]], [[10, 5], [10, 5]], "xy"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            GeoReference.from_anchors(xy, place)


def test_geojson_is_read_by_shapely(tmp_path):
    shapely = pytest.importorskip("shapely.geometry", reason="shapely is not installed")
    tracks = walking(clock=Clock(10))
    reference = GeoReference.from_anchors([[0, 0], [10, 0]], [[8.55, 47.37], [8.5501, 47.37]])
    path = write_geojson(tmp_path / "tracks.geojson", tracks, reference)
    features = json.loads(path.read_text())["features"]
    assert [feature["properties"]["track_id"] for feature in features] == [0, 1, 2]
    for person, feature in enumerate(features):
        line = shapely.shape(feature["geometry"])
        rows = rows_of(tracks)[rows_of(tracks)[:, 1] == person]
        np.testing.assert_allclose(reference.to_xy(np.array(line.coords)), rows[:, 2:], atol=1e-6)
        assert feature["properties"]["frame"] == rows[:, 0].tolist()
        np.testing.assert_allclose(feature["properties"]["time_s"], rows[:, 0] / 10)
    one = json.loads(write_geojson(path, tracks[:1], reference).read_text())
    assert one["features"][0]["geometry"]["type"] == "Point"
    scene = make_layout("ring4").scene
    with pytest.raises(InvalidInputError, match="no georeference"):
        write_geojson(path, tracks, scene)
    known = dataclasses.replace(scene, georeference=reference)
    assert json.loads(write_geojson(path, tracks, known).read_text())["features"] == features


@pytest.mark.slow
def test_movement_gets_time_people_and_confidence():
    try:
        import movement.io  # noqa: F401
    except ImportError:
        with pytest.raises(MissingDependencyError, match="pip install movement"):
            to_movement(walking())
        pytest.skip("movement is not installed")
    tracks = walking(clock=Clock(10))
    data = to_movement(tracks)
    assert data.attrs["ds_type"] == "poses"
    np.testing.assert_allclose(data.time, np.arange(8) / 2)
    people = next(name for name in data.dims if name.startswith("individual"))
    for person in range(3):
        one = data.sel({people: f"id_{person}"}).squeeze()
        rows = rows_of(tracks)[rows_of(tracks)[:, 1] == person]
        np.testing.assert_array_equal(one.position.transpose("time", "space"), rows[:, 2:])
        np.testing.assert_array_equal(one.confidence, np.full(8, 0.75))
    with pytest.raises(InvalidInputError, match="There are no tracks"):
        to_movement(tracks[:0])


@pytest.mark.parametrize("write", [write_pedpy, write_ai_city_tracks])
def test_a_position_that_is_not_finite_is_named(write, tmp_path):
    tracks = walking(clock=Clock(1))
    xy = np.array(tracks.ground_xy)
    xy[4, 0] = np.nan
    broken = Tracks(**(vars(tracks) | {"ground_xy": xy}))
    with pytest.raises(InvalidInputError, match="position of track 1 in frame 5 is not finite"):
        write(tmp_path / "tracks.txt", broken)
    assert not list(tmp_path.iterdir())
