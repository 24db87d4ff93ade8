"""Check that no figure in the README got worse: `python -m benchmarks.gate [DATA]`.

Measures every figure of `benchmarks.figures`, compares it with `benchmarks/baseline.json` and exits
with 1 if one got worse, was not measured although its data exist, or has no baseline. DATA is the
folder that holds `real/` and `scenarios/`; without it, `data` in the folder named by
`CATFREE_SHARED`, or in `shared/` beside the checkout. Figures without data are listed and skipped.

The baseline gives the value and unit of each figure, which direction is better ("higher", "lower",
or "either" if any change counts), and the tolerance. On one machine, figures do not vary; on
another processor, the last digits of a float32 sum do, which occasionally changes one position in
thousands. Tolerances are therefore the rounding of the published figures: 0.15 points of MODA, 0.5
of IDF1 and HOTA, where one identity switch affects a whole track, and 0.01 m. Short sequences have
larger tolerances because one person in one frame weighs more there.

This program never writes the baseline. Change it by hand, in a separate commit that says why.
"""

import argparse
import fnmatch
import json
import math
import os
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from benchmarks.figures import SUITES, Suite

BASELINE = Path(__file__).with_name("baseline.json")
ROOT = Path(__file__).parents[1]

Direction = Literal["higher", "lower", "either"]
Verdict = Literal["same", "better", "worse", "not measured", "no baseline", "absent"]
FAILURES: tuple[Verdict, ...] = ("worse", "not measured", "no baseline")


@dataclass(frozen=True)
class Metric:
    """One figure of the baseline.

    Attributes:
        key: name of its suite, a slash, and the name of the figure.
        value: value when the baseline was last changed.
        unit: unit of value and tolerance.
        direction: which way is better; "either" if any change counts.
        tolerance: only larger changes count.
    """

    key: str
    value: float
    unit: str
    direction: Direction
    tolerance: float

    def __post_init__(self) -> None:
        """Raise for an entry that cannot be compared.

        Raises:
            ValueError: if the value is not finite, or the direction or tolerance is invalid.
        """
        if not math.isfinite(self.value):
            raise ValueError(f"{self.key}: the value is {self.value}; it must be finite.")
        if self.direction not in get_args(Direction):
            raise ValueError(
                f"{self.key}: the direction is {self.direction!r}; it must be one of "
                f"{', '.join(get_args(Direction))}."
            )
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0):
            raise ValueError(
                f"{self.key}: the tolerance is {self.tolerance}; it must be finite and not "
                "negative."
            )

    def judge(self, measured: float) -> Verdict:
        """Compare a measured value; NaN is worse than any number."""
        change = measured - self.value
        if not math.isfinite(change):
            return "worse"
        # The published decimals are not exact in binary.
        if abs(change) <= self.tolerance + 1e-9:
            return "same"
        better = {"higher": change > 0, "lower": change < 0, "either": False}
        return "better" if better[self.direction] else "worse"


@dataclass(frozen=True)
class Line:
    """One row of the result.

    Attributes:
        key: key of the figure.
        verdict: result of the comparison.
        measured: value of this run, or None.
        metric: entry of the baseline, or None.
        reason: why there is nothing to compare, or "".
    """

    key: str
    verdict: Verdict
    measured: float | None = None
    metric: Metric | None = None
    reason: str = ""

    def __str__(self) -> str:
        """Format the row as Markdown."""
        if self.metric is None or self.measured is None:
            value = "-" if self.measured is None else f"{self.measured:.4g}"
            return f"| {self.key} | - | {value} | - | {self.verdict}: {self.reason} |"
        change = f"{self.measured - self.metric.value:+.4f} {self.metric.unit}".rstrip()
        bound = f"{change} ({self.metric.direction}, {self.metric.tolerance:g})"
        return (
            f"| {self.key} | {self.metric.value:.4g} | {self.measured:.4g} | {bound} "
            f"| {self.verdict} |"
        )


@dataclass(frozen=True)
class Outcome:
    """Result of a suite.

    Attributes:
        figures: measured values by name; empty if it did not run.
        reason: why it did not run, or "".
        absent: whether it did not run for lack of data.
    """

    figures: Mapping[str, float]
    reason: str = ""
    absent: bool = False


def read_baseline(path: Path) -> dict[str, Metric]:
    """Read the baseline by key.

    Raises:
        ValueError: if an entry is malformed.
    """
    entries = json.loads(path.read_text(encoding="utf-8"))
    try:
        return {key: Metric(key, **entry) for key, entry in entries.items()}
    except TypeError as error:
        raise ValueError(
            f"{path} has an entry with other fields than value, unit, direction and tolerance "
            f"({error})."
        ) from error


def measure(suite: Suite, data: Path | None) -> Outcome:
    """Run a suite; an error becomes the reason."""
    missing = suite.missing(data)
    if missing:
        return Outcome({}, missing, absent=True)
    try:
        figures = suite.measure(data)
    except Exception as error:  # an error must not hide the other figures
        return Outcome({}, f"{type(error).__name__}: {error}")
    return Outcome({name: float(value) for name, value in figures.items()})


def compare(suite: str, outcome: Outcome, baseline: Mapping[str, Metric]) -> list[Line]:
    """Make one line per figure that the suite measured or that the baseline has for it.

    Args:
        suite: name of the suite.
        outcome: result of the suite.
        baseline: entries of all suites, by key.

    Returns:
        The lines, in the order of measurement; figures not measured come last.
    """
    lines = []
    measured = {f"{suite}/{name}": value for name, value in outcome.figures.items()}
    for key, value in measured.items():
        metric = baseline.get(key)
        if metric is None:
            lines.append(Line(key, "no baseline", value, reason="add it by hand"))
        else:
            lines.append(Line(key, metric.judge(value), value, metric))
    verdict: Verdict = "absent" if outcome.absent else "not measured"
    reason = outcome.reason or "the suite no longer measures it"
    left = [key for key in baseline if key.startswith(f"{suite}/") and key not in measured]
    lines += [Line(key, verdict, metric=baseline[key], reason=reason) for key in left]
    if outcome.reason and not left:
        lines.append(Line(suite, verdict, reason=reason))
    return lines


def orphans(baseline: Iterable[str], suites: Iterable[str]) -> list[Line]:
    """Make lines for figures that belong to no suite."""
    prefixes = tuple(f"{suite}/" for suite in suites)
    left = [key for key in baseline if not key.startswith(prefixes)]
    return [Line(key, "not measured", reason="no suite has this name") for key in left]


def choose(suites: Iterable[Suite], pattern: str | None, *, quick: bool) -> list[Suite]:
    """Choose the requested suites.

    Args:
        suites: all suites.
        pattern: part of a name, or a shell pattern for the whole name; None for any.
        quick: only those that take seconds.

    Raises:
        ValueError: if no suite matches.
    """
    chosen = [
        suite
        for suite in suites
        if pattern is None or pattern in suite.name or fnmatch.fnmatch(suite.name, pattern)
    ]
    if not chosen:
        raise ValueError(f"No suite's name contains or matches {pattern!r}; see --list.")
    if quick and not any(suite.quick for suite in chosen):
        names = ", ".join(suite.name for suite in chosen)
        raise ValueError(f"--quick leaves out all that {pattern!r} chooses ({names}).")
    return [suite for suite in chosen if suite.quick or not quick]


def find_data(given: Path | None) -> Path | None:
    """Find the data folder: the given one, or where tests look for it; None if there is none.

    Raises:
        ValueError: if the given folder holds no data.
    """
    if given is not None:
        if not any((given / name).is_dir() for name in ("real", "scenarios")):
            raise ValueError(f"{given} has neither a folder real/ nor scenarios/.")
        return given
    named = os.environ.get("CATFREE_SHARED")
    folder = (Path(named) if named else ROOT.parent / "shared") / "data"
    return folder if folder.is_dir() else None


def write_measured(path: Path, outcomes: Mapping[str, Outcome]) -> None:
    """Write all measured digits, so that equal figures give equal files."""
    figures = {
        f"{suite}/{name}": value
        for suite, outcome in outcomes.items()
        for name, value in outcome.figures.items()
    }
    reasons = {suite: outcome.reason for suite, outcome in outcomes.items() if outcome.reason}
    content = {"figures": figures, "not measured": reasons}
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def run(
    suites: Iterable[Suite],
    data: Path | None,
    baseline: Mapping[str, Metric],
    measured: Path | None,
) -> list[Line]:
    """Measure suite by suite, printing each result at once.

    Args:
        suites: the suites.
        data: folder of the data, or None.
        baseline: entries by key.
        measured: file for the measured values, written after each suite; None for none.

    Returns:
        The lines of all suites.
    """
    lines, outcomes = [], {}
    print("| figure | baseline | measured | change (better if, tolerance) | verdict |")
    print("|---|---|---|---|---|", flush=True)
    for suite in suites:
        start = time.process_time()
        outcomes[suite.name] = outcome = measure(suite, data)
        print(f"{suite.name}: {time.process_time() - start:.0f} CPU s", file=sys.stderr, flush=True)
        for line in compare(suite.name, outcome, baseline):
            print(line, flush=True)
            lines.append(line)
        if measured is not None:
            write_measured(measured, outcomes)
    return lines


def summarize(lines: Iterable[Line]) -> str:
    """Describe the failures, and count the figures by verdict."""
    lines = list(lines)
    counts = {v: sum(line.verdict == v for line in lines) for v in get_args(Verdict)}
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count)
    failed = [str(line) for line in lines if line.verdict in FAILURES]
    heading = ["", "Worse than the baseline, or without a figure:", *failed] if failed else []
    return "\n".join([*heading, "", f"{len(lines)} figures: {told}."])


def main() -> None:
    """Print the table and exit with 1 if a figure got worse."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?", help="folder with real/ and scenarios/")
    parser.add_argument("--quick", action="store_true", help="only suites that take seconds")
    parser.add_argument("--only", metavar="PATTERN", help="suites whose name has or matches this")
    parser.add_argument("--measured", type=Path, metavar="FILE", help="write what was measured")
    parser.add_argument("--list", action="store_true", help="print the names of the suites")
    options = parser.parse_args()
    try:
        suites = choose(SUITES, options.only, quick=options.quick)
        data = find_data(options.data)
        if options.measured is not None and options.measured.resolve() == BASELINE:
            raise ValueError("--measured would overwrite the baseline, which is changed by hand.")
        if options.measured is not None and not options.measured.absolute().parent.is_dir():
            raise ValueError(f"There is no folder {options.measured.parent} for --measured.")
        baseline = read_baseline(BASELINE)
    except ValueError as error:
        parser.error(str(error))
    if options.list:
        print("\n".join(f"{s.name}{' (quick)' if s.quick else ''}" for s in suites))
        return
    start = time.perf_counter()
    lines = orphans(baseline, [suite.name for suite in SUITES])
    lines += run(suites, data, baseline, options.measured)
    print(summarize(lines))
    minutes, cpu = (time.perf_counter() - start) / 60, time.process_time() / 60
    print(f"{minutes:.1f} minutes, {cpu:.1f} of one processor.")
    sys.exit(any(line.verdict in FAILURES for line in lines))


if __name__ == "__main__":
    main()
