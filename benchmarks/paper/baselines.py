"""Controlled localization baselines (Table "baselines"): `python -m benchmarks.paper.baselines`."""

from benchmarks.paper import claims
from benchmarks.paper.ablation import Variant, ablation_rows, evaluate
from benchmarks.paper.command import Options, main
from benchmarks.paper.sequences import DEVELOPMENT
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BT, changed

SINGLE, PAIR = "(A) single-camera ground projection", "(B) best two-ray estimate"
OURS, TRUE = "CAT-Free", "(C) CAT-Free with ground-truth calibration"
PAPER = {
    SINGLE: (32.88, 15.66, 42.84),
    PAIR: (79.10, 75.23, 60.59),
    OURS: (82.46, 84.54, 65.69),
    TRUE: (79.94, 81.26, 65.17),
}
VARIANTS = (
    Variant(SINGLE, changed(BT, triangulation={"estimator": "single_ray"})),
    Variant(PAIR, changed(BT, triangulation={"estimator": "best_pair"})),
    Variant(OURS, BT),
    Variant(TRUE, BT, true_rig=True),
)


def table(options: Options) -> Table:
    """Compute the MODA of one ray, two rays, all rays, and the true calibration."""
    results = evaluate(VARIANTS, options)
    columns, rows = ablation_rows(results, PAPER)
    return Table(
        'Localization baselines, MODA (paper: Table "baselines")',
        columns,
        rows,
        notes=(
            "A cuts the most reliable ray of each group with the ground, B takes the two rays with "
            "the smallest sigma; association, filters and trajectories are BT's.",
            "Real data come with true rigs, so there CAT-Free and C are the same run; scenarios "
            "have no published true rig.",
        ),
        verdicts=(
            claims.higher("All rays are better than the best two", results.gains(OURS, PAIR)),
            claims.higher(
                "Two rays are better than one cut with the ground", results.gains(PAIR, SINGLE)
            ),
            claims.not_lower(
                "The true calibration does not improve MODA",
                results.gains(OURS, TRUE, DEVELOPMENT),
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "baselines", __doc__ or "")
