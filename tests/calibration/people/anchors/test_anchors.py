"""Anchors: invalid ones are refused in one sentence, and files can store all of them."""

import inspect
import json
import math

import numpy as np
import pytest

import catfree as cf
from catfree.errors import CalibrationError, FileFormatError, InvalidInputError

ENDS = ((640.0, 500.0), (810.0, 505.0))


@pytest.mark.parametrize(
    ("kind", "values", "sentence"),
    [
        (cf.KnownDistance, {"pixels": ENDS, "meters": -1.0}, "positive"),
        (cf.KnownDistance, {"pixels": ENDS, "meters": 5.0, "sd": 0.0}, "positive"),
        (cf.KnownDistance, {"pixels": (ENDS[0], ENDS[0]), "meters": 5.0}, "same point"),
        (cf.KnownDistance, {"pixels": ((np.nan, 1.0), ENDS[0]), "meters": 5.0}, "finite"),
        (cf.KnownCamera, {}, "states nothing"),
        (cf.KnownCamera, {"height": 0.0}, "positive"),
        (cf.KnownCamera, {"height": math.inf}, "positive"),
        (cf.KnownCamera, {"longitude": 8.0}, "longitude and latitude, or neither"),
        (cf.KnownCamera, {"position": (1.0, 2.0, np.nan)}, "finite"),
        (cf.KnownCamera, {"position": (1.0, 2.0, 3.0, 4.0)}, r"shape \(2,\) or \(3,\)"),
        (cf.KnownCamera, {"rotation": ((1.0, 0.0, 0.0),) * 3}, "rotation matrix"),
        (cf.SurveyedPoint, {"pixel": ENDS[0]}, "needs a position"),
        (
            cf.SurveyedPoint,
            {"pixel": ENDS[0], "position": (1.0, 2.0), "longitude": 8.0, "latitude": 47.0},
            "not both",
        ),
        (cf.SurveyedPoint, {"pixel": ENDS[0], "longitude": 8.0, "latitude": 147.0}, "degrees"),
    ],
)
def test_anchors_that_state_nothing_possible_are_refused(kind, values, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        kind("north", **values)


@pytest.mark.parametrize("kind", [list, np.array])
@pytest.mark.parametrize(
    "anchor",
    [
        cf.KnownDistance("north", ENDS, 5.0),
        cf.KnownCamera("north", height=4.0, position=(1.0, 2.0, 4.0)),
        cf.KnownCamera("north", rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        cf.SurveyedPoint("north", ENDS[0], position=(1.0, 2.0)),
        cf.SurveyedPoint("north", ENDS[0], longitude=8.5, latitude=47.25),
    ],
)
def test_anchors_of_lists_and_arrays_equal_those_of_tuples(anchor, kind):
    def converted(value):
        if isinstance(value, tuple):
            return kind([list(row) if isinstance(row, tuple) else row for row in value])
        return np.float32(value) if value in (5.0, 4.0, 8.5, 47.25) else value

    again = object.__new__(type(anchor))
    inspect.unwrap(type(anchor).__init__)(
        again, **{k: converted(v) for k, v in vars(anchor).items()}
    )
    assert again == anchor
    assert hash(again) == hash(anchor)


def test_a_file_holds_anchors_of_all_kinds(tmp_path):
    path = tmp_path / "anchors.json"
    document = {
        "distances": [{"camera": "north", "pixels": [[640, 500], [810, 505]], "meters": 5}],
        "cameras": [{"camera": 1, "height": 4.1, "position": [1, 2, 4.1]}],
        "points": [{"camera": 0, "pixel": [512, 700], "longitude": 8.547, "latitude": 47.376}],
    }
    path.write_text(json.dumps(document))
    assert cf.read_anchors(path) == (
        cf.KnownDistance("north", ENDS, 5.0),
        cf.KnownCamera(1, height=4.1, position=(1.0, 2.0, 4.1)),
        cf.SurveyedPoint(0, (512.0, 700.0), longitude=8.547, latitude=47.376),
    )


@pytest.mark.parametrize(
    ("document", "error", "sentence"),
    [
        ([], FileFormatError, "lists distances, cameras and points"),
        ({"lines": []}, FileFormatError, "has 'lines'; it may have distances, cameras, points"),
        ({"cameras": [5]}, FileFormatError, "entry 0 of cameras must be an object"),
        ({"cameras": {"camera": 0}}, FileFormatError, "cameras must be a list"),
        ({"cameras": [{"camera": 0, "size": 1}]}, FileFormatError, "'size'"),
        ({"cameras": [{"camera": 0, "height": "tall"}]}, InvalidInputError, "entry 0 of cameras"),
        ({"distances": [{"camera": 0}]}, FileFormatError, "entry 0 of distances has no 'pixels'"),
        ({"cameras": [{"height": 3}]}, FileFormatError, "entry 0 of cameras has no 'camera'"),
        (
            {"points": [{"camera": 0, "pixel": [5, 7], "longitude": 8.5, "latitude": "x"}]},
            InvalidInputError,
            r"anchors\.json: entry 0 of points",
        ),
        ({"cameras": [{"camera": [0], "height": 3}]}, InvalidInputError, "entry 0 of cameras"),
        ({"cameras": [{"camera": 0, "height": 10**400}]}, InvalidInputError, "entry 0 of cameras"),
        (
            {"cameras": [{"camera": 0, "rotation": [[1e308, 0, 0], [0, 1, 0], [0, 0, 1]]}]},
            InvalidInputError,
            "must be a rotation matrix",
        ),
        ({"cameras": [{"camera": 0, "position": [[1], 2]}]}, InvalidInputError, "entry 0 of cam"),
    ],
)
def test_files_of_another_form_are_refused(tmp_path, document, error, sentence):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps(document))
    with pytest.raises(error, match=sentence):
        cf.read_anchors(path)


@pytest.mark.parametrize("camera", [math.nan, math.inf, 1.0, True, None, [0]])
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("distances", {"pixels": ENDS, "meters": 5}),
        ("cameras", {"height": 3}),
        ("points", {"pixel": ENDS[0], "position": [1, 2]}),
    ],
)
def test_a_camera_is_an_index_or_a_name(tmp_path, camera, kind, values):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps({kind: [{"camera": camera} | values]}))
    with pytest.raises(InvalidInputError, match=r"0 of .* it must be the index or the name"):
        cf.read_anchors(path)


def test_one_image_size_serves_anchors_of_all_cameras():
    boxes = cf.Detections([0, 0, 0], [0, 1, 2], [[10, 10, 40, 90]] * 3)
    height = cf.KnownCamera(camera=2, height=3.0)
    with pytest.raises(CalibrationError, match="needs 2 cameras"):  # too few boxes, right anchor
        cf.calibrate(boxes, (640, 480), anchors=[height])
    with pytest.raises(InvalidInputError, match="camera 3, but the cameras are 0 to 2"):
        cf.calibrate(boxes, (640, 480), anchors=[cf.KnownCamera(camera=3, height=3.0)])


@pytest.mark.parametrize(
    "anchor",
    [
        cf.KnownDistance(1, ((10.0, 400.0), (700.0, 400.0)), 5.0),
        cf.SurveyedPoint(1, (10.0, 480.5), position=(1.0, 2.0)),
    ],
)
def test_pixels_of_anchors_are_in_the_image(anchor):
    boxes = cf.Detections([0, 0, 0], [0, 1, 2], [[10, 10, 40, 90]] * 3)
    with pytest.raises(InvalidInputError, match=r"outside the image of camera 1, .* 640 x 480"):
        cf.calibrate(boxes, (640, 480), anchors=[anchor])
