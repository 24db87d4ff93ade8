"""Lines of boxes are turned into records of positions."""

import json
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.errors import InvalidInputError
from catfree.methods.online import Event, Tracker, Update, watch
from catfree.methods.online._watch import parse_frame, records_of
from catfree.synthetic import make_world

NAMES = ("north", "south", "east")
anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def line(camera="north", time=0.0, boxes=((0, 0, 10, 30),), **more):
    """Make a line of JSON."""
    return json.dumps({"camera": camera, "time": time, "boxes": boxes, **more})


@pytest.mark.slow
@given(anything | st.fixed_dictionaries({"camera": anything, "time": anything, "boxes": anything}))
def test_any_json_is_read_or_refused(value):
    text = json.dumps(value)
    try:
        camera, time, detections = parse_frame(text, NAMES)
    except InvalidInputError:
        return
    assert camera in range(3)
    assert np.isfinite(time)
    assert (detections.camera == camera).all()


@given(st.text())
def test_any_text_is_read_or_refused(text):
    with pytest.raises(InvalidInputError):
        parse_frame(text, NAMES)


def test_a_line_is_read():
    camera, time, detections = parse_frame(
        line("south", "2026-05-01T12:00:00.25Z", scores=[0.5], embeddings=[[0.6, 0.8]]), NAMES
    )
    assert (camera, time) == (1, 1777636800.25)
    np.testing.assert_array_equal(detections.box, [[0, 0, 10, 30]])
    np.testing.assert_array_equal(detections.score, [0.5])
    np.testing.assert_array_equal(detections.embedding, [[0.6, 0.8]])
    assert parse_frame(line(2, 7, []), NAMES)[0] == 2
    assert parse_frame(line(2, 7, []), ["1", "2", "3"])[0] == 1
    with pytest.raises(InvalidInputError, match="no camera 0; there are 1, 2, 3"):
        parse_frame(line(0, 7, []), ["1", "2", "3"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "not a JSON object"),
        (line()[:-1] + ', "time": 8}', "'time' is stated twice"),
        ('{"camera": 0, "time": 1}', "no 'boxes'"),
        (line("west"), "no camera 'west'; there are north, south, east"),
        (line(-1), "no camera -1"),
        (line(True), "no camera true; there are"),
        (line(None), "no camera null; there are"),
        (line(["a", {"b": None}]), r'no camera \["a", {"b": null}\]; there are'),
        (line(time="noon"), "time is 'noon'"),
        (line(time="2026-05-01T12:00:00"), "no zone"),
        (line(time=float("nan")), "number of seconds"),
        (line(time=10**400), "number of seconds"),
        (line(time=None), "time is null; it"),
        (line(time=[False]), r"time is \[false\]; it"),
        (line(boxes=[[1, 2, 3]]), "x1, y1, x2, y2"),
        (line(boxes=[[1, 2, 3, 4, 5, 6, 7, 8]]), "x1, y1, x2, y2"),
        (line(boxes=[["a", 2, 3, 4]]), "x1, y1, x2, y2"),
        (line(boxes=[[1, 2, 3, "4"]]), "x1, y1, x2, y2"),
        (line(boxes=[[1, 2, 3, None]]), "finite"),
        (line(boxes=[[1, 2, 3, 10**400]]), "x1, y1, x2, y2"),
        (line(boxes=[[1, 2, 3], [1, 2, 3, 4]]), "x1, y1, x2, y2"),
        (line(scores=["0.5"]), "scores a list of numbers"),
        (line(boxes=[[0, 0, -1, 4]]), "x1 < x2"),
        (line(boxes=[[0, 0, float("inf"), 4]]), "finite"),
        (line(scores=[0.5, 0.5]), "score"),
    ],
)
def test_a_wrong_line_is_explained(text, message):
    with pytest.raises(InvalidInputError, match=message):
        parse_frame(text, NAMES)


@pytest.mark.parametrize("value", [{"camera": 0}, 3.0, None, np.zeros(4)])
def test_what_is_no_text_is_named_and_the_next_line_is_read(value):
    world = make_world("ring4", frames=1, people=1)
    lines = [value, b" ", line(time=1, boxes=[]).encode()]
    names = ["north", "south", "east", "west"]
    found = list(watch(lines, Tracker(world.true_scene), names, frame_rate=5))
    kind = type(value).__name__
    assert found[0]["type"] == "error"
    assert found[0]["message"].startswith(f"A line must be the text of a JSON object, got {kind}.")
    assert [r["type"] for r in found[1:]] == ["provisional", *["silent"] * 3, "final"]


def lines_of(every, names, rate):
    """Yield boxes as cameras would send them."""
    for frame in np.unique(every.frame):
        for camera, name in enumerate(names):
            here = every[(every.frame == frame) & (every.camera == camera)]
            yield line(name, frame / rate, here.box.tolist(), scores=here.score.tolist())


@pytest.mark.slow
def test_records_hold_what_the_tracker_reports():
    world = make_world("ring4", frames=40, people=4)
    boxes = replace(world.detections, embedding=None, ankles_confirmed=None)
    names = [f"camera {c}" for c in range(world.scene.rig.camera_count)]
    text = list(lines_of(boxes, names, 5))
    text.insert(7, "not a line")
    text.insert(9, "\n")
    text.append(line(names[0], 0.0))
    records = list(watch(text, Tracker(world.true_scene, lag=1.0), names, frame_rate=5))
    assert json.loads(json.dumps(records, allow_nan=False)) == records
    kinds = {record["type"] for record in records}
    assert kinds >= {"provisional", "final", "error"}
    (error,) = [record for record in records if record["type"] == "error"]
    assert error["line"] == 8
    final = [record for record in records if record["type"] == "final"]
    times = [record["time"] for record in final]
    assert times == sorted(set(times))
    whole = Tracker(world.true_scene, lag=1.0)
    rows = []
    for frame in np.unique(boxes.frame):
        rows += [whole.update(boxes[boxes.frame == frame], frame / 5).final]
    rows += [whole.finish().final]
    count = sum(len(tracks) for tracks in rows)
    assert sum(len(record["people"]) for record in final) == count > 0
    position = np.concatenate([tracks.ground_xy for tracks in rows if len(tracks)])
    told = [(person["x"], person["y"]) for record in final for person in record["people"]]
    np.testing.assert_allclose(told, position)


def test_an_update_is_told_in_seconds():
    tracks = cf.Tracks(
        frame=np.array([500]),
        track_id=np.array([3]),
        position=np.array([[1.0, 2.0, 0.0]]),
        ground_xy=np.array([[1.0, 2.0]]),
        sigma=np.array([0.1]),
        covariance=0.01 * np.eye(2)[None],
        supporting_cameras=np.array([2]),
        origin=np.array([0]),
        velocity=np.array([[0.002, 0.0]]),
        velocity_covariance=np.eye(2)[None],
        clock=cf.Clock(1000.0),
    )
    update = Update(tracks[:0], tracks, (Event("merge", 0.5, 4, 3),), 0.7)
    waiting = deque([0.5, 0.6, 0.9])
    merge, final, nobody = records_of(update, waiting)
    assert list(waiting) == [0.9]
    assert nobody == {"type": "final", "time": 0.6, "people": []}
    assert merge == {"type": "merge", "time": 0.5, "old": 4, "new": 3}
    assert (final["type"], final["time"]) == ("final", 0.5)
    (person,) = final["people"]
    assert (person["id"], person["x"], person["y"]) == (3, 1.0, 2.0)
    assert person["velocity"] == pytest.approx([2.0, 0.0])


@pytest.mark.slow
def test_dropped_frames_are_told():
    world = make_world("ring4", frames=2, people=2)
    text = [line("a", 0.5, []), line("a", 0.51, [])]
    text += [line(name, 0.5, []) for name in "bcd"]
    tracker = Tracker(world.true_scene, lag=0)
    dropped, final, now = list(watch(text, tracker, list("abcd"), frame_rate=10))
    assert dropped == {"type": "dropped", "camera": "a", "time": 0.5, "reason": "replaced"}
    assert (final["type"], final["people"]) == ("final", [])
    assert (now["type"], now["people"]) == ("provisional", [])


@pytest.mark.slow
def test_what_cannot_be_used_is_told_and_the_next_line_is_read():
    world = make_world("ring4", frames=2, people=2)
    text = [line(name, 0.5, []) for name in "abcd"]
    text.append('{"camera": "a", "time": 0.6, "boxes": [[0, 0, 1, 1' + "0" * 400 + "]]}")
    text += [line("a", 0.7, [[0, 0, 9, 30]] * 1001)] + [line(name, 0.7, []) for name in "bcd"]
    text += [line(name, 0.8, []) for name in "abcd"] + [line("a", 0.5, [])]
    records = list(watch(text, Tracker(world.true_scene), list("abcd"), frame_rate=10))
    errors = [(r["line"], r["message"]) for r in records if r["type"] == "error"]
    assert [number for number, _ in errors] == [5, 9]
    assert "boxes must be a list" in errors[0][1]
    assert "1001 boxes" in errors[1][1]
    assert [r["time"] for r in records if r["type"] == "final"] == [0.5, 0.8]
    (dropped,) = [r for r in records if r["type"] == "dropped"]
    assert (dropped["camera"], dropped["reason"]) == ("a", "late")


@pytest.mark.slow
def test_an_instant_that_cannot_be_used_ends_neither_the_stream_nor_the_next_instant():
    world = make_world("ring4", frames=2, people=2)
    crowd, empty = [[0, 0, 9, 30]] * 1001, [line(name, 0.6, []) for name in "abcd"]

    def kinds(text, **options):
        tracker = Tracker(world.true_scene)
        records = list(watch(text, tracker, list("abcd"), frame_rate=10, **options))
        assert [record["line"] for record in records if record["type"] == "error"] == [5]
        return [record["type"] for record in records]

    assert kinds([*empty, line("a", 0.7, crowd)]) == ["provisional", "error", "final"]
    together = [line("a", 0.5, crowd), *empty]  # the last line completes two instants
    assert kinds(together, timeout=5) == ["error", "provisional", "final"]


@pytest.mark.parametrize(
    ("heard", "told"),
    [
        ({"a": (0, 14)}, [("b", 10), ("c", 10), ("d", 10)]),
        ({"a": (0, 3), "d": (2, 3)}, [("b", 3), ("c", 3)]),
        (
            {"a": (0, 27), "b": (0, 1), "c": (0, 27), "d": (13, 15)},
            [("d", 10), ("b", 11), ("d", 25)],
        ),
        (dict.fromkeys("abcd", (0, 14)), []),
        ({}, []),
    ],
)
def test_cameras_that_are_silent_for_long_are_told_once(heard, told):
    text = [
        line(name, time, [])
        for time in range(30)
        for name, (first, last) in heard.items()
        if first <= time <= last
    ]
    tracker = Tracker(make_world("ring4", frames=2, people=2).true_scene)
    records = list(watch(text, tracker, list("abcd"), frame_rate=1))
    silent = [(r["camera"], r["time"]) for r in records if r["type"] == "silent"]
    assert silent == told


def test_every_camera_of_the_scene_needs_a_name():
    tracker = Tracker(make_world("ring4", frames=2, people=2).true_scene)
    with pytest.raises(InvalidInputError, match="has 2 names, but there are 4 cameras"):
        list(watch([], tracker, ["a", "b"], frame_rate=5))
    with pytest.raises(InvalidInputError, match="the same name"):
        list(watch([], tracker, list("abca"), frame_rate=5))
