"""Check the calibration of the stated uncertainty: `python -m benchmarks.uncertainty [DATA]`.

One row per set: the share of true positions inside the 95 % ellipse, the factor on all sigmas that
would give 95 %, the median sigma, and the expected calibration error of the existence
probabilities. Without DATA (see `benchmarks.methods`), only simulated worlds are used; `--picture
FILE` draws these, never the data.

The diagram of probabilities uses all rows of all candidate tracks, reported or not, because nearly
all reported ones have a probability near 1.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks.paper.scoring import ground_rows, world_covariance
from benchmarks.paper.sequences import Sequence, real, scenarios
from benchmarks.reliability_plot import plot_ellipse_coverage, plot_reliability
from catfree.evaluation import (
    CalibrationCurve,
    EllipseCoverage,
    calibration_curve,
    crop,
    ellipse_coverage,
    inside,
    matched_predictions,
)
from catfree.methods.evidence import describe, solve
from catfree.synthetic import RigError, make_world

FRAMES = 40
WORSE, TRUE = RigError(rotation_deg=1.0), RigError(0, 0, 0, 0, 0)
CONDITIONS = {RigError(): "as usual", WORSE: "off by 1°", TRUE: "true"}
GATE = 1.0  # meters; far above the sigmas
WORLDS = (
    ("ring5", 11, RigError()),
    ("wildtrack", 12, RigError()),
    ("multiviewx", 13, RigError()),
    ("gmvd8", 14, RigError()),
    ("wildtrack", 21, RigError()),
    ("gmvd6", 15, WORSE),
    ("wildtrack", 16, TRUE),
    ("ring6", 17, TRUE),
    ("wildtrack", 18, WORSE),
    ("ring4", 19, RigError()),
)


def world(layout: str, seed: int, error: RigError) -> Sequence:
    """Simulate one scene with a disturbed rig."""
    made = make_world(layout, seed, frames=FRAMES, rig_error=error)
    return Sequence.of_world(made, f"{layout} {seed}, rig {CONDITIONS[error]}")


def worlds() -> list[Sequence]:
    """Simulate scenes with usual, worse and undisturbed rigs."""
    return [world(*row) for row in WORLDS]


@dataclass(frozen=True)
class Honesty:
    """Comparison of stated uncertainty with the truth.

    Attributes:
        ellipses: shares of true positions inside.
        existence: calibration curve of existence.
        sigma: median over positions in meters.
    """

    ellipses: EllipseCoverage
    existence: CalibrationCurve
    sigma: float


def judge(tracks: cf.Tracks, sequence: Sequence) -> Honesty:
    """Compare stated uncertainty with the truth, inside the sequence's area."""
    rows, covariance = ground_rows(tracks, sequence), world_covariance(tracks, sequence)
    truth, existence = sequence.ground_truth, np.asarray(tracks.existence)
    if sequence.area is not None:
        within = inside(rows, sequence.area)
        rows, covariance, existence = rows[within], covariance[within], existence[within]
        truth = crop(truth, sequence.area)
    return Honesty(
        ellipse_coverage(truth, rows, covariance, sequence.frames, GATE),
        calibration_curve(existence, matched_predictions(truth, rows)),
        float(np.median(np.linalg.det(covariance) ** 0.25)),
    )


def judge_considered(sequence: Sequence) -> tuple[Honesty, Honesty]:
    """Judge the reported tracks, and all candidate tracks."""
    boxes = sequence.detections
    if boxes.score is not None:
        boxes = boxes[boxes.score >= cf.Settings().confidence]
    solution = solve(boxes, sequence.scene)
    considered = replace(solution, fate=np.full_like(solution.fate, cf.Fate.ACCEPTED))
    reported, all_of_them = (
        judge(
            describe(found, sequence.scene, detection_count=len(boxes)).tracks,
            sequence,
        )
        for found in (solution, considered)
    )
    return reported, all_of_them


def pooled(curves: list[CalibrationCurve]) -> CalibrationCurve:
    """Pool the curves of all sets."""
    count = np.sum([c.count for c in curves], axis=0)
    claimed = np.sum([np.nan_to_num(c.mean_probability * c.count) for c in curves], axis=0)
    true = np.sum([np.nan_to_num(c.observed_frequency * c.count) for c in curves], axis=0)
    total = count.sum()
    brier = sum(c.brier_score * c.count.sum() for c in curves) / total
    with np.errstate(invalid="ignore"):
        return CalibrationCurve(
            edges=curves[0].edges,
            count=count,
            mean_probability=claimed / count,
            observed_frequency=true / count,
            expected_calibration_error=float(np.abs(claimed - true).sum() / total),
            brier_score=float(brier),
        )


def main() -> None:
    """Print a Markdown table and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default="", help="only sets whose name contains this")
    parser.add_argument("--picture", type=Path, help="PNG of the simulated worlds")
    options = parser.parse_args()
    print("| set | inside 95 % | sigmas should be x | sigma (m) | ECE | ECE of all considered |")
    print("|---" * 6 + "|")
    simulated = worlds()
    others = [*real(options.data), *scenarios(options.data)] if options.data else []
    coverages, curves = {}, []
    for sequence in [*simulated, *others]:
        if options.only not in sequence.name:
            continue
        reported, considered = judge_considered(sequence)
        inside_ellipses = reported.ellipses
        print(
            f"| {sequence.name} | {inside_ellipses.share:.3f} "
            f"| {inside_ellipses.sigma_factor:.2f} | {reported.sigma:.3f} "
            f"| {reported.existence.expected_calibration_error:.3f} "
            f"| {considered.existence.expected_calibration_error:.3f} |",
            flush=True,
        )
        if sequence in simulated:
            coverages[sequence.name] = inside_ellipses
            curves.append(considered.existence)
    if options.picture:
        from matplotlib import pyplot

        figure, (left, right) = pyplot.subplots(1, 2, figsize=(12, 5), layout="constrained")
        plot_reliability(pooled(curves), ax=left)
        plot_ellipse_coverage(coverages, ax=right)
        figure.savefig(options.picture, dpi=110)


if __name__ == "__main__":
    main()
