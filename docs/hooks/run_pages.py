"""Run the Python of every page of the documentation, and compare or store what it prints.

    python docs/hooks/run_pages.py            # stores the outputs of all pages
    python docs/hooks/run_pages.py --check    # fails if a page states another output

A block of Python is followed by a block `text` if it prints something. `<!-- not run: REASON -->`
in the line above leaves a block out, `<!-- run first -->` runs it before the others, and
`<!-- prepare ... -->` holds code that readers need not see.
"""

import contextlib
import io
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

PAGES = Path(__file__).parents[1]
_BLOCK = re.compile(
    r"(?:^<!-- prepare\n(?P<hidden>.*?)^-->\n)"
    r"|(?P<above>^<!-- (?:not run: [^\n]+|run first) -->\n)?"
    r"^```python\n(?P<code>.*?)^```\n(?:\n```text\n(?P<printed>.*?)^```\n)?",
    re.DOTALL | re.MULTILINE,
)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
TOLERANCE = 0.1  # results of two processors differ in digits that no page is about


class Step(NamedTuple):
    """One block of a page that was run.

    Attributes:
        match: where the block is.
        printed: what it printed.
    """

    match: re.Match[str]
    printed: str


def pages() -> list[Path]:
    """List the pages that have Python."""
    return [path for path in sorted(PAGES.rglob("*.md")) if _BLOCK.search(path.read_text("utf-8"))]


def run(path: Path) -> list[Step]:
    """Run all blocks of a page in one namespace, in an empty folder; list them as they stand."""
    steps: list[Step] = []
    namespace: dict[str, object] = {"__name__": "__main__"}
    found = list(_BLOCK.finditer(path.read_text("utf-8")))
    found.sort(key=lambda match: "run first" not in (match["above"] or ""))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for match in found:
            if "not run" in (match["above"] or ""):
                continue
            with contextlib.redirect_stdout(io.StringIO()) as stream:
                code = match["hidden"] or match["code"]
                exec(compile(code, f"{path.name}", "exec"), namespace)
            steps.append(Step(match, stream.getvalue()))
    return sorted(steps, key=lambda step: step.match.start())


def agree(stated: str, printed: str) -> bool:
    """Return whether two outputs have the same words, and numbers that differ by rounding."""
    if _NUMBER.sub("#", stated).split() != _NUMBER.sub("#", printed).split():
        return False
    pairs = zip(_NUMBER.findall(stated), _NUMBER.findall(printed), strict=True)
    return all(
        abs(float(a) - float(b)) <= TOLERANCE * max(1.0, abs(float(a)), abs(float(b)))
        for a, b in pairs
    )


def check(path: Path) -> list[str]:
    """Return one sentence per block of a page that prints something else than is stated."""
    return [
        f"{path.name} states {match['printed'] or ''!r}, but its code prints {printed!r}."
        for match, printed in run(path)
        if not agree(match["printed"] or "", printed)
    ]


def store(path: Path) -> None:
    """Write what the blocks of a page print below them."""
    text = path.read_text("utf-8")
    for match, printed in reversed(run(path)):
        if match["code"] and not agree(match["printed"] or "", printed):
            block = f"{match['above'] or ''}```python\n{match['code']}```\n"
            block += f"\n```text\n{printed.rstrip()}\n```\n" if printed.strip() else ""
            text = text[: match.start()] + block + text[match.end() :]
    path.write_text(text, "utf-8")


def main() -> int:
    """Check or store the outputs of all pages, and return the exit code."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    if sys.argv[1:] != ["--check"]:
        for path in pages():
            store(path)
        return 0
    wrong = [sentence for path in pages() for sentence in check(path)]
    print("\n".join(wrong))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
