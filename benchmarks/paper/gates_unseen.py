"""The filters on the eight-camera twin (Table "gatesunseen"): `-m benchmarks.paper.gates_unseen`.

The paper has five sequences of one installation; our twin has one world per seed.
"""

from benchmarks.paper import claims
from benchmarks.paper.ablation import Variant, ablation_rows, evaluate, under_conditions
from benchmarks.paper.command import Options, main
from benchmarks.paper.sequences import UNSEEN
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BT, changed

OURS = "uncertainty then ground-plane filter (ours)"
PAPER = {  # five sequences and their mean
    "weighted view support": (64.83, 67.31, 80.73, 74.86, 77.04, 72.95),
    "uncertainty filter only": (67.79, 64.85, 83.59, 77.12, 73.37, 73.34),
    "ground-plane filter first": (67.16, 69.38, 81.63, 78.23, 79.83, 75.25),
    OURS: (70.31, 73.55, 86.41, 80.25, 82.24, 78.55),
}
VARIANTS = (
    Variant("weighted view support", changed(BT, selection={"gates": "support"})),
    Variant("uncertainty filter only", changed(BT, selection={"gates": "uncertainty_replace"})),
    Variant(
        "ground-plane filter first",
        changed(BT, selection={"gates": "ground_then_uncertainty_replace"}),
    ),
    Variant(OURS, BT),
)


def table(options: Options) -> Table:
    """Compute the MODA of the four variants on the worlds of the eight-camera twin."""
    results = evaluate(VARIANTS, options, columns=(UNSEEN,), conditions=True, others=False)
    means = {name: values[-1:] for name, values in PAPER.items()}
    columns, rows = ablation_rows(results, means, (UNSEEN,), conditions=True)
    columns = [*columns, *(f"seed {seed}" for seed in options.seeds)]
    rows = [[*row, *results.moda(str(row[0]), UNSEEN)] for row in rows]
    places = (UNSEEN, *under_conditions((UNSEEN,)))
    return Table(
        'Filters on the unseen installation, MODA (paper: Table "gatesunseen", mean of five)',
        columns,
        rows,
        notes=("All rows are variants of BT, whose numbers the paper's last row has.",),
        verdicts=tuple(
            claims.higher(
                f"On eight cameras, {OURS} beats {other}", results.gains(OURS, other, places)
            )
            for other in list(PAPER)[:-1]
        ),
    )


if __name__ == "__main__":
    main(table, "gates_unseen", __doc__ or "")
