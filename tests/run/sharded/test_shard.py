"""Shards cover a recording once, overlap as requested, and read only their own boxes."""

import itertools
import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree._run.sharded._shard import boxes_of_shard, silent_pictures
from catfree.adapters.tables._detections_table import write_detections_parquet
from catfree.errors import InvalidInputError
from catfree.types import Clock, Detections


def boxes(frames, cameras=2):
    frame = np.asarray(frames, np.int64)
    count = len(frame)
    corner = np.random.default_rng(0).uniform(0, 100, (count, 2))
    return Detections(frame, np.arange(count) % cameras, np.hstack([corner, corner + 10]))


@pytest.mark.slow
@given(
    st.lists(st.integers(-200, 500), min_size=1, max_size=20),
    st.floats(20, 400),
    st.floats(0, 0.99),
    st.floats(2, 30),
)
@settings(max_examples=40, deadline=None)
def test_every_frame_is_reported_once_and_seen_by_neighbors(frames, every, share, rate):
    plan = cf.shards(boxes(frames), every, share * every, rate)
    assert plan[0].first == min(frames)
    assert plan[-1].stop == max(frames) + 1
    assert [shard.index for shard in plan] == list(range(len(plan)))
    assert {shard.count for shard in plan} == {len(plan)}
    margin = share * every * rate / 2
    length = max(1, round(every * rate))
    for one, two in itertools.pairwise(plan):
        assert one.stop == two.first
        assert one.stop - one.first == length
        assert two.first - two.first_seen >= min(margin, two.first - plan[0].first) - 1e-6
        assert one.stop_seen - one.stop >= min(margin, plan[-1].stop - one.stop) - 1e-6
        assert one.fingerprint != two.fingerprint
    assert plan[-1].stop - plan[-1].first < 1.5 * length + 1
    for shard in plan:
        seen = boxes_of_shard(shard)
        within = [f for f in frames if shard.first_seen <= f < shard.stop_seen]
        assert sorted(seen.frame) == sorted(within)
        assert seen.clock == shard.clock == Clock(rate)


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(-9, 70), st.integers(0, 2)), max_size=40), st.integers(0, 9))
@settings(max_examples=40, deadline=None)
def test_each_shard_knows_which_of_its_pictures_do_not_exist(silent, overlap):
    plan = cf.shards(boxes(range(60)), every=10, overlap=overlap, frame_rate=2, silent=silent)
    for shard in plan:
        within = {row for row in silent if shard.first_seen <= row[0] < shard.stop_seen}
        found = [tuple(row) for row in silent_pictures(shard).tolist()]
        assert set(found) == within
        assert len(found) == len(within)
        assert (shard.silent == ()) == (not within)
    plain = cf.shards(boxes(range(60)), every=10, overlap=overlap, frame_rate=2)
    for shard, other in zip(plan, plain, strict=True):
        assert (shard.fingerprint == other.fingerprint) == (shard.silent == ())


@pytest.mark.parametrize("silent", [[[1]], [1, 2], [[0.5, 1]], "none"])
def test_missing_pictures_are_pairs_of_integers(silent):
    with pytest.raises(InvalidInputError, match="silent"):
        cf.shards(boxes(range(9)), frame_rate=2, silent=silent)


@pytest.mark.parametrize("suffix", ["npz", "NPZ", "parquet", "folder"])
@given(st.lists(st.integers(0, 300), min_size=2, max_size=30))
@settings(max_examples=4, deadline=None)
def test_boxes_in_files_are_those_in_memory(tmp_path_factory, suffix, frames):
    folder = tmp_path_factory.mktemp("boxes")
    table = boxes(sorted(frames))
    if suffix in ("npz", "NPZ"):
        path = folder / f"boxes.{suffix}"
        table.save(path)
    elif suffix == "parquet":
        path = write_detections_parquet(folder / "boxes.parquet", table)
    else:
        path, middle = folder / "parts", len(table) // 2
        path.mkdir()
        write_detections_parquet(path / "a.parquet", table[:middle])
        write_detections_parquet(path / "b.parquet", table[middle:])
    one, two = (cf.shards(source, 20, 4, frame_rate=5.0) for source in (table, path))
    assert len(one) == len(two)
    for in_memory, in_file in zip(one, two, strict=True):
        assert len(pickle.dumps(in_file)) < 2000
        first, second = (
            boxes_of_shard(in_memory),
            boxes_of_shard(pickle.loads(pickle.dumps(in_file))),
        )
        order = [np.lexsort((b.box[:, 0], b.camera, b.frame)) for b in (first, second)]
        np.testing.assert_array_equal(first.box[order[0]], second.box[order[1]])
        np.testing.assert_array_equal(first.frame[order[0]], second.frame[order[1]])


def test_a_changed_file_is_refused(tmp_path):
    path = tmp_path / "boxes.npz"
    boxes(range(100)).save(path)
    (shard,) = cf.shards(path, 60, 10, 5)
    boxes(range(101)).save(path)
    with pytest.raises(InvalidInputError, match="changed after shard 0 of 1 was planned"):
        boxes_of_shard(shard)


def test_equal_videos_are_refused_before_any_shard_runs(tmp_path):
    for camera in ("one", "two"):
        (tmp_path / camera).mkdir()
        cv2.imwrite(str(tmp_path / camera / "0.png"), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(InvalidInputError, match="same recording"):
        cf.shards([tmp_path / "one", tmp_path / "two"], frame_rate=5)


def test_the_clock_of_the_boxes_is_used():
    table = boxes(range(100))
    clock = Clock(4.0, 1.5e9, utc=True)
    timed = Detections(table.frame, table.camera, table.box, clock=clock)
    assert {shard.clock for shard in cf.shards(timed, 10, 2)} == {clock}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"every": 0}, "every is 0; it must be a positive number"),
        ({"every": np.nan}, "every is nan; it must be a positive number"),
        ({"overlap": -1}, "overlap is -1.*; it must be a number of seconds"),
        ({"every": 10, "overlap": 10}, "Make the shards longer than their overlap"),
        ({"frame_rate": None}, "have no clock, so seconds are undefined. Pass frame_rate"),
        ({"frame_rate": 1e9, "every": 1e-9, "overlap": 0}, "make 1000"),
        ({"site": "a/b"}, "site is 'a/b', but it names a folder"),
        ({"offsets": (0, 1)}, "offsets apply only to videos"),
    ],
)
def test_impossible_plans_are_refused(options, sentence):
    table = boxes([0, 1_000_000 - 1] if "1e" in repr(options) else range(50))
    if "make" in sentence:
        table = boxes([0, 10**7])
        sentence = "frames make 10000001 shards"
    with pytest.raises(InvalidInputError, match=sentence):
        cf.shards(table, **({"frame_rate": 5} | options))


def test_nothing_cannot_be_cut(tmp_path):
    with pytest.raises(InvalidInputError, match="hold no boxes"):
        cf.shards(boxes([]), frame_rate=5)
    boxes([]).save(tmp_path / "none.npz")
    with pytest.raises(InvalidInputError, match=r"none\.npz holds no boxes"):
        cf.shards(tmp_path / "none.npz", frame_rate=5)
    path = write_detections_parquet(tmp_path / "none.parquet", boxes([]))
    with pytest.raises(InvalidInputError, match="holds no boxes"):
        cf.shards(path, frame_rate=5)
    with pytest.raises(InvalidInputError, match="no table of detections"):
        cf.shards(tmp_path / "nowhere.parquet", frame_rate=5)
