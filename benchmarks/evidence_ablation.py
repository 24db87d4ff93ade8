"""Scores of the evidence method with each ingredient switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`). Measured: MODA,
and IDF1 after the slash, with the true rig on the first two (the room with Faster R-CNN boxes)
and a disturbed one on the others:

| without | WildTrack 0-715 | room, 15 people | uneven7 | gmvd8 |
|---|---|---|---|---|
| (all on) | 74.7 | 91.2 / 43.7 | 87.9 / 94.0 | 98.6 / 99.0 |
| misses | 53.3 | 90.4 / 37.7 | 88.6 / 94.4 | 99.0 / 98.0 |
| self-calibration | 70.6 | 87.5 / 37.3 | 81.4 / 90.8 | 58.2 / 73.7 |
| residual field | 72.4 | 89.2 / 31.8 | 84.8 / 93.2 | 82.3 / 90.0 |
| local clutter | 73.0 | 82.9 / 38.9 | 87.1 / 93.4 | 96.0 / 97.8 |
| head and height | 64.8 | 89.4 / 45.9 | 85.6 / 92.6 | 89.4 / 94.1 |
| tracking | 68.2 | 81.4 / 0.6 | 85.0 / 5.4 | 92.8 / 3.6 |
| appearance | 74.7 | 91.2 / 43.7 | 87.0 / 93.4 | 95.9 / 94.0 |
| appearance over time | 74.7 | 91.2 / 43.7 | 87.2 / 93.5 | 97.9 / 95.4 |
| working area | 65.8 | 88.9 / 43.1 | 87.3 / 95.6 | 98.6 / 99.0 |
| uneven ground | 69.4 | 91.2 / 43.7 | 87.9 / 94.0 | 98.6 / 99.0 |
| one person a place | 74.5 | 91.3 / 43.6 | 88.1 / 94.2 | 98.6 / 99.0 |
| hidden feet | 74.5 | 89.8 / 40.7 | 87.7 / 92.9 | 98.3 / 98.3 |
| doubted feet | 67.3 | 90.3 / 48.5 | 87.7 / 93.8 | 99.0 / 99.5 |
| sure positions | 69.4 | 91.2 / 43.7 | 87.9 / 94.0 | 98.6 / 99.0 |
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from catfree.adapters import read_scenario, read_uniform_json
from catfree.evaluation import align_centres, crop, detection_metrics, tracking_metrics
from catfree.methods.evidence import EvidenceSettings, localize_by_evidence

WITHOUT: dict[str, dict[str, float | bool]] = {
    "(all on)": {},
    "misses": {"use_misses": False},
    "self-calibration": {"self_calibrate": False},
    "residual field": {"residual_field": False},
    "local clutter": {"local_clutter": False},
    "head and height": {"use_height": False},
    "tracking": {"track": False},
    "appearance": {"use_appearance": False},
    "appearance over time": {"link_by_looks": False},
    "working area": {"working_area": False},
    "uneven ground": {"uneven_ground": False},
    "one person a place": {"personal_space": 0.0},
    "hidden feet": {"cover_slope": 0.0},
    "doubted feet": {"foot_outlier": 1e-9},
    "sure positions": {"report_radius": 1e9},
}


def scores(sequence, settings: EvidenceSettings) -> str:
    """MODA at 0.5 m in the evaluation area, and IDF1 where people have identities."""
    detections = sequence.detections
    if detections.score is not None:
        detections = detections[detections.score >= 0.3]
    tracks = localize_by_evidence(detections, sequence.scene, settings).tracks
    position = tracks.position
    if sequence.true_centres is not None:
        alignment = align_centres(np.asarray(sequence.scene.rig.centers), sequence.true_centres)
        position = np.asarray(alignment(position))
    rows, truth = tracks.to_rows(position[:, :2]), sequence.ground_truth
    if sequence.evaluation_area is not None:
        rows = crop(rows, sequence.evaluation_area)
        truth = crop(truth, sequence.evaluation_area)
    found = f"{detection_metrics(truth, rows, frames=sequence.frames).moda:.1f}"
    if (truth[:, 1] >= 0).all():
        found += f" / {tracking_metrics(truth, rows, sequence.frames).idf1:.1f}"
    return found


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
        cells = [scores(sequence, settings) for sequence in sequences]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
