"""Localize and track people in a sequence with true positions, and score the result.

    python examples/localize_wildtrack.py PATH_TO_JSON [--method paper|evidence] [--out DIR]

The file is one uniform JSON (see `catfree.adapters.read_uniform_json`), for instance WildTrack with
detector boxes; any other sequence with cameras and true positions also works.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import catfree as cf
from catfree.adapters import MultiViewSequence
from catfree.evaluation import DetectionMetrics, bootstrap, crop, detection_metrics
from catfree.viz import plot_bird_eye, plot_gates

BLOCK = 200  # frame numbers reported together, as in the paper for held-out footage
NEIGHBORS = 10  # consecutive frames that the bootstrap draws together


def score(sequence: MultiViewSequence, tracks: cf.Tracks, frames: np.ndarray) -> DetectionMetrics:
    """Score some frames, ignoring positions outside the annotated area."""
    truth, found = sequence.ground_truth, tracks.to_rows()
    if sequence.evaluation_area is not None:
        truth, found = crop(truth, sequence.evaluation_area), crop(found, sequence.evaluation_area)
    return detection_metrics(truth, found, frames)


def report_accuracy(sequence: MultiViewSequence, tracks: cf.Tracks) -> None:
    """Print a table with a row per block of frames and a row for all frames."""
    print(f"{'frames':>12} {'MODA':>7} {'MODP':>7} {'prec.':>7} {'recall':>7}")
    block = (sequence.frames - sequence.frames[0]) // BLOCK
    for number in np.unique(block):
        frames = sequence.frames[block == number]
        rates = score(sequence, tracks, frames).rates
        label = f"{frames[0]}-{frames[-1]}"
        print(f"{label:>12} " + " ".join(f"{rate:7.2f}" for rate in rates))
    metrics = score(sequence, tracks, sequence.frames)
    print(f"{'all':>12} " + " ".join(f"{rate:7.2f}" for rate in metrics.rates))
    length = min(NEIGHBORS, len(metrics.frames))
    print(f"with intervals: {bootstrap(metrics, block_length=length)}")


def report_filters(localization: cf.Localization, unit: str) -> None:
    """Print the estimated thresholds and the fates of the candidates."""
    thresholds = localization.thresholds
    for name, value in (("tau_sigma", thresholds.tau_sigma), ("tau_g", thresholds.tau_g)):
        print(f"{name}: " + ("not estimated" if value is None else f"{value:.3f} {unit}"))
    counts = localization.candidates.count_by_fate()
    print(
        f"{len(localization.candidates)} candidates: "
        + ", ".join(f"{count} {fate.replace('_', ' ')}" for fate, count in counts.items() if count)
    )


def main() -> None:
    """Read, localize, report and draw."""
    parser = argparse.ArgumentParser(description="Localize people in a sequence with known truth.")
    parser.add_argument("json", type=Path, help="uniform JSON file with cameras, boxes and truth")
    parser.add_argument("--method", choices=["paper", "evidence"], default="evidence")
    parser.add_argument("--out", type=Path, default=Path("output"), help="folder for the pictures")
    options = parser.parse_args()
    if not options.json.is_file():
        sys.exit(
            f"There is no file {options.json}: convert your sequence to the JSON described in "
            "catfree.adapters.read_uniform_json and pass its path."
        )
    try:
        run(options.json, options.method, options.out)
    except cf.CatFreeError as error:
        sys.exit(str(error))


def run(path: Path, method: str, out: Path) -> None:
    """Process one file with one method ("paper" or "evidence")."""
    started = time.perf_counter()
    sequence = cf.adapters.read_uniform_json(path)
    read = time.perf_counter()
    if sequence.scene is None:
        sys.exit(f"{path} has no calibrated cameras; calibrate them first (see cf.calibrate).")
    settings = cf.Settings.paper() if method == "paper" else cf.Settings()
    localization = cf.localize(sequence.detections, sequence.scene, settings)
    done = time.perf_counter()
    tracks = localization.tracks
    print(
        f"{sequence.name}: {sequence.camera_count} cameras, {len(sequence.frames)} frames, "
        f"{len(sequence.detections)} boxes, {len(np.unique(tracks.track_id))} tracks"
    )
    if len(sequence.ground_truth):
        report_accuracy(sequence, tracks)
    report_filters(localization, "m" if sequence.scene.metric else "scene units")
    print(f"read in {read - started:.1f} s, localized in {done - read:.1f} s")
    draw(sequence, localization, out)


def draw(sequence: MultiViewSequence, localization: cf.Localization, out: Path) -> None:
    """Draw all tracks, the tracks of ten frames, and the two gates."""
    scene, area = sequence.scene, sequence.evaluation_area
    assert scene is not None
    out.mkdir(parents=True, exist_ok=True)
    middle = len(sequence.frames) // 2
    few = sequence.frames[max(middle - 5, 0) : middle + 5]
    for name, frames in (("bird_eye", None), ("bird_eye_ten_frames", few)):
        ax = plot_bird_eye(
            localization,
            scene,
            ground_truth=sequence.ground_truth,
            area=area,
            frames=frames,
            camera_names=sequence.camera_names,
        )
        ax.figure.savefig(out / f"{name}.png", dpi=150)
    plot_gates(localization, scene)[0].figure.savefig(out / "gates.png", dpi=150)
    print(f"pictures in {out}: bird_eye.png, bird_eye_ten_frames.png, gates.png")


if __name__ == "__main__":
    main()
