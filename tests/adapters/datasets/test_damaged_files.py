"""Damaged files whose format is detected raise an error of the library, whatever the damage."""

import contextlib
import json
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.adapters import (
    read_ai_city_tracks,
    read_coco,
    read_ground_truth,
    write_ai_city,
    write_anipose_toml,
    write_mv3dt,
)
from catfree.errors import CatFreeError
from catfree.synthetic import make_layout

pytestmark = pytest.mark.slow

NAMES = ("a", "b", "c", "d")
BOX = {"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.5}
IMAGE = {"id": 1, "file_name": "C1/0005.png", "width": 9, "height": 9}
FRAME = {"frame": 1, "views": {"a": [{"box": [1, 2, 3, 4]}]}, "gt": [{"id": 1, "x": 1, "y": 2}]}
TEXTS = {
    "results.json": json.dumps([BOX, BOX]),
    "set.json": json.dumps({"images": [IMAGE], "annotations": [BOX], "categories": []}),
    "uniform.json": json.dumps({"units": "m", "cameras": [{"name": "a"}], "frames": [FRAME]}),
    "boxes.csv": "frame,camera,x1,y1,x2,y2,score\n1,0,1,2,3,4,.5\n2,1,1,2,3,4,.5\n",
    "track1.txt": "1 0 5 0 1 2 .8 .6 .6 1.6 0\n1 0 5 1 9 9 .8 1 1 1 0\n",
}
READERS = {
    "results.json": (read_coco, cf.read_detections),
    "set.json": (read_coco, cf.read_detections),
    "uniform.json": (cf.read_detections, cf.read_scene, read_ground_truth),
    "boxes.csv": (cf.read_detections, read_ground_truth),
    "track1.txt": (read_ai_city_tracks,),
    "calibration.json": (cf.read_scene,),
    "calibration.toml": (cf.read_scene,),
    "cam.yml": (cf.read_scene,),
}
PIECES = ["", "x", "9", "-", "\n", ",", "[", "]", "{", "nan", '"', "\0", "1e999", "null", "true"]


@pytest.fixture(scope="module")
def texts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    rig = replace(make_layout("ring4", 0).rig, distortion=None)
    calibrations = {
        "calibration.json": write_ai_city(folder / "calibration.json", rig, NAMES),
        "calibration.toml": write_anipose_toml(folder / "calibration.toml", rig, NAMES),
        "cam.yml": write_mv3dt(folder / "camInfo", rig, NAMES)[0],
    }
    return TEXTS | {name: path.read_text() for name, path in calibrations.items()}


@pytest.mark.parametrize("name", sorted(READERS))
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.sampled_from(PIECES)), max_size=4))
def test_damage_raises_no_other_error(name, changes, texts, tmp_path_factory):
    letters = list(texts[name])
    for place, piece in changes:
        letters[int(place * (len(letters) - 1))] = piece
    path = tmp_path_factory.getbasetemp() / name
    path.write_text("".join(letters))
    for read in READERS[name]:
        with contextlib.suppress(CatFreeError):
            read(path)
