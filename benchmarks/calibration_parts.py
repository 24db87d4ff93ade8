"""Rigs from parts of a sequence: `python -m benchmarks.calibration_parts DATA --only wildtrack`.

Tests how the length and the time of recording matter. Each part (halves, thirds, quarters, and
halves that begin in between) is calibrated from its own boxes alone. DATA as in
`benchmarks.methods`; uses real sequences of more than 100 frames, once per set of boxes.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float

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
    """Select consecutive frames of a sequence, given as fractions of its length."""
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


@dataclasses.dataclass(frozen=True)
class Recovered:
    """A rig from people alone compared with the true one, and the result of localizing with it.

    Attributes:
        registered: number of registered cameras.
        cameras: number of all cameras.
        center_error: (registered,) distance to the true centers in meters after a similarity;
            empty, and the following values NaN, for fewer than three cameras: two centers fit any
            two others.
        scale: estimated length of a true meter.
        scale_sd: stated standard deviation of the scale.
        moda_similarity: MODA in percent after a similarity of the camera centers.
        moda_rigid: the same, keeping the estimated scale.
        seconds: CPU time of the calibration.
    """

    registered: int
    cameras: int
    center_error: Float[np.ndarray, " r"]
    scale: float
    scale_sd: float
    moda_similarity: float
    moda_rigid: float
    seconds: float


def recover(sequence: Sequence) -> Recovered:
    """Calibrate from the boxes of a sequence alone, localize, and score both.

    Raises:
        CatFreeError: if the calibration fails.
    """
    start = time.process_time()
    found = cf.calibrate(sequence.detections, np.asarray(sequence.scene.rig.image_size))
    seconds = time.process_time() - start
    rig = found.scene.rig
    known = np.asarray(rig.registered)
    count = int(known.sum())
    if count < 3:
        nothing = (np.zeros(0), np.nan, found.scale_sd, np.nan, np.nan)
        return Recovered(count, len(known), *nothing, seconds)
    true = sequence.scene.rig.centers if sequence.true_centres is None else sequence.true_centres
    centers, true = np.asarray(rig.centers), np.asarray(true)
    tracks = cf.localize(sequence.detections, found.scene).tracks
    similarity, rigid = (
        align_centres(centers, true, registered=known, fixed_scale=fixed) for fixed in (False, True)
    )
    moda = [
        score_rows(
            tracks.to_rows(np.asarray(align(tracks.position))[:, :2]), sequence, tracking=False
        ).moda
        for align in (similarity, rigid)
    ]
    errors = np.linalg.norm(np.asarray(similarity(centers)) - true, axis=1)[known]
    scale = 1 / float(similarity.scale)
    return Recovered(count, len(known), errors, scale, found.scale_sd, *moda, seconds)


def row(sequence: Sequence) -> str:
    """Format one line of the table."""
    given = score(cf.localize(sequence.detections, sequence.scene), sequence).moda
    head = f"| {sequence.name} | {len(sequence.frames)} |"
    try:
        found = recover(sequence)
    except CatFreeError as error:
        return f"{head} {error} | - | - | - | {given:.1f} | - |"
    head += f" {found.registered}/{found.cameras} |"
    if not len(found.center_error):
        return f"{head} - | - | - | {given:.1f} | {found.seconds:.0f} |"
    return (
        f"{head} {found.center_error.mean():.2f} ({found.center_error.max():.2f}) | "
        f"{found.scale:.3f}, {100 * found.scale_sd:.0f} % | "
        f"{found.moda_similarity:.1f} / {found.moda_rigid:.1f} | {given:.1f} | "
        f"{found.seconds:.0f} |"
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
