"""Vary one quantity for both methods and several seeds; write a CSV and a figure.

A study defines the quantity, its values, and how to make the sequence for a value and a seed. Each
seed is another rig, crowd and run of the detector; as much as possible stays fixed when the value
changes, and both methods get the same boxes. Bands span the seeds, lines are means.
"""

import argparse
import csv
import dataclasses
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import catfree as cf
from benchmarks.paper.scoring import ground_rows, score_rows, world_covariance
from benchmarks.paper.sequences import Sequence
from catfree.evaluation import ellipse_coverage
from catfree.evaluation._position_matching import matched_rows
from catfree.evaluation._rows import read_sequence
from catfree.synthetic import DetectorModel, RigError, make_world

LAYOUT = "gmvd6"  # six cameras around a courtyard of 20 x 24 m, 33 people, 2 frames per second
FRAMES = 40
SEEDS = 5
GATE = 1.0  # meters; more distant pairs do not count as the same person when errors are measured
MEDIAN_OF_RAYLEIGH = float(np.sqrt(2 * np.log(2)))  # median distance of a unit 2-D Gaussian

METHODS: dict[str, tuple[cf.Settings, str]] = {
    "paper": (cf.Settings.paper(), "#d55e00"),
    "evidence": (cf.Settings(), "#0072b2"),
}


@dataclass(frozen=True)
class Study:
    """One quantity to vary.

    Attributes:
        name: stem of the files.
        title: title of the figure, a few words.
        axis: label of the quantity, with its unit.
        values: the values, ascending.
        quick: few values for a test.
        sequence: makes the sequence for a value, a seed and a number of frames; only its `frames`
            are scored.
        logarithmic: whether the axis is logarithmic.
    """

    name: str
    title: str
    axis: str
    values: tuple[float, ...]
    quick: tuple[float, ...]
    sequence: Callable[[float, int, int], Sequence]
    logarithmic: bool = False


def simulate(
    seed: int,
    frames: int,
    *,
    detector: DetectorModel | None = None,
    rig_error: RigError | None = None,
) -> Sequence:
    """Simulate the courtyard of a seed, with one property changed."""
    world = make_world(LAYOUT, seed, frames=frames, detector=detector, rig_error=rig_error)
    return Sequence.of_world(world, f"{LAYOUT} {seed}")


def measure(sequence: Sequence, settings: cf.Settings) -> dict[str, float]:
    """Score one run: MODA at 0.5 m, errors and stated uncertainty in meters.

    The result is aligned by the similarity of the camera centers, as in the paper. Positions
    outside the evaluation area are ignored.
    """
    tracks = cf.localize(sequence.detections, sequence.scene, settings).tracks
    covariance = world_covariance(tracks, sequence)
    rows = ground_rows(tracks, sequence)
    sized = np.isfinite(covariance).all((1, 2)) & (np.linalg.det(covariance) > 0)
    truth, frames = sequence.ground_truth, sequence.frames
    found = score_rows(rows, sequence, tracking=False).detection
    pairs = read_sequence(truth, rows[sized], frames)
    true, predicted = matched_rows(pairs, GATE)
    error = np.linalg.norm(pairs.truth[true, 2:] - pairs.predicted[predicted, 2:], axis=-1)
    in_frames = np.isin(rows[sized, 0], frames)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)[sized][in_frames][predicted]
    inside = ellipse_coverage(truth, rows[sized], covariance[sized], frames, GATE).share
    return {
        "moda": found.moda,
        "precision": found.precision,
        "recall": found.recall,
        "error_m": float(np.median(error)) if len(error) else float("nan"),
        "claimed_error_m": float(np.median(sigma)) * MEDIAN_OF_RAYLEIGH
        if len(error)
        else float("nan"),
        "coverage_percent": 100 * inside,
    }


def sweep(
    study: Study, values: Iterable[float], seeds: int, frames: int
) -> list[dict[str, float | str]]:
    """Run every value, seed and method; return one record per run."""
    records: list[dict[str, float | str]] = []
    for value in values:
        for seed in range(seeds):
            sequence = study.sequence(value, seed, frames)
            for method, (settings, _) in METHODS.items():
                setting = {"study": study.name, "value": value, "seed": seed, "method": method}
                records.append(setting | measure(sequence, settings))
        means = [
            f"{method} {_column(records, method, value, 'moda').mean():.1f}" for method in METHODS
        ]
        print(f"{study.name} {value:g}: MODA {', '.join(means)}", flush=True)
    return records


def _column(records: list[dict[str, Any]], method: str, value: float, name: str) -> np.ndarray:
    rows = [r[name] for r in records if r["method"] == method and r["value"] == value]
    return np.array(rows, np.float64)


def draw(study: Study, records: list[dict[str, Any]], path: Path) -> None:
    """Draw MODA, true and stated error, and share inside the ellipse, over the quantity."""
    from matplotlib import pyplot

    figure, (score, error, inside) = pyplot.subplots(1, 3, figsize=(12, 4.4), layout="constrained")
    values = sorted({record["value"] for record in records})

    def line(ax, method: str, name: str, *, band: bool = True, **style: Any) -> None:
        columns = [_column(records, method, value, name) for value in values]
        known = [column[np.isfinite(column)] for column in columns]
        kept = [k for k, column in enumerate(known) if len(column)]
        x = [values[k] for k in kept]
        color = METHODS[method][1]
        ax.plot(x, [known[k].mean() for k in kept], color=color, **style)
        if band:
            low, high = [known[k].min() for k in kept], [known[k].max() for k in kept]
            ax.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)

    for method in METHODS:
        line(score, method, "moda", marker="o", markersize=4, label=method)
        line(error, method, "error_m", marker="o", markersize=4)
        line(error, method, "claimed_error_m", band=False, linestyle="--")
        line(inside, method, "coverage_percent", marker="o", markersize=4)
    error.plot([], [], color="0.4", linestyle="--", label="error that the method claims")
    inside.axhline(95, color="0.4", linewidth=1, linestyle=":", label="honest")
    score.set_ylabel("MODA at 0.5 m (%)")
    score.set_ylim(min(0.0, score.get_ylim()[0]), 102)
    error.set_ylabel("median position error (m)")
    error.set_ylim(bottom=0)
    inside.set_ylabel("true positions inside the 95 % ellipse (%)")
    inside.set_ylim(0, 102)
    for ax in (score, error, inside):
        if study.logarithmic:
            ax.set_xscale("log")
            ax.set_xticks(values, [f"{value:g}" for value in values])
            ax.minorticks_off()
        ax.grid(color="0.9")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)  # never covers a line
    seeds = len({record["seed"] for record in records})
    error.set_xlabel(study.axis)
    figure.suptitle(f"{study.title} ({LAYOUT}, mean and range of {seeds} seeds)")
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def run(study: Study, options: argparse.Namespace) -> Path:
    """Sweep, write `NAME.csv`, draw `NAME.png`, and return the figure's path."""
    options.out.mkdir(parents=True, exist_ok=True)
    started = time.process_time()
    values = study.quick if options.quick else study.values
    records = sweep(study, values, options.seeds, options.frames)
    with (options.out / f"{study.name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(records[0]))
        writer.writeheader()
        for record in records:
            writer.writerow(
                {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in record.items()}
            )
    figure = options.out / f"{study.name}.png"
    draw(study, records, figure)
    print(f"{figure}: {time.process_time() - started:.0f} CPU seconds", flush=True)
    return figure


def arguments(description: str | None, given: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line shared by all studies."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder of the files")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="worlds a value")
    parser.add_argument("--frames", type=int, default=FRAMES, help="frames a world")
    parser.add_argument("--quick", action="store_true", help="two values, 6 frames, one seed")
    options = parser.parse_args(given)
    if options.quick:
        options = argparse.Namespace(**(vars(options) | {"seeds": 1, "frames": 6}))
    return options


def main(study: Study, given: list[str] | None = None) -> None:
    """Run one study from the command line."""
    run(study, arguments(study.title, given))


def detector(**changed: float | int) -> DetectorModel:
    """Return the default detector with some properties changed."""
    return dataclasses.replace(DetectorModel(), **changed)
