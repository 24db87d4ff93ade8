"""Scores of the evidence method with each ingredient switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]
    python benchmarks/evidence_ablation.py --constants DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`). Measured: MODA,
and IDF1 after the slash, with the true rig on the first two (the room with Faster R-CNN boxes)
and a disturbed one on the others:

| without | WildTrack 0-715 | room, 15 people | uneven7 | gmvd8 |
|---|---|---|---|---|
| (all on) | 74.6 | 92.9 / 66.2 | 88.6 / 94.4 | 99.0 / 99.6 |
| misses | 48.5 | 72.6 / 56.4 | 88.4 / 94.2 | 98.6 / 99.4 |
| self-calibration | 73.0 | 88.2 / 53.5 | 83.5 / 91.8 | 67.0 / 80.5 |
| residual field | 72.6 | 87.5 / 49.0 | 85.2 / 93.0 | 89.7 / 94.7 |
| local clutter | 73.1 | 86.8 / 73.9 | 87.4 / 93.6 | 97.7 / 98.9 |
| head and height | 66.1 | 90.1 / 53.4 | 87.4 / 93.6 | 95.2 / 98.3 |
| tracking | 67.0 | 79.8 / 0.5 | 85.2 / 5.3 | 93.7 / 3.6 |
| appearance | 74.6 | 92.9 / 66.2 | 87.6 / 93.6 | 97.1 / 97.9 |
| appearance over time | 74.6 | 92.9 / 66.2 | 87.7 / 93.7 | 98.2 / 99.3 |
| working area | 65.6 | 90.1 / 63.0 | 88.0 / 95.8 | 99.0 / 99.6 |
| uneven ground | 57.5 | 92.9 / 67.7 | 87.2 / 96.4 | 99.0 / 99.6 |
| one person a place | 74.6 | 91.9 / 66.6 | 88.6 / 94.4 | 99.0 / 99.6 |
| hidden feet | 75.1 | 90.4 / 66.1 | 88.4 / 94.3 | 99.0 / 99.5 |
| doubted feet | 68.2 | 91.7 / 62.8 | 87.9 / 94.1 | 99.0 / 99.5 |
| sure positions | 57.3 | 92.9 / 66.2 | 87.2 / 96.1 | 99.0 / 99.6 |
"""

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from catfree.adapters import read_scenario, read_uniform_json
from catfree.evaluation import align_centres, crop, detection_metrics, tracking_metrics
from catfree.evaluation._rows import Sequence
from catfree.methods.evidence import EvidenceSettings, localize_by_evidence

EFFECTS = Path(__file__).parents[1] / "docs" / "evidence_effects.json"

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


def localized(sequence: Sequence, settings: EvidenceSettings) -> tuple[float, float | None]:
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
    moda = detection_metrics(truth, rows, frames=sequence.frames).moda
    named = (truth[:, 1] >= 0).all()
    return moda, tracking_metrics(truth, rows, sequence.frames).idf1 if named else None


def scores(sequence: Sequence, settings: EvidenceSettings) -> str:
    """A cell of the table of ingredients."""
    moda, idf1 = localized(sequence, settings)
    return f"{moda:.1f}" if idf1 is None else f"{moda:.1f} / {idf1:.1f}"


def scaled(value: object, factor: float) -> object:
    """A constant times a factor; shares and probabilities stay below one."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    assert isinstance(value, float)
    return min(value * factor, 0.999) if value < 1 else value * factor


def effects(sequences: list[Sequence]) -> dict[str, list[float]]:
    """Mean change of MODA with each constant halved and doubled."""
    usual = EvidenceSettings()
    before = np.array([localized(sequence, usual)[0] for sequence in sequences])
    found: dict[str, list[float]] = {}
    for field in dataclasses.fields(EvidenceSettings):
        if field.metadata:
            found[field.name] = []
            for factor in (0.5, 2.0):
                change = {field.name: scaled(field.default, factor)}
                settings = dataclasses.replace(usual, **change)
                after = [localized(sequence, settings)[0] for sequence in sequences]
                found[field.name].append(round(float(np.mean(after - before)), 2))
            print(field.name, *found[field.name], flush=True)
    return found


def main() -> None:
    """Print one row per switch and one column per data set, or measure every constant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--embedding", default=None, help="embedding of a uniform JSON file")
    parser.add_argument(
        "--constants", action="store_true", help="write the effect of each constant"
    )
    options = parser.parse_args()
    sequences = [
        read_scenario(path)
        if path.is_dir()
        else read_uniform_json(path, embedding=options.embedding)
        for path in options.data
    ]
    if options.constants:
        measured = json.loads(EFFECTS.read_text("utf-8")) | {"moda": effects(sequences)}
        EFFECTS.write_text(json.dumps(measured, indent=1) + "\n", "utf-8")
        return
    print("| without | " + " | ".join(s.name for s in sequences) + " |")
    print("|---" * (1 + len(sequences)) + "|")
    for name, change in WITHOUT.items():
        settings = dataclasses.replace(EvidenceSettings(), **change)
        cells = [scores(sequence, settings) for sequence in sequences]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
