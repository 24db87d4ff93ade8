"""The two methods on every sequence of a data folder: `python benchmarks/methods.py DATA`.

DATA holds `real/*.json` (uniform JSON) and `scenarios/*/` as the readers of catfree take them. Real
sequences use the true calibration; scenarios are localized with their disturbed rig and aligned by
a similarity of the camera centres. Predictions outside the evaluation area are not counted.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import catfree as cf
from catfree.adapters import MultiViewSequence, read_scenario, read_uniform_json
from catfree.errors import CatFreeError


def sequences(folder: Path) -> Iterator[tuple[str, MultiViewSequence]]:
    """Every readable sequence of the folder, with each set of boxes and embeddings it holds."""
    for path in sorted(folder.glob("real/*.json")):
        for label, options in (
            ("", {}),
            (" FairMOT", {"views": "views_fairmot"}),
            (" OSNet", {"embedding": "osnet"}),
        ):
            try:
                sequence = read_uniform_json(path, **options)
            except CatFreeError:
                continue  # this file has no such boxes or embeddings
            if len(sequence.ground_truth) and sequence.scene is not None:
                yield path.stem + label, sequence
    for path in sorted(folder.glob("scenarios/*/rig.json")):
        sequence = read_scenario(path.parent)
        yield sequence.name, sequence
        boxes = sequence.detections
        bare = cf.Detections(
            boxes.frame, boxes.camera, boxes.box, boxes.score, boxes.ankles_confirmed
        )
        yield sequence.name + " (no embeddings)", dataclasses.replace(sequence, detections=bare)


def ground_rows(sequence: MultiViewSequence, tracks: cf.Tracks) -> np.ndarray:
    """Track rows in the frame of the ground truth."""
    assert sequence.scene is not None
    if sequence.scene.metric or sequence.true_centres is None:
        return tracks.to_rows()
    align = cf.evaluation.align_centres(sequence.scene.rig.centers, sequence.true_centres)
    return tracks.to_rows(np.asarray(align(tracks.position))[:, :2])


def score(sequence: MultiViewSequence, settings: cf.Settings) -> dict[str, float]:
    """Metrics and seconds of one run."""
    assert sequence.scene is not None
    start = time.process_time()
    result = cf.localize(sequence.detections, sequence.scene, settings)
    seconds = time.process_time() - start
    rows, truth = ground_rows(sequence, result.tracks), sequence.ground_truth
    if sequence.evaluation_area is not None:
        rows = cf.evaluation.crop(rows, sequence.evaluation_area)
        truth = cf.evaluation.crop(truth, sequence.evaluation_area)
    found = cf.evaluation.detection_metrics(truth, rows, sequence.frames)
    scores = {"MODA": found.moda, "precision": found.precision, "recall": found.recall}
    if (truth[:, 1] >= 0).all():
        scores["IDF1"] = cf.evaluation.tracking_metrics(truth, rows, sequence.frames).idf1
        scores["HOTA"] = cf.evaluation.hota(truth, rows, sequence.frames).hota
    return scores | {"CPU s": seconds}


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    options = parser.parse_args()
    columns = ["MODA", "precision", "recall", "IDF1", "HOTA", "CPU s"]
    print("| sequence | method | " + " | ".join(columns) + " |")
    print("|---" * (2 + len(columns)) + "|")
    for name, sequence in sequences(options.data):
        if options.only not in name:
            continue
        for method, settings in (("paper", cf.Settings.paper()), ("evidence", cf.Settings())):
            values = score(sequence, settings)
            cells = [f"{values[c]:.1f}" if c in values else "-" for c in columns]
            print(f"| {name} | {method} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
