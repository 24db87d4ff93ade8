"""What each ingredient of the evidence method is worth: MODA with it switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`).
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

from catfree.adapters import read_scenario, read_uniform_json
from catfree.evaluation import align_centres, crop, detection_metrics
from catfree.evidence import EvidenceSettings, locate

SWITCHES = (
    "use_misses",
    "self_calibrate",
    "residual_field",
    "local_clutter",
    "use_height",
    "track",
    "use_appearance",
    "working_area",
)


def moda(sequence, settings: EvidenceSettings) -> tuple[float, float]:
    """MODA at 0.5 m in the evaluation area, and the seconds it took."""
    detections = sequence.detections
    if detections.score is not None:
        detections = detections[detections.score >= 0.3]
    started = time.perf_counter()
    tracks = locate(detections, sequence.scene, settings).tracks
    seconds = time.perf_counter() - started
    position = tracks.position
    if sequence.true_centres is not None:
        alignment = align_centres(np.asarray(sequence.scene.rig.centers), sequence.true_centres)
        position = np.asarray(alignment(position))
    rows, truth = tracks.to_rows(position[:, :2]), sequence.ground_truth
    if sequence.evaluation_area is not None:
        rows = crop(rows, sequence.evaluation_area)
        truth = crop(truth, sequence.evaluation_area)
    return detection_metrics(truth, rows, frames=sequence.frames).moda, seconds


def main() -> None:
    """Print one row a switch and one column a data set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--embedding", default=None, help="embedding of a uniform JSON file")
    options = parser.parse_args()
    sequences = [
        read_scenario(path)
        if path.is_dir()
        else read_uniform_json(path, embedding=options.embedding)
        for path in options.data
    ]
    print(f"{'without':16s}" + "".join(f"{s.name[:15]:>16s}" for s in sequences))
    for switch in (None, *SWITCHES):
        settings = EvidenceSettings()
        if switch is not None:
            settings = dataclasses.replace(settings, **{switch: False})
        cells = [moda(sequence, settings) for sequence in sequences]
        row = "".join(f"{value:8.1f} {seconds:5.1f}s " for value, seconds in cells)
        print(f"{switch or '(all on)':16s}{row}", flush=True)


if __name__ == "__main__":
    main()
