"""Run both methods on every sequence of a data folder: `python -m benchmarks.methods DATA`.

DATA holds `real/*.json` (uniform JSON) and `scenarios/*/` in the formats that catfree reads. Real
sequences use the true calibration; scenarios are localized with their disturbed rig and aligned by
a similarity of the camera centers. Predictions outside the evaluation area are ignored.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import catfree as cf
from benchmarks.paper.scoring import score
from benchmarks.paper.sequences import Sequence, real, scenarios, without_embeddings

COLUMNS = ("MODA", "precision", "recall", "IDF1", "HOTA", "CPU s")


def sequences(folder: Path) -> Iterator[Sequence]:
    """Yield every readable sequence of the folder, once per set of boxes and embeddings."""
    yield from real(folder)
    for sequence in scenarios(folder):
        yield sequence
        yield without_embeddings(sequence)


def measure(sequence: Sequence, settings: cf.Settings) -> dict[str, float]:
    """Compute metrics and CPU seconds of one run, by name of the column."""
    start = time.process_time()
    result = cf.localize(sequence.detections, sequence.scene, settings)
    seconds = time.process_time() - start
    found = score(result, sequence)
    rates = found.detection
    scores = {"MODA": rates.moda, "precision": rates.precision, "recall": rates.recall}
    if found.tracking is not None and found.hota is not None:
        scores |= {"IDF1": found.tracking.idf1, "HOTA": found.hota.hota}
    return {name: float(value) for name, value in scores.items()} | {"CPU s": seconds}


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    options = parser.parse_args()
    print("| sequence | method | " + " | ".join(COLUMNS) + " |")
    print("|---" * (2 + len(COLUMNS)) + "|")
    for sequence in sequences(options.data):
        if options.only not in sequence.name:
            continue
        for method, settings in (("paper", cf.Settings.paper()), ("evidence", cf.Settings())):
            values = measure(sequence, settings)
            cells = [f"{values[c]:.1f}" if c in values else "-" for c in COLUMNS]
            row = " | ".join(cells)
            print(f"| {sequence.name} | {method} | {row} |", flush=True)


if __name__ == "__main__":
    main()
