"""Compare identities on the same positions: `python -m benchmarks.identities [DATA]`.

`cf.localize` reports positions; each column assigns identities to them anew, without appearance:

- reported: the identities of the evidence method (which uses appearance if there are embeddings);
- plain: a constant-velocity Kalman filter with one assignment per frame, forward only;
- norfair: Norfair's tracker with Kalman filter and Euclidean distance, if installed;
- true: the identity of the nearest true person within the metrics' 1 m, the bound of any linking.

IDF1 is at 1 m, after the similarity of the camera centers if the rig is estimated. Without DATA
(see `benchmarks.methods`), simulated worlds with the seeds `--worlds FIRST END` are compared.
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import catfree as cf
from benchmarks.methods import sequences
from benchmarks.paper.scoring import ground_rows, score_rows
from benchmarks.paper.sequences import Sequence
from catfree.synthetic import DetectorModel, make_layout, make_world
from catfree.synthetic._layouts import ring

SPEED = 0.25  # meters per frame and axis: a stroll at two frames per second, a brisk walk at four
FADE = 0.8  # fraction of a velocity that remains after a frame
NOISE = 0.1  # meters, of a reported position
LONGEST_GAP = 12  # frames
REACH = 1.2  # maximum meters per frame for Norfair
GATE = 16.0  # squared Mahalanobis distance in two dimensions
RADIUS = 1.0  # meters: matching distance of the tracking metrics

Rows = Float[np.ndarray, "m 4"]
Names = Int[np.ndarray, " m"]


def plain_filter(rows: Rows, frames: Int[np.ndarray, " f"]) -> Names:
    """Assign identities by a Kalman filter with fading velocity and one assignment per frame."""
    speed = SPEED**2
    A = np.eye(4) + np.diag([1.0, 1.0], 2)
    A[2, 2] = A[3, 3] = FADE
    Q = np.diag([NOISE**2 / 4] * 2 + [(1 - FADE**2) * speed] * 2)
    mean, cov, gap, name = np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros(0, int), np.zeros(0, int)
    names, count = np.zeros(len(rows), int), 0
    for frame in frames:
        mean, cov, gap = mean @ A.T, A @ cov @ A.T + Q, gap + 1
        here = np.flatnonzero(rows[:, 0] == frame)
        S = cov[:, :2, :2] + NOISE**2 * np.eye(2)
        off = rows[here, 2:] - mean[:, None, :2]
        far = np.einsum("tki,tij,tkj->tk", off, np.linalg.inv(S), off)
        cost = np.minimum(far, GATE) + np.log(np.linalg.det(S))[:, None]
        i, j = linear_sum_assignment(np.where(far < GATE, cost, 1e6))
        i, j = i[far[i, j] < GATE], j[far[i, j] < GATE]
        gain = cov[i, :, :2] @ np.linalg.inv(S[i])
        mean[i] += np.einsum("tij,tj->ti", gain, off[i, j])
        cov[i] -= gain @ cov[i, :2]
        gap[i], names[here[j]] = 0, name[i]
        new = np.setdiff1d(np.arange(len(here)), j)
        names[here[new]] = count + np.arange(len(new))
        start = np.broadcast_to(np.diag([NOISE**2] * 2 + [speed] * 2), (len(new), 4, 4))
        mean = np.concatenate([mean, np.pad(rows[here[new], 2:], [(0, 0), (0, 2)])])
        cov, name = np.concatenate([cov, start]), np.concatenate([name, names[here[new]]])
        gap = np.concatenate([gap, np.zeros(len(new), int)])
        count += len(new)
        alive = gap <= LONGEST_GAP
        mean, cov, gap, name = mean[alive], cov[alive], gap[alive], name[alive]
    return names


def by_norfair(rows: Rows, frames: Int[np.ndarray, " f"]) -> Names | None:
    """Assign identities by Norfair; return None if it is not installed."""
    try:
        from norfair import Detection, Tracker
    except ImportError:
        return None
    tracker = Tracker(
        "euclidean",
        distance_threshold=REACH,
        hit_counter_max=LONGEST_GAP,
        initialization_delay=0,
    )
    names = np.full(len(rows), -1)
    for frame in frames:
        here = np.flatnonzero(rows[:, 0] == frame)
        found = [Detection(rows[i : i + 1, 2:].copy(), data=int(i)) for i in here]
        for person in tracker.update(found):
            if person.last_detection in found:
                names[person.last_detection.data] = person.id
    return _alone(names)


def true_names(rows: Rows, truth: Rows) -> Names:
    """Assign the nearest true person to each row, each person once per frame."""
    names = np.full(len(rows), -1)
    for frame in np.unique(rows[:, 0]):
        here, there = (np.flatnonzero(r[:, 0] == frame) for r in (rows, truth))
        far = cdist(rows[here, 2:], truth[there, 2:])
        i, j = linear_sum_assignment(np.minimum(far, RADIUS))
        near = far[i, j] < RADIUS
        names[here[i[near]]] = truth[there[j[near]], 1]
    return _alone(names)


def _alone(names: Names) -> Names:
    """Give each row without identity (-1) one of its own."""
    without = names < 0
    names[without] = names.max(initial=0) + 1 + np.arange(without.sum())
    return names


LINKERS: dict[str, Callable[[Rows, Sequence], Names | None]] = {
    "reported": lambda rows, _: rows[:, 1].astype(int),
    "plain": lambda rows, sequence: plain_filter(rows, sequence.frames),
    "norfair": lambda rows, sequence: by_norfair(rows, sequence.frames),
    "true": lambda rows, sequence: true_names(rows, sequence.ground_truth),
}


def compare(sequence: Sequence) -> dict[str, float]:
    """Compute MODA, and IDF1 by linker; NaN for linkers that are not installed."""
    tracks = cf.localize(sequence.detections, sequence.scene).tracks
    rows = np.asarray(ground_rows(tracks, sequence), float)
    found = {"MODA": score_rows(rows, sequence).moda}
    for label, link in LINKERS.items():
        names = link(rows, sequence)
        found[label] = np.nan
        if names is not None:
            renamed = np.column_stack([rows[:, 0], names, rows[:, 2:]])
            tracking = score_rows(renamed, sequence).tracking
            assert tracking is not None
            found[label] = float(tracking.idf1)
    return found


def fresh_world(seed: int) -> Sequence:
    """Simulate a world with random place, crowd, frame rate and detector; no embeddings."""
    rng = np.random.default_rng([seed, 91])
    kind = rng.choice(["room", "ring", "wildtrack", "multiviewx", "gmvd6"])
    fps = float(rng.choice([2.0, 3.0, 4.0, 5.0, 7.0, 10.0]))
    if kind == "room":
        layout = ring(4, seed=seed, side=7.0, height=(2.4, 3.0), people=12)
    elif kind == "ring":
        layout = ring(int(rng.integers(4, 7)), seed=seed)
    else:
        layout = make_layout(str(kind), seed)
    people = max(2, int(layout.people * rng.uniform(0.4, 1.3)))
    detector = DetectorModel(
        detection_rate=float(rng.uniform(0.75, 0.98)),
        box_noise=float(rng.uniform(0.01, 0.04)),
        false_positives=float(rng.uniform(0.2, 2)),
        embedding_size=0,
    )
    layout = dataclasses.replace(layout, fps=fps)
    frames = int(np.clip(20 * fps, 50, 120))
    world = make_world(layout, seed, frames=frames, people=people, detector=detector)
    return Sequence.of_world(world, f"{kind} {seed}, {people} people, {fps:g} fps", seed=seed)


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?", help="folder with real/ and scenarios/")
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    parser.add_argument("--worlds", type=int, nargs=2, default=(0, 8), metavar=("FIRST", "END"))
    options = parser.parse_args()
    given = sequences(options.data) if options.data else map(fresh_world, range(*options.worlds))
    print("| sequence | MODA | " + " | ".join(LINKERS) + " |")
    print("|---" * (2 + len(LINKERS)) + "|")
    total = []
    for sequence in given:
        if options.only in sequence.name and sequence.identified:
            found = compare(sequence)
            total.append(list(found.values()))
            cells = " | ".join(f"{value:.1f}" for value in found.values())
            print(f"| {sequence.name} | {cells} |", flush=True)
    print("| mean | " + " | ".join(f"{value:.1f}" for value in np.mean(total, 0)) + " |")


if __name__ == "__main__":
    main()
