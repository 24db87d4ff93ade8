"""What each ingredient of the evidence method is worth: the scores with it switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`). Measured, with the
true rig on the first two (the room with Faster R-CNN boxes) and a disturbed one on the others:

| without | WildTrack 0-715 | room, 15 people | uneven7 | gmvd8 |
|---|---|---|---|---|
| (all on) | 74.3 | 92.4 | 87.2 | 97.9 |
| misses | 51.8 | 90.7 | 88.1 | 99.0 |
| self-calibration | 70.4 | 87.6 | 80.1 | 57.9 |
| residual field | 72.2 | 87.5 | 83.7 | 81.8 |
| local clutter | 72.3 | 84.3 | 86.5 | 95.3 |
| head and height | 65.2 | 88.7 | 85.2 | 87.7 |
| tracking | 68.8 | 81.5 | 85.1 | 93.0 |
| appearance | 74.3 | 92.4 | 86.7 | 96.7 |
| working area | 65.5 | 90.1 | 86.5 | 97.9 |
| uneven ground | 68.9 | 92.4 | 87.2 | 97.9 |
| one person a place | 74.1 | 91.5 | 87.5 | 97.9 |
| hidden feet | 74.3 | 88.6 | 87.3 | 98.1 |
| doubted feet | 69.7 | 91.3 | 86.1 | 98.2 |
| sure positions | 69.0 | 92.4 | 87.2 | 97.9 |
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from catfree.adapters import read_scenario, read_uniform_json
from catfree.evaluation import align_centres, crop, detection_metrics, tracking_metrics
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
    tracks = locate(detections, sequence.scene, settings).tracks
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
