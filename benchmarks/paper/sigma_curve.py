"""Sigma as a predictor of MODA (Table "sigmacurve"): `python -m benchmarks.paper.sigma_curve`.

As in the paper, settings differ in the number of cameras or in the time window: the first k cameras
of all frames, and single windows with all cameras. The correlation is between MODA and log sigma,
the median at the annotated positions with the true rig. The label-free counterpart is
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from benchmarks.paper.camera_removal import (
    FEWEST,
    METHODS,
    first_cameras,
    median,
    score_in_gauge,
    sources,
    true_geometry,
)
from benchmarks.paper.command import Options, main
from benchmarks.paper.scoring import BLOCK, SAMPLES, localize
from benchmarks.paper.sequences import Sequence
from benchmarks.paper.table import Cell, Table
from catfree.evaluation import DetectionMetrics

PAPER_PEARSON, PAPER_SPEARMAN = -0.98, -0.93
STRONG = -0.90  # limit that still supports the paper's claim
KINDS = {"sigma": "sigma at the true positions", "reported": "reported sigma, no labels"}
WINDOWS = {"real": 200, "twin": 20}  # frame numbers per window; the paper's on WildTrack


@dataclass(frozen=True)
class Point:
    """One setting of one sequence.

    Attributes:
        name: name of the setting.
        sigma: median at the annotated positions in meters.
        reported: median sigma of the reported positions over the radius, NaN without positions.
        detection: counts of every frame.
    """

    name: str
    sigma: float
    reported: float
    detection: DetectionMetrics


def points(sequence: Sequence, method: str) -> list[Point]:
    """Compute the settings of one sequence: camera removal, then time windows with all cameras."""
    settings = dict(METHODS)[method]
    found = []
    cameras = sequence.scene.rig.camera_count
    for k in range(FEWEST, cameras + 1):
        part = first_cameras(sequence, k)
        result = localize(part, settings)
        scored = score_in_gauge(result, part, sequence)
        sigma = median(true_geometry(part)[0])
        reported = result.reliability.sigma_over_radius
        found.append(Point(f"{k} cameras", sigma, reported, scored.detection))
    result = localize(sequence, settings)
    whole = score_in_gauge(result, sequence, sequence).detection
    radius = result.reliability.median_sigma / result.reliability.sigma_over_radius
    length = WINDOWS[sequence.kind]
    number = sequence.frames // length
    for window in np.unique(number):
        frames = sequence.frames[number == window]
        own = np.isin(whole.frames, frames)
        tracks = result.tracks
        sigmas = tracks.sigma[np.isin(tracks.frame, frames)]
        found.append(
            Point(
                f"frames {length * window}-{length * window + length - 1}",
                median(true_geometry(sequence, frames)[0]),
                float(np.median(sigmas) / radius) if len(sigmas) else np.nan,
                DetectionMetrics(
                    whole.frames[own],
                    whole.tp_per_frame[own],
                    whole.fp_per_frame[own],
                    whole.fn_per_frame[own],
                    whole.distance_sum_per_frame[own],
                    whole.threshold,
                ),
            )
        )
    return found


def pearson(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Correlate along the last axis of (..., N) values; NaN if one side is constant."""
    x, y = x - x.mean(-1, keepdims=True), y - y.mean(-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (x * y).sum(-1) / np.sqrt((x * x).sum(-1) * (y * y).sum(-1))


def spearman(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Correlate ranks along the last axis of (..., N) values."""
    return pearson(rankdata(x, axis=-1), rankdata(y, axis=-1))


def resampled_moda(detection: DetectionMetrics, rng: np.random.Generator) -> np.ndarray:
    """Compute (SAMPLES,) MODA, drawing blocks of frames with replacement."""
    n = len(detection.frames)
    length = min(BLOCK, n)
    start = rng.integers(n, size=(SAMPLES, -(-n // length)))
    drawn = (start[..., None] + np.arange(length)).reshape(SAMPLES, -1)[:, :n] % n
    wrong = (detection.fp_per_frame + detection.fn_per_frame)[drawn].sum(1)
    true = (detection.tp_per_frame + detection.fn_per_frame)[drawn].sum(1)
    return 100 * (1 - wrong / np.maximum(true, 1))


def table(options: Options) -> Table:
    """Tabulate every setting, and the correlations with their intervals."""
    rows: list[list[Cell]] = []
    correlations: dict[tuple[str, str], tuple[float, float]] = {}
    for label, sequences in sources(options):
        for method, _ in METHODS:
            found = [point for one in sequences for point in points(one, method)]
            for sequence, point in _named(sequences, found):
                rows.append([
                    label if len(sequences) == 1 else f"{label}, seed {sequence.seed}",
                    method, point.name, f"{100 * point.sigma:.1f}", f"{point.reported:.2f}",
                    point.detection.moda,
                ])  # fmt: skip
            share = len(found) // len(sequences)
            for what in ("sigma", "reported"):
                # The paper's curve is of one recording; pooled installations differ in more ways.
                for at, sequence in enumerate(sequences):
                    own = f"{label}, seed {sequence.seed}" if len(sequences) > 1 else label
                    line, value = correlate(found[at * share : (at + 1) * share], what)
                    rows.append([own, method, *line])
                    correlations[own, f"{method} method, {KINDS[what]}"] = value
                if len(sequences) > 1:
                    rows.append([f"{label}, pooled", method, *correlate(found, what)[0]])
    return Table(
        'One curve of sigma and MODA (the paper\'s Table "sigmacurve")',
        ["data", "method", "setting", "sigma cm", "reported sigma / r", "MODA"],
        rows,
        notes=(
            "Settings where fewer than half of the people are seen by two cameras have no finite "
            "sigma and take no part in the correlation with it; their number is stated.",
            "Intervals: blocks of frames of every setting drawn with replacement, 95 %.",
            f"Reproduced means a Pearson correlation of at most {STRONG} within each recording; "
            f"the paper has {PAPER_PEARSON} (Spearman {PAPER_SPEARMAN}) in one, eight settings.",
        ),
        verdicts=judge(correlations),
    )


def correlate(found: list[Point], what: str) -> tuple[list[Cell], tuple[float, float]]:
    """Make a row with both correlations and their intervals; also return the two values."""
    sigma = np.array([getattr(point, what) for point in found])
    usable = np.isfinite(sigma) & (sigma > 0)
    chosen = [point for point, ok in zip(found, usable, strict=True) if ok]
    x = np.log(sigma[usable])
    y = np.array([point.detection.moda for point in chosen])
    rng = np.random.default_rng(0)
    drawn = np.stack([resampled_moda(point.detection, rng) for point in chosen], -1)
    cells, values = [], []
    for name, function in (("Pearson", pearson), ("Spearman", spearman)):
        value = float(function(x, y))
        low, high = np.nanquantile(function(np.broadcast_to(x, drawn.shape), drawn), [0.025, 0.975])
        cells.append(f"{name} {value:.2f} [{low:.2f}, {high:.2f}]")
        values.append(value)
    line: list[Cell] = [
        f"correlation with log {KINDS[what]} ({usable.sum()} of {len(found)} settings)",
        *cells, None,
    ]  # fmt: skip
    return line, (values[0], values[1])


def judge(correlations: dict[tuple[str, str], tuple[float, float]]) -> list[str]:
    """Judge each method and kind of sigma, over all recordings."""
    said = []
    for kind in dict.fromkeys(kind for _, kind in correlations):
        values = {label: r for (label, one), (r, _) in correlations.items() if one == kind}
        strong = [label for label, r in values.items() if r <= STRONG]
        if len(strong) == len(values):
            outcome = "reproduced"
        elif strong:
            outcome = f"only under conditions ({', '.join(strong)})"
        else:
            outcome = "not reproduced"
        listed = ", ".join(f"{label} r = {r:.2f}" for label, r in values.items())
        said.append(
            f"Log sigma predicts MODA with r = {PAPER_PEARSON}; {kind}: **{outcome}** ({listed})."
        )
    return said


def _named(sequences: list[Sequence], found: list[Point]) -> list[tuple[Sequence, Point]]:
    """Pair each point with its sequence; all sequences have equally many points."""
    share = len(found) // len(sequences)
    return [(sequences[at // share], point) for at, point in enumerate(found)]


if __name__ == "__main__":
    main(table, "sigma_curve", __doc__ or "")
