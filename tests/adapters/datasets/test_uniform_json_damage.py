"""JSON readers answer any wrong value in place of a number with a one-sentence error."""

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.adapters import (
    read_rig_json,
    read_scenario,
    read_scene_json,
    read_uniform_json,
    write_scene_json,
)
from catfree.errors import CatFreeError
from catfree.types import Plane, Rig, Scene

pytestmark = pytest.mark.slow

LOOKING_EAST = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
LOOKING_WEST = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
K = [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]]
T = [0.0, 2.0, 10.0]
JUNK = st.sampled_from(
    [None, True, -1, 0, 1.5, 1e18, 10**30, float("nan"), "", "word", [], [1, "a"], [[1], [1, 2]]]
) | st.sampled_from([{}, {"a": 1}, [None], [{}], [[[]]]])


def uniform() -> dict:
    camera = {"K": K, "t": T, "dist": [0, 0.1], "width": 1920, "height": 1080}
    box = {"box": [1, 2, 3, 4], "score": 0.5, "kpts": [[1, 2, 3]] * 17, "id": 3}
    return {
        "name": "two",
        "units": "m",
        "fps": 2,
        "cameras": [
            camera | {"name": name, "R": R}
            for name, R in (("a", LOOKING_EAST), ("b", LOOKING_WEST))
        ],
        "frames": [
            {
                "frame": 0,
                "gt": [{"id": 1, "x": 0, "y": 0}],
                "views": {"a": [box]},
                "images": {"a": "a.png"},
            }
        ],
        "evaluation_area": {"x": [0, 1], "y": [0, 1]},
    }


def places(node: Any, path: tuple = ()) -> Iterator[tuple]:
    """Return the path of every entry of a document."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def replaced(document: dict, path: tuple, value: Any) -> dict:
    result = copy.deepcopy(json.loads(json.dumps(document)))
    node = result
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return result


def answers_in_a_sentence(read, path) -> bool:
    try:
        read(path)
    except CatFreeError as error:
        return path.name in str(error) and "\n" not in str(error)
    return True


@settings(max_examples=150)
@given(data=st.data(), junk=JUNK)
def test_uniform_json(data, junk, tmp_path_factory):
    path = tmp_path_factory.mktemp("uniform") / "two.json"
    place = data.draw(st.sampled_from(list(places(uniform()))))
    path.write_text(json.dumps(replaced(uniform(), place, junk)))
    assert answers_in_a_sentence(read_uniform_json, path)


@pytest.fixture(scope="module")
def scene_document(tmp_path_factory) -> dict:
    rig = Rig([K, K], [LOOKING_EAST, LOOKING_WEST], [T, T], (1920, 1080), [[0.1] * 5] * 2)
    scene = Scene(rig, Plane([0, 0, 1], 0), 3.0, metric=True)
    return json.loads(
        write_scene_json(tmp_path_factory.mktemp("scene") / "scene.json", scene).read_text()
    )


@settings(max_examples=100)
@given(data=st.data(), junk=JUNK)
@pytest.mark.parametrize("read", [read_rig_json, read_scene_json])
def test_rig_and_scene_json(read, data, junk, scene_document, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.json"
    place = data.draw(st.sampled_from(list(places(scene_document))))
    path.write_text(json.dumps(replaced(scene_document, place, junk)))
    assert answers_in_a_sentence(read, path)


@settings(max_examples=100)
@given(data=st.data(), junk=JUNK)
def test_scenario(data, junk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenario")
    rig = {"K": [K, K], "R": [LOOKING_EAST, LOOKING_WEST], "t": [T, T], "image_size": [1920, 1080]}
    rig |= {"ground_normal": [0, 0, 1], "ground_offset": 0, "extent": 3, "fps": 2, "frames": 1}
    documents = {
        "rig.json": rig,
        "eval.json": {"true_centres": [[0, 0, 1], [1, 0, 1]], "area": [0, 1, 2, 3]},
    }
    name = data.draw(st.sampled_from(list(documents)))
    place = data.draw(st.sampled_from(list(places(documents[name]))))
    documents[name] = replaced(documents[name], place, junk)
    for file, document in documents.items():
        (folder / file).write_text(json.dumps(document))
    one = {"frame": [0], "cam": [0], "box": [[0.0, 0, 1, 1]], "score": [1.0], "ankle": [1]}
    np.savez(folder / "detections.npz", **{k: np.array(v) for k, v in one.items()}, emb=np.eye(1))
    np.savez(folder / "gt.npz", frame=np.array([0]), id=np.array([0]), xy=np.zeros((1, 2)))

    def read(_):
        return read_scenario(folder)

    assert answers_in_a_sentence(read, folder / name)
