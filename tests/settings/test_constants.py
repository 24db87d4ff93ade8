"""The pages of constants agree with settings and modules, for every constant."""

import dataclasses
import importlib.util
import json
import re
from pathlib import Path

import pytest

from catfree.calibration import _confident_people, _evidence_loop, people
from catfree.methods import evidence
from catfree.settings import CalibrationSettings, EvidenceSettings

HOOK = Path(__file__).parents[2] / "docs" / "hooks" / "constants_page.py"
KINDS = {"physical", "start", "decision", "numerical"}
MOST = 50
SETTINGS = [EvidenceSettings, CalibrationSettings]
CODE = {
    "evidence_constants.md": [evidence],
    "calibration_constants.md": [people, _evidence_loop, _confident_people],
}


@pytest.fixture(scope="module")
def hook():
    spec = importlib.util.spec_from_file_location("constants_page", HOOK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def constants(settings: type) -> list[dataclasses.Field]:
    """Return fields that are not switches."""
    fields = dataclasses.fields(settings)
    return [field for field in fields if not isinstance(field.default, bool)]


@pytest.mark.parametrize("settings", SETTINGS)
def test_there_are_at_most_fifty_each_with_its_kind_and_a_reason(settings):
    assert len(constants(settings)) <= MOST
    for field in constants(settings):
        assert field.metadata["kind"] in KINDS
        assert len(field.metadata["reason"].split()) > 2, field.name


@pytest.mark.parametrize("settings", SETTINGS)
def test_every_constant_is_described_in_the_docstring(settings):
    text = settings.__doc__ or ""
    for field in dataclasses.fields(settings):
        assert f"        {field.name}: " in text, field.name


def test_the_pages_are_made_of_the_settings_and_of_measured_effects(hook):
    assert {path.name for path in hook.PAGES} == CODE.keys()
    for path, page in hook.PAGES.items():
        assert path.read_text("utf-8") == page()
    measured = json.loads(hook.EFFECTS.read_text("utf-8"))["moda"]
    assert measured.keys() == {field.name for field in constants(EvidenceSettings)}
    # A working area of a quarter of the size matters, so the effects are real.
    assert min(measured["working_sigma"]) < -1


@pytest.mark.parametrize("name", CODE)
def test_a_page_has_every_number_of_the_modules_with_what_it_is(hook, name):
    page = next(path for path in hook.PAGES if path.name == name).read_text("utf-8")
    listed = re.findall(r"^\| `\w+\.(\w+)` \| .+ \| (.+) \|$", page, re.MULTILINE)
    files = []
    for code in CODE[name]:
        path = Path(code.__file__)
        files += path.parent.rglob("*.py") if path.name == "__init__.py" else [path]
    text = "\n".join(path.read_text("utf-8") for path in files)
    numbers = re.findall(r"^([A-Z][A-Z_0-9]*) = (?:\(?-?[\d.]|[A-Z_]+ [*/])", text, re.MULTILINE)
    assert sorted(name for name, _ in listed) == sorted(numbers)
    assert all(len(what.split()) > 1 for _, what in listed)
