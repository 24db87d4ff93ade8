"""Write `docs/evidence_constants.md`: the constants of the evidence method and what they change.

    python docs/hooks/constants_page.py

The reasons are those of `catfree.settings.EvidenceSettings`; the effects are measured by
`benchmarks/evidence_ablation.py --constants`, which writes `docs/evidence_effects.json`.
"""

import dataclasses
import importlib
import json
import pkgutil
import re
from pathlib import Path

from catfree.methods import evidence
from catfree.settings import EvidenceSettings

DOCS = Path(__file__).parents[1]
EFFECTS = DOCS / "evidence_effects.json"
PAGE = DOCS / "evidence_constants.md"

HEAD = """\
# Every constant of the evidence method

All data use the same values; none was chosen for a scene. *Physical*: a size, speed or share of
people, bodies, boxes or lenses. *Start*: an initial value that is replaced by an estimate from
the sequence. *Decision*: how much evidence is required. *Numerical*: affects run time and the
last digits, not who is found. Lengths are in H0, the median person height of the sequence, so
nothing depends on the scale of the scene; log-odds use the natural logarithm.

All are fields of `cf.settings.EvidenceSettings`. The modules have further constants, which are
[listed below](#constants-of-the-modules): sizes of blocks, limits of iterations and searches,
guards, and thresholds of warnings.

The last two columns show what a constant changes: the change of MODA, in points, if it is halved
and if it is doubled (shares stay below one). It is the mean over
{sets}.
Less than {chance} points is chance: changing any constant by 2 % does as much.

`python benchmarks/evidence_ablation.py --constants DATA ...` measures the changes anew, and
`python docs/hooks/constants_page.py` writes this page.

| constant | value | kind | reason | halved | doubled |
|---|---|---|---|---|---|
"""

MODULES = """
## Constants of the modules

They are in `catfree/methods/evidence/`, and no user has a reason to change them.

| constant | value | what it is |
|---|---|---|
"""
COMMENTED = re.compile(r"^([A-Z][A-Z_]*) = .*?  # (.+)$", re.MULTILINE)


def shown(value: object) -> str:
    """A constant as the table shows it."""
    parts = value if isinstance(value, tuple) else (value,)
    return ", ".join(str(part) if isinstance(part, int) else f"{part:g}" for part in parts)


def page() -> str:
    """The whole page."""
    effects = json.loads(EFFECTS.read_text("utf-8"))
    rows = []
    for field in dataclasses.fields(EvidenceSettings):
        if field.metadata:
            halved, doubled = (f"{round(c, 1) + 0:+.1f}" for c in effects["moda"][field.name])
            kind, reason = field.metadata["kind"], field.metadata["reason"]
            name, value = f"`{field.name}`", shown(field.default)
            rows.append(f"| {name} | {value} | {kind} | {reason} | {halved} | {doubled} |")
    head = HEAD.format(sets=effects["sets"], chance=effects["chance"])
    return head + "\n".join(rows) + "\n" + MODULES + "\n".join(of_modules()) + "\n"


def of_modules() -> list[str]:
    """A row for each constant of the modules, from the comment beside it."""
    rows = []
    for module in pkgutil.walk_packages(evidence.__path__, f"{evidence.__name__}."):
        code = importlib.import_module(module.name)
        short = module.name.rpartition(".")[2].removeprefix("_")
        for name, what in COMMENTED.findall(Path(str(code.__file__)).read_text("utf-8")):
            rows.append(f"| `{short}.{name}` | {shown(getattr(code, name))} | {what} |")
    return sorted(rows)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
