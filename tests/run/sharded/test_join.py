"""The joined table equals that of one run for any cuts, order and repetitions."""

import dataclasses
import hashlib
import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree._run.sharded import _join
from catfree._run.sharded._join import join_shards
from catfree._run.sharded._plan_file import PlanFile, write_plan
from catfree._run.sharded._receipt import PLAN, files_of
from catfree.errors import FileFormatError, InvalidInputError
from catfree.methods.evidence.report._working_area import UsualPlace, in_working_area
from tests.run.sharded.walks import HEIGHT, NOISE, plan_of, seen_by, tracks_of, walks, write

SLOW_DISK = settings(max_examples=25, deadline=None)


def partners(tracks):
    """Return for each pair of rows whether they are one person."""
    return tracks.track_id[:, None] == tracks.track_id[None, :]


def in_place(tracks):
    """Sort rows by frame and line, as each person stays on a line."""
    return tracks[np.lexsort((np.round(tracks.ground_xy[:, 1]), tracks.frame))]


@pytest.mark.slow
@SLOW_DISK
@given(
    st.integers(0, 2**16),
    st.integers(1, 6),
    st.integers(60, 200),
    st.integers(25, 120),
    st.integers(2, 24),
    st.randoms(use_true_random=False),
)
def test_joining_undoes_cutting(tmp_path_factory, seed, people, frames, length, margin, random):
    rng, out = np.random.default_rng(seed), tmp_path_factory.mktemp("day")
    whole = walks(rng, people, frames)
    plan = plan_of(frames, length, min(margin, length // 2))
    parts = {shard.index: seen_by(shard, whole, rng) for shard in plan}
    random.shuffle(plan)
    for shard in plan:
        write(out, shard, parts[shard.index])
    joined = cf.join(out)
    assert len(joined) == len(whole)
    one, two = in_place(whole), in_place(joined)
    np.testing.assert_array_equal(one.frame, two.frame)
    np.testing.assert_allclose(one.ground_xy, two.ground_xy, atol=NOISE)
    np.testing.assert_array_equal(partners(one), partners(two))
    assert set(joined.track_id) == set(range(len(set(whole.track_id))))
    np.testing.assert_allclose(joined.time, joined.frame / 5)
    np.testing.assert_array_equal(np.lexsort((joined.track_id, joined.frame)), range(len(joined)))


def table_bytes(out):
    files = sorted(out.glob("part-*.parquet"))
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Write and join four shards of five people."""
    out = tmp_path_factory.mktemp("recording")
    rng = np.random.default_rng(3)
    whole = walks(rng, 5, 200)
    parts = [(shard, seen_by(shard, whole, rng)) for shard in plan_of(200, 50, 10)]
    for shard, tracks in parts:
        write(out, shard, tracks)
    join_shards(out)
    return out, parts


@pytest.mark.slow
@given(st.permutations(range(4)), st.lists(st.integers(0, 3), max_size=3))
@settings(max_examples=10, deadline=None)
def test_order_and_repetition_change_no_byte(recording, tmp_path_factory, order, again):
    out, parts = recording
    other = tmp_path_factory.mktemp("other")
    for index in [*order, *again]:
        write(other, *parts[index])
    join_shards(other)
    assert table_bytes(other) == table_bytes(out)
    join_shards(other)  # joining again
    assert table_bytes(other) == table_bytes(out)
    one, two = (
        json.loads((folder / "_shards" / "manifest.json").read_text()) for folder in (out, other)
    )
    assert one == two


def test_a_gap_is_bridged_across_shards(tmp_path):
    """Nine people keep walking; one is not seen for two frames just after a cut."""
    frame = np.arange(100)
    rows = [
        np.column_stack([frame, 0 * frame + line, 0.25 * frame, 4.0 * line + 0 * frame])
        for line in range(9)
    ]
    hidden = rows[4]
    whole = tracks_of(np.concatenate(rows))
    rows[4] = hidden[(frame < 52) | (frame > 53)]
    seen = np.concatenate(rows)
    late = (seen[:, 1] == 4) & (seen[:, 0] > 53)
    seen[late, 1] = 99
    rng = np.random.default_rng(0)
    for shard in plan_of(100, 50, 2):
        write(tmp_path, shard, seen_by(shard, tracks_of(seen), rng))
    joined = cf.join(tmp_path)
    assert len(set(joined.track_id)) == 9
    assert len(joined) == len(whole) - 2


def test_a_track_in_the_overlap_only_is_not_reported(tmp_path):
    shards = plan_of(100, 50, 10)
    frame = np.arange(100)
    line = np.column_stack([frame, 0 * frame, 0.2 * frame, 0 * frame])
    ghost = np.column_stack([np.arange(52, 58), np.full(6, 7), np.zeros(6), np.full(6, 30.0)])
    write(tmp_path, shards[0], tracks_of(np.concatenate([line[:60], ghost])))
    write(tmp_path, shards[1], tracks_of(line[40:]))
    joined = cf.join(tmp_path)
    assert len(joined) == 100
    assert set(joined.track_id) == {0}


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**16), st.integers(20, 150), st.integers(0, 8))
def test_the_working_area_is_that_of_the_whole_recording(tmp_path_factory, seed, length, known):
    """The area does not depend on the cuts; people with unknown visibility stay."""
    rng, out = np.random.default_rng(seed), tmp_path_factory.mktemp("day")
    whole = walks(rng, 4, 150)
    sigma = np.exp(rng.normal(0, 2, len(whole)))
    views = rng.integers(0, 5, len(whole))
    whole = dataclasses.replace(
        whole,
        cameras=np.full(len(whole), 15, np.uint64),
        support=np.zeros((len(whole), 0), np.int64),
        design_sigma=np.where(rng.integers(0, 8, len(whole)) < known, sigma, np.nan),
        whole_views=views,
    )
    reported = []
    for shard in plan_of(150, length, 10):
        part = seen_by(shard, whole, rng)
        write(out, shard, part)
        reported.append(part[(part.frame >= shard.first) & (part.frame < shard.stop)])
    xy, frame, sigma, views = (
        np.concatenate([getattr(part, name) for part in reported])
        for name in ("ground_xy", "frame", "design_sigma", "whole_views")
    )
    inside = np.isnan(sigma)
    seen = ~inside
    inside[seen] = in_working_area(
        xy[seen] / HEIGHT, np.column_stack([sigma, views])[seen], 4, cf.Settings().evidence
    )
    joined = cf.join(out)
    order = np.lexsort((np.round(xy[inside, 1]), frame[inside]))
    found = in_place(joined)
    np.testing.assert_array_equal(found.frame, frame[inside][order])
    np.testing.assert_allclose(found.ground_xy, xy[inside][order])
    assert set(joined.track_id) == set(range(cf.open_tracks(out).people))
    assert joined.design_sigma is None


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.integers(1, 9), st.integers(0, 9), st.integers(20, 150), st.integers(1, 60))
def test_the_area_is_learned_from_so_many_instants(tmp_path_factory, step, first, length, most):
    """The result is independent of frame numbers and cuts."""
    rng, out = np.random.default_rng(most), tmp_path_factory.mktemp("day")
    whole = walks(rng, 3, 60)
    whole = dataclasses.replace(
        whole,
        frame=step * whole.frame + first,
        design_sigma=np.ones(len(whole)),
        whole_views=np.arange(len(whole)),
    )
    for shard in plan_of(60 * step + first, length, 5):
        write(out, shard, seen_by(shard, whole, rng))
    learned = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_join, "INSTANTS", most)
        patch.setattr(
            _join, "usual_place", lambda *rows: learned.append(rows[1][:, 1]) or UsualPlace(1, 1)
        )
        _join._learn_area(out, _join.read_receipts(out))
    at = np.unique(whole.frame[np.isin(whole.whole_views, learned[0])])
    every = -(-(60 * step + first) // most)
    wanted = [whole.frame[whole.frame // every == k].min() for k in np.unique(whole.frame // every)]
    np.testing.assert_array_equal(at, wanted)
    assert len(at) <= most


def test_nobody_at_all(tmp_path):
    for shard in plan_of(100, 50, 10):
        write(tmp_path, shard, tracks_of(np.zeros((0, 4))))
    assert len(cf.join(tmp_path)) == 0
    assert cf.open_tracks(tmp_path).people == 0


@pytest.fixture
def copy(recording, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(recording[0], out)
    return out


def edit(path, **changes):
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | changes))


def flip(path, at=0.5):
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 255
    path.write_bytes(bytes(content))


DAMAGES = {
    "missing": (lambda f: f.receipt.unlink(), r"1 of 4 shards of the plan are not finished \(2\)"),
    "version": (lambda f: edit(f.receipt, schema="catfree shards 9"), "another version"),
    "cut receipt": (lambda f: f.receipt.write_text(f.receipt.read_text()[:100]), "part-00002.json"),
    "odd receipt": (lambda f: edit(f.receipt, first="x"), "part-00002.json"),
    "settings": (lambda f: edit(f.receipt, settings={}), r"00002\.json is damaged .it has no sett"),
    "odd settings": (lambda f: edit(f.receipt, settings={"evidence": 1}), "evidence is 1"),
    "other run": (lambda f: edit(f.receipt, run="0"), "shard 2 was made with other settings"),
    "scene": (lambda f: edit(f.receipt, scene_file="0"), "shard 2 was made with another scene"),
    "recording": (lambda f: edit(f.receipt, source="0"), "shard 2 was made with another recording"),
    "plan": (
        lambda f: edit(f.receipt, count=5),
        r"00002\.json: shard 2 .* another plan .* delete this",
    ),
    "overlapping": (lambda f: edit(f.receipt, first=90), "shard 1 ends before frame 100, but"),
    "flipped part": (lambda f: flip(f.part), "part-00002.parquet was changed or truncated"),
    "cut part": (lambda f: f.part.write_bytes(f.part.read_bytes()[:500]), "part-00002.parquet"),
    "missing part": (lambda f: f.part.unlink(), "part-00002.parquet is missing"),
    "flipped fragments": (lambda f: flip(f.fragments), "part-00002.npz was changed or truncated"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_name(copy, name):
    damage, sentence = DAMAGES[name]
    damage(files_of(copy, 2))
    with pytest.raises(FileFormatError, match=sentence):
        join_shards(copy)


def test_a_plan_in_a_file_replaces_an_earlier_one_once_it_is_finished(tmp_path):
    for shard in plan_of(100, 25, 10):
        write(tmp_path, shard, tracks_of(np.zeros((0, 4))))
    plan = plan_of(100, 50, 10)
    write_plan(tmp_path / PLAN, PlanFile(tuple(plan), "scene.json", str(tmp_path)))
    write(tmp_path, plan[0], tracks_of(np.zeros((0, 4))))
    with pytest.raises(FileFormatError, match=r"1 of 2 shards of the plan are not finished \(1\)"):
        join_shards(tmp_path)
    assert len(list((tmp_path / "_shards").glob("part-*.json"))) == 4
    write(tmp_path, plan[1], tracks_of(np.zeros((0, 4))))
    assert len(join_shards(tmp_path).parts) == 2
    for folder in (tmp_path, tmp_path / "_shards"):
        assert {path.stem for path in folder.glob("part-*")} == {"part-00000", "part-00001"}


def test_what_an_earlier_plan_found_is_not_joined_for_a_new_one(copy):
    before = table_bytes(copy)
    plan = tuple(plan_of(200, 50, 12))  # as many shards, with more overlap
    write_plan(copy / PLAN, PlanFile(plan, "scene.json", str(copy)))
    with pytest.raises(FileFormatError, match=r"4 of 4 shards of the plan are not finished \(0, 1"):
        join_shards(copy, plan)
    with pytest.raises(FileFormatError, match=rf"by another plan, delete {copy / PLAN}\."):
        join_shards(copy)
    assert table_bytes(copy) == before
    assert cf.open_tracks(copy).parts


def test_a_scene_of_another_run_is_refused(copy):
    path = copy / "_shards" / "scene.json"
    path.write_text(path.read_text().replace('"extent"', '"extent" '))
    with pytest.raises(FileFormatError, match="is not the scene that the shards were made with"):
        join_shards(copy)


def test_an_empty_folder_has_nothing_to_join(tmp_path):
    with pytest.raises(InvalidInputError, match="no finished shard"):
        cf.join(tmp_path)
    with pytest.raises(InvalidInputError, match="no folder"):
        cf.join(tmp_path / "nowhere")
