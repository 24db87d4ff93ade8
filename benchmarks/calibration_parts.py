"""Rigs from parts of a sequence: `python -m benchmarks.calibration_parts DATA --only wildtrack`.

How long must people be recorded, and does it matter when? Every part (halves, thirds, quarters, and
halves that begin in between) is calibrated from its own boxes alone. DATA as in
`benchmarks.methods`; real sequences of more than 100 frames take part, once for each set of boxes.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks.paper.scoring import score, score_rows
from benchmarks.paper.sequences import Sequence, real
from catfree.errors import CatFreeError
from catfree.evaluation import align_centres

PARTS = [
    *[(0.1 * i, 0.1 * i + 0.5) for i in range(6)],
    *[(i / 3, (i + 1) / 3) for i in range(3)],
    *[(i / 4, (i + 1) / 4) for i in range(4)],
]


def part(sequence: Sequence, begin: float, end: float) -> Sequence:
    """Consecutive frames of a sequence, given as shares of its length."""
    first, last = (round(share * len(sequence.frames)) for share in (begin, end))
    frames = sequence.frames[first:last]
    truth = sequence.ground_truth
    return dataclasses.replace(
        sequence,
        name=f"{sequence.name} {frames[0]} to {frames[-1]}",
        detections=sequence.detections[np.isin(sequence.detections.frame, frames)],
        ground_truth=truth[np.isin(truth[:, 0], frames)],
        frames=frames,
    )


def row(sequence: Sequence) -> str:
    """One line of the table."""
    true_rig = sequence.scene.rig
    given = score(cf.localize(sequence.detections, sequence.scene), sequence).moda
    head = f"| {sequence.name} | {len(sequence.frames)} |"
    start = time.process_time()
    try:
        found = cf.calibrate(sequence.detections, np.asarray(true_rig.image_size))
    except CatFreeError as error:
        return f"{head} {error} | - | - | - | {given:.1f} | - |"
    seconds = time.process_time() - start
    rig = found.scene.rig
    known = np.asarray(rig.registered)
    if known.sum() < 3:  # two centres fit any two others
        return f"{head} {known.sum()}/{len(known)} | - | - | - | {given:.1f} | {seconds:.0f} |"
    centers, true_centers = np.asarray(rig.centers), np.asarray(true_rig.centers)
    tracks = cf.localize(sequence.detections, found.scene).tracks
    similarity, rigid = (
        align_centres(centers, true_centers, registered=known, fixed_scale=fixed)
        for fixed in (False, True)
    )
    moda = [
        score_rows(
            tracks.to_rows(np.asarray(align(tracks.position))[:, :2]), sequence, tracking=False
        ).moda
        for align in (similarity, rigid)
    ]
    errors = np.linalg.norm(np.asarray(similarity(centers)) - true_centers, axis=1)[known]
    return (
        f"{head} {known.sum()}/{len(known)} | {errors.mean():.2f} ({errors.max():.2f}) | "
        f"{1 / float(similarity.scale):.3f}, {100 * found.scale_sd:.0f} % | "
        f"{moda[0]:.1f} / {moda[1]:.1f} | {given:.1f} | {seconds:.0f} |"
    )


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    options = parser.parse_args()
    print(
        "| part | frames | cameras | centre error, mean (worst) in m | scale, stated deviation "
        "| MODA, similarity / rigid | MODA, rig given | CPU s |"
    )
    print("|---" * 8 + "|")
    for sequence in real(options.data):
        if options.only in sequence.name and sequence.scene.metric and len(sequence.frames) > 100:
            for begin, end in PARTS:
                print(row(part(sequence, begin, end)), flush=True)


if __name__ == "__main__":
    main()
