"""The page of constants is what the settings and the modules say, of every constant."""

import dataclasses
import importlib.util
import json
import re
from pathlib import Path

from catfree.methods import evidence
from catfree.settings import EvidenceSettings

HOOK = Path(__file__).parents[3] / "docs" / "hooks" / "constants_page.py"
KINDS = {"physical", "start", "decision", "numerical"}
MOST = 50


def hook():
    spec = importlib.util.spec_from_file_location("constants_page", HOOK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def constants() -> list[dataclasses.Field]:
    """Fields that are no switches."""
    fields = dataclasses.fields(EvidenceSettings)
    return [field for field in fields if not isinstance(field.default, bool)]


def test_there_are_at_most_fifty_each_with_its_kind_and_a_reason():
    assert len(constants()) <= MOST
    for field in constants():
        assert field.metadata["kind"] in KINDS
        assert len(field.metadata["reason"].split()) > 2, field.name


def test_every_constant_is_described_in_the_docstring():
    text = EvidenceSettings.__doc__ or ""
    for field in dataclasses.fields(EvidenceSettings):
        assert f"        {field.name}: " in text, field.name


def test_the_page_is_made_of_the_settings_and_of_measured_effects():
    module = hook()
    assert module.PAGE.read_text("utf-8") == module.page()
    measured = json.loads(module.EFFECTS.read_text("utf-8"))["moda"]
    assert measured.keys() == {field.name for field in constants()}
    # A working area of a quarter of the size is felt; so the effects are real ones.
    assert min(measured["working_sigma"]) < -1


def test_the_page_has_every_constant_of_the_modules_with_what_it_is():
    listed = re.findall(r"^\| `\w+\.(\w+)` \| .+ \| (.+) \|$", hook().page(), re.MULTILINE)
    code = [path.read_text("utf-8") for path in Path(evidence.__path__[0]).rglob("*.py")]
    capitals = [name for text in code for name in re.findall(r"^([A-Z][A-Z_]*) = ", text, re.M)]
    assert sorted(name for name, _ in listed) == sorted(capitals)
    assert all(len(what.split()) > 1 for _, what in listed)
