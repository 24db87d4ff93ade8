"""The table of constants says what the code does, of every constant."""

import dataclasses
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

from catfree.methods import evidence
from catfree.settings import EvidenceSettings

TABLE = Path(__file__).parents[3] / "docs" / "evidence_constants.md"
ROW = re.compile(r"^\| `([\w.]+)` \| (.+?) \| (\w+) \| (.+) \|$", re.MULTILINE)
KINDS = {"physical", "start", "decision", "numerical"}


def constants() -> dict[str, object]:
    """Fields of the settings that are no switches, and the capitals of the modules."""
    fields = dataclasses.asdict(EvidenceSettings())
    found = {name: value for name, value in fields.items() if not isinstance(value, bool)}
    for module in pkgutil.walk_packages(evidence.__path__, "catfree.methods.evidence."):
        code = importlib.import_module(module.name)
        assert code.__file__ is not None
        short = module.name.rpartition(".")[2].removeprefix("_")
        names = re.findall(r"^([A-Z][A-Z_]*) = ", Path(code.__file__).read_text("utf-8"), re.M)
        found |= {f"{short}.{name}": getattr(code, name) for name in names}
    return found


def numbers(value: object) -> list[float]:
    """All numbers in a value, however they are nested."""
    if isinstance(value, tuple):
        return [number for part in value for number in numbers(part)]
    assert isinstance(value, int | float)
    return [float(value)]


def test_every_constant_is_in_the_table_with_its_value_and_a_reason():
    rows = {name: rest for name, *rest in ROW.findall(TABLE.read_text("utf-8"))}
    known = constants()
    assert rows.keys() == known.keys()
    for name, (shown, kind, reason) in rows.items():
        assert [float(n) for n in shown.split(", ")] == pytest.approx(
            numbers(known[name]), rel=1e-3
        )
        assert kind in KINDS
        assert len(reason.split()) > 1 or kind == "numerical", name
