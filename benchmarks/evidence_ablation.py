"""Score the evidence method with each ingredient switched off.

    python benchmarks/evidence_ablation.py DATA [DATA ...]
    python benchmarks/evidence_ablation.py --constants DATA [DATA ...]

Each DATA is a uniform JSON file or a scenario folder (see `catfree.adapters`). Measured: MODA, and
IDF1 after the slash, with the true rig on the first two (the room with Faster R-CNN boxes) and a
disturbed rig on the others:

| without | WildTrack 0-715 | room, 15 people | uneven7 | gmvd8 |
|---|---|---|---|---|
| (all on) | 74.8 | 93.9 / 74.0 | 92.2 / 96.0 | 99.4 / 99.7 |
| misses | 52.6 | 77.1 / 64.1 | 91.3 / 95.4 | 99.3 / 99.7 |
| self-calibration | 74.6 | 92.2 / 69.0 | 84.2 / 92.0 | 68.4 / 81.5 |
| residual field | 73.8 | 90.4 / 58.4 | 84.9 / 93.4 | 92.7 / 96.7 |
| local clutter | 73.8 | 86.8 / 73.0 | 90.8 / 95.2 | 97.6 / 98.8 |
| head and height | 60.1 | 91.9 / 57.1 | 90.9 / 94.9 | 94.8 / 97.6 |
| tracking | 67.7 | 79.3 / 0.5 | 89.5 / 5.4 | 93.8 / 3.6 |
| appearance | 74.8 | 93.9 / 74.0 | 91.3 / 95.1 | 97.1 / 97.7 |
| appearance over time | 74.8 | 93.9 / 74.0 | 91.9 / 95.8 | 99.3 / 99.6 |
| working area | 66.3 | 90.9 / 73.0 | 94.8 / 97.3 | 99.4 / 99.7 |
| uneven ground | 58.5 | 93.9 / 77.1 | 94.7 / 97.8 | 99.4 / 99.7 |
| one person a place | 74.5 | 92.2 / 67.4 | 91.5 / 94.8 | 99.5 / 99.7 |
| hidden feet | 76.5 | 91.5 / 61.5 | 91.8 / 95.7 | 99.4 / 99.7 |
| doubted feet | 64.2 | 91.3 / 64.6 | 92.0 / 95.8 | 99.2 / 99.7 |
| sure positions | 58.4 | 93.9 / 74.0 | 95.2 / 98.0 | 99.4 / 99.7 |
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
    """Compute MODA at 0.5 m in the evaluation area, and IDF1 if people have identities."""
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
    """Format a cell of the table of ingredients."""
    moda, idf1 = localized(sequence, settings)
    return f"{moda:.1f}" if idf1 is None else f"{moda:.1f} / {idf1:.1f}"


def scaled(value: object, factor: float) -> object:
    """Multiply a constant by a factor; shares and probabilities stay below one."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    assert isinstance(value, float)
    return min(value * factor, 0.999) if value < 1 else value * factor


def effects(sequences: list[Sequence]) -> dict[str, list[float]]:
    """Compute the mean change of MODA with each constant halved and doubled."""
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
