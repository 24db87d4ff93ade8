"""What each ingredient of the evidence method is worth: MODA with it switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`). Measured, with the
true rig on the first two (the room with Faster R-CNN boxes) and a disturbed one on the others:

| without | WildTrack 0-715 | room, 15 people | uneven7 | gmvd8 |
|---|---|---|---|---|
| (all on) | 73.3 | 91.5 | 86.2 | 97.9 |
| misses | 49.6 | 87.1 | 87.6 | 98.5 |
| self-calibration | 69.6 | 85.2 | 80.6 | 57.9 |
| residual field | 70.8 | 86.6 | 83.8 | 81.7 |
| local clutter | 71.3 | 84.8 | 86.2 | 95.3 |
| head and height | 64.7 | 88.5 | 85.3 | 87.5 |
| tracking | 67.9 | 80.4 | 84.1 | 92.9 |
| appearance | 73.3 | 91.5 | 86.0 | 96.2 |
| working area | 65.3 | 89.4 | 86.9 | 97.9 |
| uneven ground | 67.8 | 91.5 | 87.5 | 97.9 |
| hidden feet | 73.5 | 87.7 | 86.4 | 98.4 |
| doubted feet | 68.8 | 90.8 | 85.6 | 98.2 |
| sure positions | 67.8 | 91.5 | 87.5 | 97.9 |
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from catfree.adapters import read_scenario, read_uniform_json
from catfree.evaluation import align_centres, crop, detection_metrics
from catfree.evidence import EvidenceSettings, locate

WITHOUT: dict[str, dict[str, float | bool]] = {
    "(all on)": {},
    "misses": {"use_misses": False},
    "self-calibration": {"self_calibrate": False},
    "residual field": {"residual_field": False},
    "local clutter": {"local_clutter": False},
    "head and height": {"use_height": False},
    "tracking": {"track": False},
    "appearance": {"use_appearance": False},
    "working area": {"working_area": False},
    "uneven ground": {"uneven_ground": False},
    "one person a place": {"personal_space": 0.0},
    "hidden feet": {"cover_slope": 0.0},
    "doubted feet": {"foot_outlier": 1e-9},
    "sure positions": {"report_radius": 1e9},
}


def moda(sequence, settings: EvidenceSettings) -> float:
    """MODA at 0.5 m in the evaluation area."""
    detections = sequence.detections
    if detections.score is not None:
        detections = detections[detections.score >= 0.3]
    tracks = locate(detections, sequence.scene, settings).tracks
    position = tracks.position
    if sequence.true_centres is not None:
        alignment = align_centres(np.asarray(sequence.scene.rig.centers), sequence.true_centres)
        position = np.asarray(alignment(position))
    rows, truth = tracks.to_rows(position[:, :2]), sequence.ground_truth
    if sequence.evaluation_area is not None:
        rows = crop(rows, sequence.evaluation_area)
        truth = crop(truth, sequence.evaluation_area)
    return detection_metrics(truth, rows, frames=sequence.frames).moda


def main() -> None:
    """Print one row a switch and one column a data set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--embedding", default=None, help="embedding of a uniform JSON file")
    options = parser.parse_args()
    sequences = [
        read_scenario(path)
        if path.is_dir()
        else read_uniform_json(path, embedding=options.embedding)
        for path in options.data
    ]
    print("| without | " + " | ".join(s.name for s in sequences) + " |")
    print("|---" * (1 + len(sequences)) + "|")
    for name, change in WITHOUT.items():
        settings = dataclasses.replace(EvidenceSettings(), **change)
        cells = [f"{moda(sequence, settings):.1f}" for sequence in sequences]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
