"""Saved states of trackers: states impossible for a tracker are refused on reading."""

import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree.errors import FileFormatError
from catfree.synthetic import make_world

REFUSED = "not the state of a tracker of this version"
WORLD = make_world("ring4", frames=7, people=4, seed=1)

NAN_AT_FIRST = (".learned.unit", ".learned.step", ".learned.usual", ".final_time")
WAYS = {
    "complex": lambda v: v.astype(complex),
    "date": lambda v: np.zeros(v.shape, "M8[D]"),
    "structured": lambda v: np.zeros(v.shape, [("a", "f8")]),
    "text": lambda v: v.astype(str),
    "first axis": lambda v: v[None],
    "last axis": lambda v: np.zeros((2, *v.shape[1:], 3), v.dtype),
    "nan": lambda v: np.full_like(v, np.nan),
    "infinite": lambda v: np.full_like(v, np.inf),
    "huge": lambda v: np.full_like(v, 1e300),
}


def feed(lag, frames):
    tracker = cf.Tracker(WORLD.true_scene, lag=lag)
    for f in range(frames):
        boxes = WORLD.detections[WORLD.detections.frame == f]
        delivered = [0, 1, 2, 3] if f != 2 else sorted(set(boxes.camera.tolist()))
        tracker.update(boxes, f / 2, cameras=delivered)
    return tracker


@pytest.fixture(scope="module", params=[(1.0, 7), (0.0, 1), (math.inf, 3)])
def state(request):
    return feed(*request.param).state


@pytest.fixture(scope="module")
def arrays(tmp_path_factory):
    """Return the file content of a tracker whose state is complete."""
    path = tmp_path_factory.mktemp("arrays") / "state.npz"
    feed(1.0, 7).state.save(path)
    return dict(np.load(path))


def load(path, arrays):
    np.savez(path, **arrays)
    return cf.TrackerState.load(path)


@pytest.mark.slow
def test_real_states_come_back_bit_for_bit(state, tmp_path):
    state.save(tmp_path / "a.npz")
    again = cf.TrackerState.load(tmp_path / "a.npz")
    one, other = jax.tree.flatten(state), jax.tree.flatten(again)
    assert one[1] == other[1]
    for x, y in zip(one[0], other[0], strict=True):
        assert (np.asarray(x).dtype, np.shape(x)) == (y.dtype, y.shape)
        assert np.asarray(x).tobytes() == y.tobytes()


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(place=st.integers(0, 10**6), way=st.sampled_from(list(WAYS)))
def test_arrays_of_another_kind_or_shape_are_refused(place, way, arrays, tmp_path_factory):
    names = [name for name in arrays if name != "catfree_kind"]
    name = names[place % len(names)]
    value = arrays[name]
    if way in ("nan", "infinite", "huge") and (value.dtype.kind != "f" or not value.size):
        return
    if way == "nan" and name in NAN_AT_FIRST:
        return
    wrong = WAYS[way](value)
    with pytest.raises(FileFormatError, match=REFUSED):
        load(tmp_path_factory.mktemp("one") / "a.npz", arrays | {name: wrong})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong", "said"),
    [
        ("cameras", 10**12, "learned.noise.edge"),
        ("cameras", -1, "cameras"),
        ("window", 200_000, "window is 200000, but the file holds 2"),
        ("recording", 200_000, "recording is 200000, but the file holds 0"),
        (".spacing", None, "spacing is missing"),
        (".learned.clutter", np.zeros((1, 1)), "learned.clutter must have shape"),
        (".learned.likeness", np.array([[0.1, 0.0], [0.5, 0.1]]), r"likeness\[0, 1\]"),
        (".learned.noise.edge", np.zeros((4, 3)), "edge"),
        (".learned.unit", np.array(-1.0), "unit"),
        (".count", np.array(2**62), "count"),
        (".count", np.array(-(2**63)), "count"),
        (".spacing", np.array(0), "spacing"),
        (".missing", np.array([[2, 4]]), "missing"),
        (".times", np.array([2.0, 1.0]), "times"),
        (".time", np.array(-np.inf), "in order"),
        (".final_time", np.array(9.0), "in order"),
        (".weight", np.zeros(0), "weight must have shape"),
        (".other", np.zeros(0), "unknown '.other'"),
        (".learned.hits", None, "learned.hits is missing"),
    ],
)
def test_what_no_tracker_has_is_refused(arrays, tmp_path, name, wrong, said):
    changed = arrays | {name: wrong}
    if wrong is None:
        del changed[name]
    with pytest.raises(FileFormatError, match=REFUSED) as error:
        load(tmp_path / "a.npz", changed)
    assert error.match(said)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"),
    [
        (".heads.covariance", lambda v: -v),
        (".heads.name", lambda v: v[::-1]),
        (".window[0].node.group", lambda v: v + len(v)),
        (".window[0].support", lambda v: v - 1),
        (".sample.camera", lambda v: v + 4),
        (".sample.box", lambda v: v[:, [2, 3, 0, 1]]),
        (".pasts.covariance", lambda v: v + 1e9 * (1 - np.eye(5))),
    ],
)
def test_what_contradicts_itself_is_refused(arrays, tmp_path, name, change):
    with pytest.raises(FileFormatError, match=REFUSED):
        load(tmp_path / "a.npz", arrays | {name: change(arrays[name])})


@pytest.mark.slow
def test_tracks_without_weights_are_refused(arrays, tmp_path):
    none = {name: arrays[name][:0] for name in (".weight", ".forward")}
    with pytest.raises(FileFormatError, match="different numbers of tracks"):
        load(tmp_path / "a.npz", arrays | none)
