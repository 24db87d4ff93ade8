"""The rules of the trajectory stage, one by one: `python -m benchmarks.paper.trajectory_rules`."""

from benchmarks.paper import claims
from benchmarks.paper.ablation import Variant, ablation_rows, evaluate
from benchmarks.paper.command import Options, main
from benchmarks.paper.table import Table
from benchmarks.paper.variants import BS, BT, changed

ALL, NOTHING, NO_EXTENSION = "BS (all rules)", "no trajectory stage", "- track extension"
NO_STATIC, NO_GAPS = "- short static-track removal (BT)", "- gap interpolation"
NO_LOOKS, NO_LOOK = "- appearance in linking and extension", "- appearance in extension"
PAPER = {
    NOTHING: (79.94, 81.12, 62.01, 74.36),
    ALL: (82.25, 84.54, 64.63, 77.14),
    NO_STATIC: (82.46, 84.54, 65.69, 77.56),
    NO_GAPS: (82.25, 84.54, 64.63, 77.14),
    NO_EXTENSION: (80.46, 78.92, 59.03, 72.80),
    NO_LOOKS: (81.72, 84.20, 64.46, 76.79),
    NO_LOOK: (82.25, 84.14, 64.63, 77.01),
}
VARIANTS = (
    Variant(NOTHING, changed(BS, trajectories={"enabled": False})),
    Variant(ALL, BS),
    Variant(NO_STATIC, BT),
    Variant(NO_GAPS, BS),  # links join only consecutive frames, so there are no gaps
    Variant(NO_EXTENSION, changed(BS, trajectories={"extend": False})),
    Variant(
        NO_LOOKS,
        changed(
            BS,
            trajectories={"appearance_in_linking": False, "appearance_in_extension": False},
        ),
    ),
    Variant(NO_LOOK, changed(BS, trajectories={"appearance_in_extension": False})),
)


def table(options: Options) -> Table:
    """Compute the MODA without each rule."""
    results = evaluate(VARIANTS, options)
    columns, rows = ablation_rows(results, PAPER)
    extension = results.gains(ALL, NO_EXTENSION)
    rules = (NO_STATIC, NO_LOOKS, NO_LOOK)
    largest = {
        place: all(abs(results.gain(ALL, rule, place).value) <= gain.value for rule in rules)
        for place, gain in extension.items()
    }
    return Table(
        'Trajectory rules, MODA (paper: Table "traj")',
        columns,
        rows,
        verdicts=(
            claims.higher(
                "The trajectory stage adds to positions frame by frame", results.gains(ALL, NOTHING)
            ),
            claims.holds_in(
                "Track extension is the rule that matters most",
                largest,
                {place: f"worth {gain.value:+.1f}" for place, gain in extension.items()},
            ),
            claims.higher(
                "Appearance in linking and extension helps", results.gains(ALL, NO_LOOKS)
            ),
            claims.alike(
                "Appearance in extension alone hardly matters",
                results.gains(ALL, NO_LOOK),
                0.5,
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "trajectory_rules", __doc__ or "")
