"""A receipt is read as written, and one with impossible numbers is refused."""

import dataclasses
import json
import math

import pytest
from hypothesis import given, strategies as st

from catfree._run.sharded._from_json import from_json
from catfree._run.sharded._receipt import SCHEMA, Receipt, read_receipt, write_receipt
from catfree.errors import FileFormatError
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Clock

finite = st.none() | st.floats(0, 1e6)


def receipt(**changes):
    values = {
        "schema": SCHEMA,
        "index": 0,
        "count": 1,
        "first": 0,
        "stop": 8,
        "first_seen": 0,
        "stop_seen": 8,
        "shard": "a",
        "source": "b",
        "run": "c",
        "settings": json.loads(json.dumps(dataclasses.asdict(Settings()))),
        "clock": dataclasses.asdict(Clock(5.0)),
        "scene_file": "d",
        "part": "e",
        "fragments": "f",
        "boxes": 48,
        "cameras": (0, 2),
        "boxes_used": 0.9,
        "expected_moda": 80.0,
        "median_sigma": 0.1,
        "person_height": 1.7,
        "seconds": 2.5,
        "warnings": ("One.", "Two."),
        "verdicts": ("healthy",),
    }
    return Receipt(**(values | changes))


@given(used=finite, moda=finite, sigma=finite, height=finite, seconds=st.floats(0, 1e6))
def test_a_receipt_is_read_as_it_was_written(tmp_path_factory, used, moda, sigma, height, seconds):
    written = receipt(
        boxes_used=used,
        expected_moda=moda,
        median_sigma=sigma,
        person_height=height,
        seconds=seconds,
    )
    path = tmp_path_factory.mktemp("receipt") / "a.json"
    write_receipt(path, written)
    assert read_receipt(path) == written


def test_a_setting_may_be_infinite_but_not_nan(tmp_path):
    path = tmp_path / "a.json"
    unlimited = CalibrationSettings(person_height_sd=math.inf)
    settings = json.loads(json.dumps(dataclasses.asdict(Settings(calibration=unlimited))))
    write_receipt(path, receipt(settings=settings))
    assert read_receipt(path).settings["calibration"]["person_height_sd"] == math.inf
    path.write_text(path.read_text().replace("Infinity", "NaN"))
    with pytest.raises(FileFormatError, match=r"a\.json is damaged.*Run this shard again"):
        read_receipt(path)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "name", ["boxes_used", "expected_moda", "median_sigma", "person_height", "seconds"]
)
def test_a_number_that_is_not_finite_is_damage(name, value, tmp_path):
    write_receipt(tmp_path / "a.json", receipt(**{name: value}))
    with pytest.raises(FileFormatError, match=rf"a\.json is damaged.*{name}"):
        read_receipt(tmp_path / "a.json")


@pytest.mark.parametrize("value", ["1e999", "NaN", '"x"', "null"])
def test_impossible_cameras_are_damage(value, tmp_path):
    path = tmp_path / "a.json"
    write_receipt(path, receipt(cameras=(123456, 2)))
    path.write_text(path.read_text().replace("123456", value))
    with pytest.raises(FileFormatError, match=r"a\.json is damaged.*Run this shard again"):
        read_receipt(path)


def test_an_entry_that_is_missing_is_damage(tmp_path):
    path = tmp_path / "a.json"
    write_receipt(path, receipt())
    path.write_text(path.read_text().replace('"boxes_used"', '"used"'))
    with pytest.raises(FileFormatError, match=r"a\.json is damaged .it lacks 'boxes_used'.\. Run"):
        read_receipt(path)


@pytest.mark.parametrize("settings", [Settings(), Settings.paper()])
def test_settings_come_back_from_json(settings):
    document = json.loads(json.dumps(dataclasses.asdict(settings)))
    assert from_json(Settings, document, "settings") == settings


@pytest.mark.parametrize(
    ("hint", "value"),
    [
        (int, True), (int, 1.0), (float, "1"), (str, 1), (tuple[int, int], [1]),
        (tuple[int, ...], [1, "2"]), (str | None, 3), (Clock, {"frame_rate": 0}), (Clock, []),
    ],
)  # fmt: skip
def test_values_of_another_type_are_refused(hint, value):
    with pytest.raises((ValueError, KeyError)):
        from_json(hint, value, "it")
