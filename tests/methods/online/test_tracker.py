"""Tracking instant by instant: guarantees for final rows, state and input."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree.errors import FileFormatError, InvalidInputError
from catfree.methods.evidence.track._identify import HORIZON
from catfree.methods.online._learn import WIDEST_SPACING, is_due, learn_step
from catfree.synthetic import make_world
from tests.methods.evidence.evidence_worlds import walk

RATE = 2.0
TRUTH, DETECTIONS, SCENE = walk(people=5, frames=18, seed=3)
CAMERAS = SCENE.rig.camera_count
FRAMES = range(18)


def boxes_of(frame, detections=DETECTIONS):
    return detections[detections.frame == frame]


def feed(tracker, frames=FRAMES, detections=DETECTIONS, **options):
    return [tracker.update(boxes_of(f, detections), f / RATE, **options) for f in frames]


def same(one, other):
    """Return whether two pytrees are equal, bit for bit."""
    a, b = jax.tree.flatten(one), jax.tree.flatten(other)
    equal = [np.array_equal(x, y, equal_nan=True) for x, y in zip(a[0], b[0], strict=True)]
    return a[1] == b[1] and all(equal)


def final_rows(updates):
    return np.concatenate([u.final.to_rows() for u in updates])


@pytest.fixture(scope="module")
def stream():
    """Return all updates of a tracker with a lag of two seconds."""
    tracker = cf.Tracker(SCENE, lag=2.0)
    return [*feed(tracker), tracker.finish()]


@pytest.mark.slow
def test_an_infinite_lag_is_localize():
    tracker = cf.Tracker(SCENE, lag=math.inf)
    updates = feed(tracker)
    assert all(len(u.final) == 0 for u in updates)
    found = tracker.finish().final
    clock = cf.Clock(1_000_000)
    d = DETECTIONS
    at_times = cf.Detections(clock.frame_at(d.frame / RATE), d.camera, d.box, clock=clock)
    order = np.argsort(d.frame, kind="stable")
    expected = cf.localize(at_times[order], SCENE).tracks
    for name in ("frame", "track_id", "position", "covariance", "existence", "velocity"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    assert found.clock == expected.clock
    row, camera = np.nonzero(found.support >= 0)
    for r, c in zip(row[::7], camera[::7], strict=True):
        instant = boxes_of(round(found.time[r] * RATE))
        box = at_times[order].box[expected.support[r, c]]
        assert np.array_equal(instant.box[found.support[r, c]], box)


@pytest.mark.slow
def test_covariances_are_symmetric_to_the_last_bit(stream):
    for tracks in [cf.localize(DETECTIONS, SCENE).tracks, *(u.final for u in stream)]:
        for matrix in (tracks.covariance, tracks.velocity_covariance):
            np.testing.assert_array_equal(matrix[:, 0, 1], matrix[:, 1, 0])


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(st.integers(0, 12), st.sampled_from([0.0, 1.5]))
def test_save_and_restore_change_nothing(tmp_path_factory, first, lag):
    tracker = cf.Tracker(SCENE, lag=lag)
    feed(tracker, range(first))
    path = tmp_path_factory.mktemp("state") / "state.npz"
    tracker.state.save(path)
    again = cf.Tracker(SCENE, lag=lag)
    again.state = cf.TrackerState.load(path)
    assert same(again.state, tracker.state)
    rest = range(first, first + 3)
    for one, other in zip(feed(tracker, rest), feed(again, rest), strict=True):
        assert same(one, other)
    assert same(tracker.finish(), again.finish())


@pytest.mark.slow
def test_a_state_taken_out_is_not_changed_by_later_instants():
    tracker = cf.Tracker(SCENE, lag=1.0)
    feed(tracker, range(6))
    state = tracker.state
    first = feed(tracker, range(6, 9))
    tracker.state = state
    for one, other in zip(first, feed(tracker, range(6, 9)), strict=True):
        assert same(one, other)


@pytest.mark.slow
def test_every_instant_is_final_once_and_as_late_as_promised(stream):
    told = [np.unique(u.final.time) for u in stream]
    assert (np.diff(np.concatenate(told)) > 0).all()
    for frame, times in zip(FRAMES, told, strict=False):
        assert (times <= frame / RATE - 2.0 + 1e-6).all()
    rows = final_rows(stream)
    assert (rows[:, 1] >= 0).all()
    assert len(np.unique(rows[:, :2], axis=0)) == len(rows)


@pytest.mark.slow
def test_everyone_is_where_they_are_and_nobody_else_is(stream):
    rows = final_rows(stream)
    rows[:, 0] = np.round(rows[:, 0] * RATE / 1e6)
    found = cf.evaluation.detection_metrics(TRUTH, rows, frames=np.arange(4, 18))
    assert (found.fn, found.fp) == (0, 0)


@pytest.mark.slow
def test_support_names_the_boxes_of_the_instant(stream):
    seen = 0
    for update in stream:
        for r in range(len(update.final)):
            instant = boxes_of(round(update.final.time[r] * RATE))
            for camera, row in enumerate(update.final.support[r]):
                assert row < 0 or instant.camera[row] == camera
                seen += row >= 0
    assert seen > 100


@pytest.mark.slow
def test_without_lag_positions_are_final_at_once():
    """New people become final in the next instant, under the same identity."""
    for frame, update in enumerate(feed(cf.Tracker(SCENE, lag=0.0), range(8))):
        assert not update.events
        known = np.isin(update.provisional.track_id, update.final.track_id)
        assert known.all() if frame else not known.any()
        now = update.provisional[known]
        assert (now.existence >= update.final.existence).all()
        for name in ("frame", "track_id", "ground_xy", "support", "design_sigma", "whole_views"):
            assert np.allclose(getattr(now, name), getattr(update.final, name))


@pytest.mark.slow
def test_the_order_of_boxes_changes_nothing():
    rng = np.random.default_rng(0)
    one, other = (cf.Tracker(SCENE, lag=1.0) for _ in range(2))
    for frame in range(8):
        boxes = boxes_of(frame)
        a = one.update(boxes, frame / RATE)
        b = other.update(boxes[rng.permutation(len(boxes))], frame / RATE)
        assert np.array_equal(a.final.to_rows(), b.final.to_rows())
        assert np.array_equal(a.provisional.to_rows(), b.provisional.to_rows())


@pytest.mark.slow
def test_the_order_of_cameras_changes_nothing():
    order = np.random.default_rng(1).permutation(CAMERAS)
    place = np.argsort(order)
    scene = cf.Scene(SCENE.rig.select(order), SCENE.ground, SCENE.extent, SCENE.metric)
    d = DETECTIONS
    moved = cf.Detections(d.frame, place[d.camera], d.box)
    one = feed(cf.Tracker(SCENE, lag=1.0), range(8))
    other = feed(cf.Tracker(scene, lag=1.0), range(8), moved)
    assert np.allclose(final_rows(one), final_rows(other), atol=1e-6)


@pytest.mark.slow
def test_nobody_vanishes_while_a_camera_is_silent():
    d = DETECTIONS
    less = d[~((d.camera == 1) & (d.frame >= 6))]
    tracker = cf.Tracker(SCENE, lag=1.0)
    feed(tracker, range(6), less)
    others = [c for c in range(CAMERAS) if c != 1]
    for frame in range(6, 18):
        now = tracker.update(boxes_of(frame, less), frame / RATE, cameras=others).provisional
        truth = TRUTH[TRUTH[:, 0] == frame, 2:]
        assert (np.linalg.norm(truth[:, None] - now.ground_xy, axis=-1).min(1) < 0.5).all()


@pytest.mark.slow
def test_someone_who_comes_back_is_the_same():
    _truth, d, scene = walk(people=1, frames=24, recall=1.0, clutter=0.0)
    hidden = d[(d.frame < 9) | (d.frame >= 14)]
    tracker = cf.Tracker(scene, lag=2.0)
    updates = [*feed(tracker, range(24), hidden), tracker.finish()]
    identity = final_rows(updates)[:, 1]
    assert len(np.unique(identity)) == 1
    events = [e for u in updates for e in u.events]
    provisional = np.unique(np.concatenate([u.provisional.track_id for u in updates]))
    assert {e.old for e in events} == set(provisional.tolist()) - {identity[0]}
    assert all(e.kind == "merge" and e.new == identity[0] for e in events)


@pytest.mark.slow
def test_the_state_does_not_grow():
    tracker = cf.Tracker(SCENE, lag=1.0)
    sizes = []
    for k in range(90):
        tracker.update(boxes_of(k % 18), k / RATE)
        state = tracker.state
        sizes.append((len(state.window), len(np.unique(state.sample.frame)), len(state.identity)))
    window, sample, identities = map(max, zip(*sizes, strict=True))
    assert window <= 2
    assert sample <= 60
    assert identities < 60


def test_learning_becomes_rare():
    due = [k for k in range(10_000) if is_due(k)]
    assert due[:12] == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 1536]
    assert len(due) < 30
    assert WIDEST_SPACING * 60 < 2000


@pytest.mark.slow
def test_reset_is_a_new_tracker():
    tracker = cf.Tracker(SCENE, lag=0.5)
    first = feed(tracker, range(4))
    tracker.finish()
    with pytest.raises(InvalidInputError, match="finished"):
        tracker.update(boxes_of(0), 99.0)
    tracker.reset()
    for one, other in zip(first, feed(tracker, range(4)), strict=True):
        assert same(one, other)


def test_instants_without_boxes_are_instants():
    tracker = cf.Tracker(SCENE, lag=0.0)
    none = DETECTIONS[:0]
    for k in range(3):
        update = tracker.update(none, k / RATE)
        assert len(update.final) == len(update.provisional) == 0
    assert len(tracker.finish().final) == 0


@pytest.mark.slow
def test_an_instant_without_boxes_is_one_after_people_are_known_too():
    tracker = cf.Tracker(SCENE, lag=0.0)
    for frame in FRAMES[:12]:
        before = tracker.update(boxes_of(frame), frame / RATE)
    assert len(before.provisional)
    empty = tracker.update(DETECTIONS[:0], FRAMES[12] / RATE)
    assert (empty.final.supporting_cameras == 0).all()
    assert len(tracker.update(boxes_of(FRAMES[13]), FRAMES[13] / RATE).provisional)


def test_what_makes_no_sense_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="lag"):
        cf.Tracker(SCENE, lag=-1.0)
    with pytest.raises(InvalidInputError, match="lag"):
        cf.Tracker(SCENE, lag=math.nan)
    with pytest.raises(InvalidInputError, match="evidence"):
        cf.Tracker(SCENE, cf.Settings.paper())
    tracker = cf.Tracker(SCENE)
    tracker.update(DETECTIONS[:0], 1.0)
    for time in (1.0, 1.0 + 1e-7, 0.5, math.nan, math.inf):
        with pytest.raises(InvalidInputError, match="time"):
            tracker.update(DETECTIONS[:0], time)
    with pytest.raises(InvalidInputError, match="camera"):
        tracker.update(DETECTIONS[:0], 2.0, cameras=[CAMERAS])
    with pytest.raises(InvalidInputError, match="delivered"):
        tracker.update(boxes_of(0), 2.0, cameras=[])
    with pytest.raises(InvalidInputError, match="cameras"):
        tracker.state = cf.Tracker(walk(rig=SCENE.rig.select([0, 1, 2]))[2]).state
    lower = cf.Plane(SCENE.ground.normal, SCENE.ground.offset + 0.1)
    turned = SCENE.rig.select(np.roll(np.arange(CAMERAS), 1))
    for rig, ground in ((SCENE.rig, lower), (turned, SCENE.ground)):
        with pytest.raises(InvalidInputError, match="another scene: its cameras or its ground"):
            tracker.state = cf.Tracker(cf.Scene(rig, ground, SCENE.extent)).state
    DETECTIONS.save(tmp_path / "boxes.npz")
    with pytest.raises(FileFormatError):
        cf.TrackerState.load(tmp_path / "boxes.npz")
    path = tmp_path / "old.npz"
    cf.Tracker(SCENE).state.save(path)
    columns = dict(np.load(path))
    columns[".learned.places"] = np.zeros((5, 2))
    np.savez(path, **columns)
    with pytest.raises(FileFormatError, match="not the state of a tracker of this version"):
        cf.TrackerState.load(path)


@pytest.mark.slow
def test_cameras_may_come_in_an_array():
    listed, array = (cf.Tracker(SCENE, lag=1.0) for _ in range(2))
    expected = listed.update(boxes_of(0), 0.0, cameras=list(range(CAMERAS)))
    found = array.update(boxes_of(0), np.float64(0), cameras=np.arange(CAMERAS))
    assert same(found.provisional, expected.provisional)
    with pytest.raises(InvalidInputError, match=r"camera\[0\] is -1; indices start at 0"):
        array.update(DETECTIONS[:0], 1.0, cameras=[-1])


@pytest.mark.slow
def test_a_camera_that_says_it_has_no_picture_is_not_counted_as_missing_people():
    alive = [c for c in range(CAMERAS) if c != 1]
    tracker = cf.Tracker(SCENE, lag=1.0)
    feed(tracker, detections=DETECTIONS[DETECTIONS.camera != 1], cameras=alive)
    trials = tracker.state.learned.trials.sum((1, 2))
    assert trials[1] == 0
    assert (trials[alive] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("without", [0, 7])
def test_one_instant_without_embeddings_does_not_end_looks(without):
    world = make_world("ring5", frames=17, people=6, seed=2)
    boxes = world.detections
    tracker = cf.Tracker(world.true_scene, lag=1.0)
    for f in range(17):
        here = boxes_of(f, boxes)
        tracker.update(replace(here, embedding=None) if f == without else here, f / RATE)
    assert tracker.state.learned.likeness is not None
    assert tracker.state.sample.embedding is not None
    assert without not in tracker.state.sample.frame


@pytest.mark.slow
def test_what_was_learned_of_speed_holds_at_another_rate():
    fast, slow = cf.Tracker(SCENE, lag=1.0), cf.Tracker(SCENE, lag=1.0)
    feed(fast)
    slow.state = learn_step(replace(fast.state, times=np.array([0.0, 1.0])), 2.0)
    before, after = (t.state.learned for t in (fast, slow))
    factor = float(after.step / before.step)
    np.testing.assert_allclose(after.steps, before.steps * [factor**2, 1])


@pytest.mark.slow
def test_a_refused_time_changes_nothing():
    tracker = cf.Tracker(SCENE, lag=1.0)
    tracker.update(boxes_of(0), 0.0)
    before = tracker.state
    for wrong in (1e15, math.inf):
        with pytest.raises(InvalidInputError, match=r"time|seconds"):
            tracker.update(boxes_of(1), wrong)
    assert tracker.state is before
    tracker.update(boxes_of(1), 0.5)


@pytest.mark.slow
def test_an_infinite_lag_takes_instants_with_different_columns_and_ends_once():
    tracker = cf.Tracker(SCENE, lag=math.inf)
    scored = replace(DETECTIONS, score=np.full(len(DETECTIONS), 0.9))
    for f in FRAMES:
        tracker.update(boxes_of(f, scored if f == 3 else DETECTIONS), f / RATE)
    first, second = tracker.finish(), tracker.finish()
    assert len(first.final) > 0
    assert len(second.final) == 0
    assert first.final_until == FRAMES[-1] / RATE


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), [(1.0, math.inf), (math.inf, 1.0)])
def test_a_state_of_another_kind_of_lag_is_refused(one, other):
    tracker, later = cf.Tracker(SCENE, lag=one), cf.Tracker(SCENE, lag=other)
    later.state = tracker.state  # nothing has happened yet
    feed(tracker, range(3))
    with pytest.raises(InvalidInputError, match="infinite lag"):
        later.state = tracker.state


@pytest.mark.slow
def test_without_a_lag_final_positions_are_some_of_those_of_now():
    world = make_world("ring4", frames=40, people=5, seed=1)
    tracker = cf.Tracker(world.true_scene, lag=0)
    known: set[int] = set()
    for f in range(40):
        update = tracker.update(boxes_of(f, world.detections), f / RATE)
        is_final = np.isin(update.provisional.track_id, update.final.track_id)
        is_hidden = (update.provisional.support < 0).all(1)
        not_final = update.provisional.track_id[~is_final & ~is_hidden]
        assert known.isdisjoint(not_final.tolist())  # people seen but not yet final are new
        known |= set(update.final.track_id.tolist())
        now = update.provisional[is_final]
        assert np.array_equal(now.track_id, update.final.track_id)
        assert np.array_equal(now.ground_xy, update.final.ground_xy)
        assert update.final_until >= f / RATE


@pytest.mark.slow
def test_people_whom_many_see_are_there_at_once_and_final_if_they_stay():
    """Everyone appears in one instant, and either stays or is never seen again."""
    tracker = cf.Tracker(SCENE, lag=2.0)
    feed(tracker, range(10))
    for stay in (True, False):
        tracker.reset(keep_learned=True)
        updates = feed(tracker, [0])
        updates += feed(tracker, range(1, 9), DETECTIONS if stay else DETECTIONS[:0])
        true = TRUTH[TRUTH[:, 0] == 0]
        rows = updates[0].provisional.to_rows()
        found = cf.evaluation.detection_metrics(true, rows, frames=np.arange(1))
        assert (found.fn, found.fp) == (0, 0)
        final = final_rows([*updates, tracker.finish()])
        assert (final[:, 0] == 0).sum() == (len(true) if stay else 0)


@pytest.mark.slow
def test_the_first_instant_teaches_where_people_go():
    tracker = cf.Tracker(SCENE, lag=2.0)
    people = len(feed(tracker, [0])[0].provisional)
    learned = tracker.state.learned
    assert len(learned.places) == people == 5
    assert np.isfinite(learned.usual).all()


@pytest.mark.slow
def test_whoever_leaves_was_there_as_surely_as_whoever_stays():
    rows = cf.localize(DETECTIONS, SCENE).tracks
    leaving = rows[(rows.track_id == 0) & (rows.frame > 5)]
    without = np.setdiff1d(np.arange(len(DETECTIONS)), leaving.support)
    tracker = cf.Tracker(SCENE, lag=8.0)
    updates = [*feed(tracker, detections=DETECTIONS[without]), tracker.finish()]
    final = [u.final[np.round(u.final.time * RATE) == 5] for u in updates]
    existence = np.concatenate([part.existence for part in final])
    assert len(existence) == 5
    assert (existence > 0.9999).all()


@pytest.mark.slow
@pytest.mark.parametrize(("empty", "known"), [(5, True), (HORIZON, False)])
def test_whoever_is_away_for_too_long_is_somebody_new(empty, known):
    tracker = cf.Tracker(SCENE, lag=1.0)
    rows = [*feed(tracker, range(9))]
    away = [tracker.update(DETECTIONS[:0], (9 + k) / RATE) for k in range(empty)]
    assert all(len(update.final) == 0 for update in away[2:])
    back = [tracker.update(boxes_of(f), (f + empty) / RATE) for f in range(9, 18)]
    before, after = (set(final_rows(part)[:, 1]) for part in (rows, [*back, tracker.finish()]))
    assert bool(before & after) == known


@pytest.mark.slow
def test_the_next_day_begins_with_what_was_learned():
    tracker = cf.Tracker(SCENE, lag=1.0)
    day = [*feed(tracker), tracker.finish()]
    learned = tracker.state.learned
    tracker.reset(keep_learned=True)
    assert tracker.state.learned is learned
    next_day = [*feed(tracker), tracker.finish()]
    begun, went_on = (sum(len(u.provisional) for u in rows[:4]) for rows in (day, next_day))
    assert 0 < begun <= went_on
    first, second = (set(final_rows(rows)[:, 1]) for rows in (day, next_day))
    assert not first & second
    tracker.reset()
    assert same(tracker.state, cf.Tracker(SCENE, lag=1.0).state)
