"""A plan is read as written, and a damaged one is refused in one sentence."""

import copy
import dataclasses
import json

import pytest
from hypothesis import given, strategies as st

from catfree._run.sharded._plan_file import METHODS, PlanFile, read_plan, shard_at, write_plan
from catfree._run.sharded._shard import Shard
from catfree.errors import FileFormatError, InvalidInputError
from catfree.synthetic import make_world
from catfree.types import Clock

CLOCK = Clock(5.0, 3.0, False)
SHARDS = tuple(
    Shard(
        index, 2, 10 * index, 10 * index + 10, max(10 * index - 2, 0), 10 * index + 12, CLOCK, "f"
    )
    for index in range(2)
)

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)


@given(
    detections=st.none() | texts,
    videos=st.lists(texts, max_size=3).map(tuple),
    offsets=st.none() | st.lists(st.integers(-9, 9), min_size=2, max_size=3).map(tuple),
    clock=st.tuples(st.floats(0.1, 100), st.floats(-1e9, 1e9), st.booleans()),
    site=texts,
    silent=st.lists(st.tuples(*[st.integers(0, 99)] * 3), max_size=3).map(tuple),
    method=st.sampled_from(METHODS),
    paths=st.tuples(texts, texts, texts, texts, texts),
    names=st.lists(texts, max_size=3).map(tuple),
)
def test_a_plan_is_read_as_it_was_written(
    tmp_path_factory, detections, videos, offsets, clock, site, silent, method, paths, names
):
    change = {"detections": detections, "videos": videos, "offsets": offsets, "site": site}
    change |= {"silent": silent, "camera_names": names}
    parts = [dataclasses.replace(shard, clock=Clock(*clock), **change) for shard in SHARDS]
    plan = PlanFile(tuple(parts), *paths[:2], method, *paths[2:])
    path = write_plan(tmp_path_factory.mktemp("plan") / "plan.json", plan)
    found = read_plan(path)
    assert dataclasses.replace(found, shards=()) == dataclasses.replace(plan, shards=())
    assert [vars(shard) for shard in found.shards] == [vars(shard) for shard in plan.shards]
    assert [shard.fingerprint for shard in found.shards] == [s.fingerprint for s in plan.shards]


def places(value, path=()):
    """Yield the paths to all values of a JSON document."""
    yield path
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*path, key))


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=5,
)


@pytest.mark.slow
@given(st.data())
def test_a_damaged_plan_is_read_or_refused_by_name(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    write_plan(path, PlanFile(SHARDS, "scene.json", "out"))
    document = json.loads(path.read_text())
    place = data.draw(st.sampled_from([place for place in places(document) if place]))
    holder = document
    for key in place[:-1]:
        holder = holder[key]
    if data.draw(st.booleans()):
        del holder[place[-1]]
    else:
        holder[place[-1]] = data.draw(anything)
    path.write_text(json.dumps(document))
    plan, said = None, ""
    try:
        plan = read_plan(path)
    except FileFormatError as error:
        said = str(error)
    if plan is None:
        assert str(path) in said
        assert "catfree plan" in said
    else:
        assert plan.method in METHODS
        assert [shard.index for shard in plan.shards] == list(range(len(plan.shards)))


@pytest.mark.parametrize("method", ["", "papers", "Settings"])
def test_a_method_that_there_is_not_is_refused(tmp_path, method):
    path = write_plan(tmp_path / "plan.json", PlanFile(SHARDS, "scene.json", "out", method))
    with pytest.raises(FileFormatError, match="method"):
        read_plan(path)


@given(st.binary(max_size=100))
def test_other_files_are_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"plan\.json"):
        read_plan(path)


def test_a_plan_of_another_version_and_none_at_all(tmp_path):
    path = write_plan(tmp_path / "plan.json", PlanFile(SHARDS, "scene.json", "out"))
    document = json.loads(path.read_text())
    other = copy.deepcopy(document) | {"schema": "catfree plan 2"}
    path.write_text(json.dumps(other))
    with pytest.raises(FileFormatError, match="'catfree plan 2' instead of 'catfree plan 1'"):
        read_plan(path)
    with pytest.raises(InvalidInputError, match=r"There is no file .*none\.json"):
        read_plan(tmp_path / "none.json")


def test_a_plan_without_a_unit_is_of_a_scene_in_meters(tmp_path):
    path = write_plan(tmp_path / "plan.json", PlanFile(SHARDS, "scene.json", "out"))
    document = json.loads(path.read_text())
    del document["unit"]
    path.write_text(json.dumps(document))
    assert read_plan(path).unit == "m"


def test_boxes_in_memory_do_not_fit_into_a_file(tmp_path):
    boxes = make_world("ring4", frames=3, people=2).detections
    plan = PlanFile((dataclasses.replace(SHARDS[0], detections=boxes),), "scene.json", "out")
    with pytest.raises(InvalidInputError, match="boxes in a file"):
        write_plan(tmp_path / "plan.json", plan)


def test_finished_shards_are_not_taken_for_those_of_a_plan_that_makes_them_otherwise(tmp_path):
    path, plan = tmp_path / "plan.json", PlanFile(SHARDS, "scene.json", "out")
    paper = dataclasses.replace(plan, method="paper")
    for one in (paper, plan):  # no shard is finished
        write_plan(path, one)
    (tmp_path / "part-00000.json").write_text("{}")
    fewer = dataclasses.replace(plan, shards=SHARDS[:1])
    assert len(read_plan(write_plan(path, fewer)).shards) == 1
    for change in ({"method": "paper"}, {"unit": "cm"}, {"scene": "b"}, {"detector": "yolo.onnx"}):
        name = next(iter(change))
        with pytest.raises(InvalidInputError, match=f"a plan with another {name}, .* another fol"):
            write_plan(path, dataclasses.replace(plan, **change))
        assert read_plan(path).method == "default"
    path.write_text("{}")
    assert write_plan(path, paper) == path


@given(st.integers(-5, 5))
def test_a_shard_is_found_by_its_index_or_refused(index):
    if 0 <= index < len(SHARDS):
        assert shard_at(SHARDS, index).index == index
    else:
        with pytest.raises(InvalidInputError, match=f"no shard {index}: .* from 0 to 1"):
            shard_at(SHARDS, index)
