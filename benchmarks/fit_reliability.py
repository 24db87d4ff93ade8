"""Fit the label-free prediction of MODA: `python -m benchmarks.fit_reliability [--check DATA]`.

Both methods run on the simulated worlds of `reliability_worlds`, and a linear function of the
numbers in `Reliability` is fitted to their MODA. It is validated on held-out worlds, in ten folds
and by leaving out each layout. `--check` predicts real recordings and scenarios, which no fit uses.
`--write` writes the coefficients to `catfree/methods/_expectation_fits.py`.

A world takes one to three seconds; `--rows FILE` stores the measurements and resumes from them.
"""

import argparse
import csv
import dataclasses
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks.reliability_worlds import LAYOUTS, draw, moda
from catfree.methods._expectation import expect_moda
from catfree.methods._expectation_fits import Fit, Term
from catfree.types import Reliability

METHODS = {"paper": cf.Settings.paper(), "evidence": cf.Settings()}
# Numbers of `Reliability` that are used, and whether by their logarithm.
TERMS: dict[str, tuple[tuple[str, bool], ...]] = {
    "paper": (("detections_used", False), ("sigma_over_radius", True)),
    "evidence": (
        ("expected_recall", False),
        ("sigma_over_radius", True),
        ("mean_supporting_cameras", True),
    ),
}
ALTERNATIVES: tuple[tuple[tuple[str, bool], ...], ...] = (
    (("sigma_over_radius", True),),
    (("detections_used", False),),
    (("mean_supporting_cameras", False),),
    (("expected_precision", False),),
    (("expected_recall", False),),
    (("expected_precision", False), ("expected_recall", False)),
    (("expected_precision", False), ("expected_recall", False), ("mean_supporting_cameras", True)),
)
LEVEL = 0.90
FOLDS = 10
ANSWERS = ("expected_moda", "moda_low", "moda_high", "expectation_note")
NUMBERS = tuple(
    field.name for field in dataclasses.fields(Reliability) if field.name not in ANSWERS
)
Row = dict[str, float]
FILE = Path(__file__).parents[1] / "catfree" / "methods" / "_expectation_fits.py"


def measure(number: int, method: str) -> Row:
    """Measure the summary of one run and its MODA."""
    case = draw(number)
    found = cf.localize(case.detections, case.scene, METHODS[method])
    numbers = numbers_of(found.reliability)
    return {
        "number": number,
        "positions": len(found.tracks),
        **numbers,
        "moda": moda(case, found.tracks),
    }


def numbers_of(reliability: Reliability) -> Row:
    """Return the numbers of a summary, without the expectation."""
    values = {name: getattr(reliability, name) for name in NUMBERS}
    return {name: np.nan if value is None else float(value) for name, value in values.items()}


def collect(
    method: str, worlds: int, workers: int, file: Path | None, report: Callable[[str], None]
) -> list[Row]:
    """Collect rows of all worlds, beginning with those in the file."""
    known = {int(row["number"]): row for row in _read(file)}
    wanted = [number for number in range(worlds) if number not in known]
    context = get_context("spawn")  # JAX does not survive a fork
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for row in pool.map(measure, wanted, [method] * len(wanted)):
            known[int(row["number"])] = row
            report(f"{method} world {int(row['number'])}: MODA {row['moda']:.1f}")
            if file is not None:
                _write(file, [known[number] for number in sorted(known)])
    return [known[number] for number in range(worlds)]


def design(rows: Sequence[Row], terms: Iterable[tuple[str, bool]]) -> np.ndarray:
    """Return (N, 1 + T) constant and terms."""
    columns = [np.ones(len(rows))]
    for name, logarithm in terms:
        values = np.array([row[name] for row in rows])
        columns.append(np.log(values) if logarithm else values)
    return np.stack(columns, axis=-1)


def held_out(matrix: np.ndarray, target: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Predict (N,) each world by a fit to the other folds, at most 100."""
    predicted = np.zeros(len(target))
    for one in np.unique(fold):
        rest = fold != one
        weights = np.linalg.lstsq(matrix[rest], target[rest], rcond=None)[0]
        predicted[~rest] = matrix[~rest] @ weights
    return np.minimum(predicted, 100.0)


def folds_of(count: int) -> np.ndarray:
    """Draw (N,) the fold of each world, the same in every call."""
    return np.random.default_rng(0).permutation(count) % FOLDS


def margins(residual: np.ndarray, level: float = LEVEL) -> tuple[float, float]:
    """Compute how far MODA lies below and above the expectation, with finite-sample correction.

    Source:
        Lei et al., "Distribution-free predictive inference for regression" (2018).
    """
    ordered = np.sort(residual)
    count = len(ordered)
    beyond = int(np.floor((count + 1) * (1 - level) / 2))
    at = max(beyond - 1, 0)
    return max(-float(ordered[at]), 0.0), max(float(ordered[count - 1 - at]), 0.0)


def usable(rows: Iterable[Row]) -> list[Row]:
    """Select rows of runs with positions: without any, MODA is 0 and nothing is fitted."""
    return [row for row in rows if row["positions"] > 0 and np.isfinite(row["moda"])]


def fit(method: str, rows: Sequence[Row]) -> Fit:
    """Fit the expected MODA of a method."""
    terms, target = TERMS[method], np.array([row["moda"] for row in rows])
    matrix = design(rows, terms)
    weights = np.linalg.lstsq(matrix, target, rcond=None)[0]
    predicted = held_out(matrix, target, folds_of(len(rows)))
    residual = target - predicted
    below, above = margins(residual)
    made = []
    for (name, logarithm), slope in zip(terms, weights[1:], strict=True):
        values = np.array([row[name] for row in rows])
        made.append(Term(name, logarithm, float(slope), float(values.min()), float(values.max())))
    return Fit(
        METHODS[method],
        float(weights[0]),
        tuple(made),
        below,
        above,
        len(rows),
        float(np.sqrt(np.mean(residual**2))),
        float(np.corrcoef(predicted, target)[0, 1]),
    )


def compare(method: str, rows: Sequence[Row]) -> list[str]:
    """Return lines that compare choices of terms on held-out worlds."""
    target = np.array([row["moda"] for row in rows])
    layout = np.array([int(row["number"]) % len(LAYOUTS) for row in rows])
    fold = folds_of(len(rows))
    lines = [
        f"{method}: {len(rows)} worlds, MODA {target.min():.0f} to {target.max():.0f}, "
        f"SD {target.std():.1f}",
        f"{'terms':66}  RMSE   MAE     r  covered  RMSE, layout left out",
    ]
    for terms in (*ALTERNATIVES, TERMS[method]):
        matrix = design(rows, terms)
        if not np.isfinite(matrix).all():
            continue
        predicted = held_out(matrix, target, fold)
        residual = target - predicted
        elsewhere = target - held_out(matrix, target, layout)
        covered = np.mean([_inside(residual, fold, one) for one in range(FOLDS)])
        name = ", ".join(("log " if logarithm else "") + one for one, logarithm in terms)
        lines.append(
            f"{name:66} {np.sqrt(np.mean(residual**2)):5.1f} {np.abs(residual).mean():5.1f} "
            f"{np.corrcoef(predicted, target)[0, 1]:5.2f}   {100 * covered:3.0f} %    "
            f"{np.sqrt(np.mean(elsewhere**2)):5.1f}"
        )
    return lines


def _inside(residual: np.ndarray, fold: np.ndarray, one: int) -> float:
    below, above = margins(residual[fold != one])
    return float(np.mean((residual[fold == one] >= -below) & (residual[fold == one] <= above)))


def check(folder: Path, fits: Sequence[Fit]) -> list[str]:
    """Return lines with expectation and truth of every real sequence and scenario."""
    from benchmarks.methods import sequences
    from benchmarks.paper.scoring import score

    lines = [f"{'sequence':38} {'method':9} {'MODA':>6}  expected, 90 % interval"]
    errors, inside = [], []
    for sequence in sequences(folder):
        for made in fits:
            found = cf.localize(sequence.detections, sequence.scene, made.settings)
            true = score(found, sequence, tracking=False).moda
            summary = expect_moda(
                found.reliability, made.settings, positions=len(found.tracks), fits=fits
            )
            middle, low, high = summary.expected_moda, summary.moda_low, summary.moda_high
            assert middle is not None
            assert low is not None
            assert high is not None
            said = f"{middle:6.1f}  [{low:.1f}, {high:.1f}]"
            if np.isfinite(middle):
                errors.append(true - middle)
                inside.append(low <= true <= high)
            else:
                said = f"    -   {summary.expectation_note}"
            lines.append(f"{sequence.name:38} {made.settings.method:9} {true:6.1f}  {said}")
    lines.append(
        f"{sum(inside)} of {len(inside)} inside the interval, mean absolute error "
        f"{np.abs(errors).mean():.1f}, mean error {np.mean(errors):+.1f}"
    )
    return lines


def source(fits: Sequence[Fit]) -> str:
    """Return the table as Python source."""
    lines = ["FITS: tuple[Fit, ...] = ("]
    for made in fits:
        settings = "Settings.paper()" if made.settings.method == "paper" else "Settings()"
        lines += ["    Fit(", f"        settings={settings},"]
        lines += [f"        intercept={made.intercept:.2f},", "        terms=("]
        for term in made.terms:
            # Round outwards, so that every world lies in the range.
            low, high = np.floor(1e3 * term.low) / 1e3, np.ceil(1e3 * term.high) / 1e3
            numbers = f"{term.slope:.2f}, {low:.3f}, {high:.3f}"
            lines.append(f'            Term("{term.name}", {term.logarithm}, {numbers}),')
        lines += [
            "        ),",
            f"        below={made.below:.1f},",
            f"        above={made.above:.1f},",
            f"        worlds={made.worlds},",
            f"        error={made.error:.1f},",
            f"        correlation={made.correlation:.2f},",
            "    ),",
        ]
    return "\n".join([*lines, ")", ""])


def main() -> None:
    """Measure, fit and compare; check and write if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=180)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rows", type=Path, help="folder of the measured rows, to resume from")
    parser.add_argument("--check", type=Path, help="folder with real/ and scenarios/")
    parser.add_argument("--write", action="store_true", help="into the library")
    options = parser.parse_args()
    fits = []
    for method in METHODS:
        file = None if options.rows is None else options.rows / f"{method}.csv"
        say = lambda line: print(line, file=sys.stderr, flush=True)  # noqa: E731
        rows = usable(collect(method, options.worlds, options.workers, file, say))
        print("\n".join(compare(method, rows)), end="\n\n")
        fits.append(fit(method, rows))
    text = source(fits)
    print(text)
    if options.check is not None:
        print("\n".join(check(options.check, fits)))
    if options.write:
        before = FILE.read_text(encoding="utf-8")
        FILE.write_text(before[: before.index("FITS: tuple")] + text, encoding="utf-8")


def _read(file: Path | None) -> list[Row]:
    if file is None or not file.is_file():
        return []
    with file.open(newline="", encoding="utf-8") as stream:
        return [
            {name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)
        ]


def _write(file: Path, rows: Sequence[Row]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
