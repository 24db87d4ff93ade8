"""Write the pages of constants: of the evidence method, and of rigs from people.

    python docs/hooks/constants_page.py

The reasons come from the settings. `benchmarks/evidence_ablation.py --constants` measures the
effects of the evidence method's constants, and writes them to `docs/evidence_effects.json`.
"""

import dataclasses
import importlib
import json
import pkgutil
import re
from pathlib import Path
from types import ModuleType

from catfree.calibration import _confident_people, _evidence_loop, people
from catfree.methods import evidence
from catfree.settings import CalibrationSettings, EvidenceSettings

DOCS = Path(__file__).parents[1]
EFFECTS = DOCS / "evidence_effects.json"

EVIDENCE_HEAD = """\
# Every constant of the evidence method

All data use the same values; none was chosen for a scene. *Physical*: a size, speed or share of
people, bodies, boxes or lenses. *Start*: an initial value that an estimate from the sequence
replaces. *Decision*: how much evidence is required. *Numerical*: affects only run time and the
last digits, not who is found. Lengths are in H0, the median person height of the sequence, so
nothing depends on the scale of the scene; log-odds use the natural logarithm.

All are fields of `cf.settings.EvidenceSettings`. The modules have further constants, which are
[listed below](#constants-of-the-modules): sizes of blocks, limits of iterations and searches,
guards, and thresholds of warnings.

The last two columns show the change of MODA, in points, if a constant is halved or doubled (shares
stay below one), averaged over
{sets}.
Changes below {chance} points are chance: changing any constant by 2 % has as much effect.

`python benchmarks/evidence_ablation.py --constants DATA ...` measures the changes anew, and
`python docs/hooks/constants_page.py` writes this page.

| constant | value | kind | reason | halved | doubled |
|---|---|---|---|---|---|
"""

CALIBRATION_HEAD = """\
# Every constant of rigs from people

All data use the same values; none was chosen for a scene. *Physical*: a size or height of people,
a property of boxes, cameras or lenses. *Start*: the initial value of an estimate.
*Decision*: how much evidence is required. *Numerical*: how thorough the search is, at the cost of
run time. Lengths are in meters, angles in radians, pixels those of the original images.

All are fields of `cf.settings.CalibrationSettings`. The modules have further constants, which are
[listed below](#constants-of-the-modules): sizes of blocks, limits of iterations and searches, and
guards. `python docs/hooks/constants_page.py` writes this page.

| constant | value | kind | reason |
|---|---|---|---|
"""

MODULES = """
## Constants of the modules

They are in {folders}, and no user has a reason to change them.

| constant | value | what it is |
|---|---|---|
"""
COMMENTED = re.compile(r"^([A-Z][A-Z_0-9]*) = .*?  # (.+)$", re.MULTILINE)


def shown(value: object) -> str:
    """Format a constant for the table."""
    parts = value if isinstance(value, tuple) else (value,)
    return ", ".join(str(part) if isinstance(part, int) else f"{part:g}" for part in parts)


def evidence_page() -> str:
    """Return the page of the evidence method."""
    measured = json.loads(EFFECTS.read_text("utf-8"))
    head = EVIDENCE_HEAD.format(sets=measured["sets"], chance=measured["chance"])
    rows = []
    for field, row in of_settings(EvidenceSettings):
        halved, doubled = (f"{round(c, 1) + 0:+.1f}" for c in measured["moda"][field])
        rows.append(f"{row} {halved} | {doubled} |")
    return whole(head, rows, "`catfree/methods/evidence/`", [evidence])


def calibration_page() -> str:
    """Return the page of rigs from people."""
    rows = [row for _, row in of_settings(CalibrationSettings)]
    folders = (
        "`catfree/calibration/people/`, and in `_evidence_loop.py` and\n`_confident_people.py` "
        "beside it"
    )
    return whole(CALIBRATION_HEAD, rows, folders, [people, _evidence_loop, _confident_people])


def of_settings(settings: type) -> list[tuple[str, str]]:
    """Return the name and the row of each constant of some settings."""
    return [
        (
            field.name,
            f"| `{field.name}` | {shown(field.default)} | {field.metadata['kind']} | "
            f"{field.metadata['reason']} |",
        )
        for field in dataclasses.fields(settings)
        if field.metadata
    ]


def whole(head: str, rows: list[str], folders: str, code: list[ModuleType]) -> str:
    """Join the parts of a page."""
    modules = MODULES.format(folders=folders)
    return head + "\n".join(rows) + "\n" + modules + "\n".join(of_modules(code)) + "\n"


def of_modules(code: list[ModuleType]) -> list[str]:
    """Make a row for each constant of modules and packages from the comment beside it."""
    rows = []
    for module in code:
        inside = pkgutil.walk_packages(getattr(module, "__path__", []), f"{module.__name__}.")
        for part in [module, *(importlib.import_module(one.name) for one in inside)]:
            short = part.__name__.rpartition(".")[2].removeprefix("_")
            for name, what in COMMENTED.findall(Path(str(part.__file__)).read_text("utf-8")):
                rows.append(f"| `{short}.{name}` | {shown(getattr(part, name))} | {what} |")
    return sorted(rows)


PAGES = {
    DOCS / "evidence_constants.md": evidence_page,
    DOCS / "calibration_constants.md": calibration_page,
}

if __name__ == "__main__":
    for path, page in PAGES.items():
        path.write_text(page(), "utf-8")
