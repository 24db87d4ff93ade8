"""The auxiliary score on and off (Sec. Scoring): `python -m benchmarks.paper.score_stage`."""

from benchmarks.paper import claims
from benchmarks.paper.ablation import Variant, ablation_rows, evaluate
from benchmarks.paper.command import Options, main
from benchmarks.paper.sequences import DEVELOPMENT, UNSEEN
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BT, changed

WITH, WITHOUT = "with the score", "without the score"
COLUMNS = (*DEVELOPMENT, UNSEEN)
# Effect of removing the stage, in points of MODA.
PAPER_CHANGE = (0.10, 0.07, 0.02, 0.02)
WITH_SCORE = (82.46, 84.54, 65.69, 78.55)
PAPER = {
    WITH: WITH_SCORE,
    WITHOUT: tuple(a + b for a, b in zip(WITH_SCORE, PAPER_CHANGE, strict=True)),
}
VARIANTS = (Variant(WITH, BT), Variant(WITHOUT, changed(BT, selection={"use_score": False})))
TOLERANCE = 0.5  # points; the paper's largest change is 0.1


def table(options: Options) -> Table:
    """Compute the MODA with and without the seven-signal score."""
    results = evaluate(VARIANTS, options, columns=COLUMNS)
    columns, rows = ablation_rows(results, PAPER, COLUMNS)
    return Table(
        'The auxiliary score, MODA (paper: Sec. "Effect of the auxiliary score")',
        columns,
        rows,
        notes=(
            "The score orders hypotheses of equal camera support in the suppression. "
            "Reconstruction confidence, its seventh signal, needs a reconstruction's confidence "
            "maps, which neither twins nor data have.",
        ),
        verdicts=(
            claims.alike(
                "Removing the score changes next to nothing",
                results.gains(WITHOUT, WITH),
                TOLERANCE,
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "score_stage", __doc__ or "")
