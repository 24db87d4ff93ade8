"""Cumulative changes from I to BT (Table "lineage"): `python -m benchmarks.paper.lineage`."""

from itertools import pairwise

from benchmarks.paper import claims
from benchmarks.paper.ablation import Variant, ablation_rows, evaluate
from benchmarks.paper.command import Options, main
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BF, BK, BS, BT, I, K, Q

PAPER = {
    "I": (78.68, 78.92, 56.36, 71.32),
    "K": (80.57, 81.39, 59.64, 73.87),
    "Q": (80.99, 82.06, 59.93, 74.33),
    "BF": (78.47, 83.07, 64.68, 75.41),
    "BK": (81.62, 84.34, 64.51, 76.82),
    "BS": (82.25, 84.54, 64.63, 77.14),
    "BT": (82.46, 84.54, 65.69, 77.56),
}
STEPS = {
    "I": "rays.only_confirmed_ankles, no ray weights, selection.exclusive_support, "
    'selection.gates="support", no refit, short static tracks removed',
    "K": "all detections of 0.30 and above, ray weights on",
    "Q": "selection.exclusive_support off",
    "BF": 'selection.gates="uncertainty_replace"',
    "BK": 'selection.gates="uncertainty_then_ground"',
    "BS": "triangulation.refit_inliers on",
    "BT": "trajectories.remove_short_static off: `Settings.paper()`",
}
SETTINGS = {"I": I, "K": K, "Q": Q, "BF": BF, "BK": BK, "BS": BS, "BT": BT}
VARIANTS = tuple(Variant(name, settings) for name, settings in SETTINGS.items())


def table(options: Options) -> Table:
    """Compute the MODA of each step, and its gain over the previous step."""
    results = evaluate(VARIANTS, options)
    columns, rows = ablation_rows(results, PAPER)
    columns = [columns[0], "Settings", *columns[1:]]
    rows = [[row[0], STEPS[str(row[0])], *row[1:]] for row in rows]
    steps = [
        claims.higher(f"Step {before} to {after} raises MODA", results.gains(after, before))
        for before, after in pairwise(SETTINGS)
        if after not in ("BF", "BT")  # the paper's own gains for these differ in sign or are zero
    ]
    return Table(
        'Cumulative changes, MODA (paper: Table "lineage")',
        columns,
        rows,
        notes=(
            "Every step can be expressed by settings. The paper does not say what else its earlier "
            "baseline I had; here it differs from K by ankles and weights alone.",
            "Data without keypoints have no ankles to ask for: there I is K without weights.",
        ),
        verdicts=(
            claims.higher("The final method BT improves on I", results.gains("BT", "I")),
            *steps,
            claims.not_lower(
                "Retaining short static tracks (BS to BT) does not lower MODA",
                results.gains("BT", "BS"),
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "lineage", __doc__ or "")
