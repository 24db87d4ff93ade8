"""Wrong pairs that both filters accept (Table "failure"): `python -m benchmarks.paper.failure`."""

import itertools

import numpy as np

from benchmarks.failure_table import ANGLE_EDGES, PAPER, TOLERANCE, survival
from benchmarks.paper import claims
from benchmarks.paper.command import Options, main
from benchmarks.paper.table import Cell, Table

SAMPLES = 200_000  # as in the paper
FILTERS = ("uncertainty", "both")


def table(options: Options, samples: int = SAMPLES) -> Table:
    """Tabulate percentages of accepted wrong pairs by separation and angle; paper in brackets."""
    del options  # unused: needs no data
    ours = {separation: survival(separation, samples, seed=0) for separation in PAPER}
    rows: list[list[Cell]] = [
        [
            f"{separation:g} m",
            name,
            *(f"{a:.1f} ({b:.1f})" for a, b in zip(found, said, strict=True)),
        ]
        for separation, paper in PAPER.items()
        for name, found, said in zip(FILTERS, ours[separation], paper, strict=True)
    ]
    worst = {s: float(np.abs(ours[s] - np.array(PAPER[s])).max()) for s in PAPER}
    certain = {s: ours[s][0] for s in PAPER}
    return Table(
        'Incorrect pairs that pass, ours (paper) in percent (paper: Table "failure")',
        ["Apart", "Filter", *(f"{a}-{b}°" for a, b in itertools.pairwise(ANGLE_EDGES))],
        rows,
        notes=(f"{samples} samples a separation.",),
        verdicts=(
            claims.holds_in(
                f"Every cell within {TOLERANCE:g} point of the paper's",
                {f"{s:g} m": value <= TOLERANCE for s, value in worst.items()},
                {f"{s:g} m": f"largest difference {value:.2f}" for s, value in worst.items()},
            ),
            claims.holds_in(
                "The uncertainty filter does not see identity errors: over 90 % pass",
                {f"{s:g} m": bool((row > 90).all()) for s, row in certain.items()},
                {f"{s:g} m": f"{row.min():.1f} to {row.max():.1f}" for s, row in certain.items()},
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "failure", __doc__ or "")
