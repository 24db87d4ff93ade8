"""Both methods on increasingly degraded input: `python -m benchmarks.robustness [DATA]`.

MODA at 0.5 m. Simulated worlds with the usual disturbed rig, and the scenario folders of DATA. A
rolled camera, a crowd and a worse rig need another world, so scenarios have no such rows.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

import catfree as cf
from benchmarks.paper.scoring import score
from benchmarks.paper.sequences import Sequence, scenarios
from catfree.synthetic import RigError, make_layout, make_world

LAYOUTS = (("ring6", 31), ("wildtrack", 32), ("gmvd8", 33))
FRAMES = 20
K1 = -0.1
CROWD = 80
ROLL = 20.0  # degrees


def simulated(
    layout: str,
    seed: int,
    *,
    people: int | None = None,
    roll: float = 0.0,
    frames: int = FRAMES,
    rig_error: RigError | None = None,
) -> Sequence:
    """A world with the default detector, its first camera rolled by degrees."""
    made = make_layout(layout, seed)
    if roll:
        rig = made.rig
        c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        R, t = np.array(rig.R), np.array(rig.t)
        R[0], t[0] = turn @ R[0], turn @ t[0]
        made = dataclasses.replace(made, rig=cf.Rig(rig.K, R, t, rig.image_size))
    world = make_world(made, seed, frames=frames, people=people, rig_error=rig_error)
    return Sequence.of_world(world, f"{layout} {seed}")


def thinned(sequence: Sequence, share: float) -> Sequence:
    """Only this share of the boxes, drawn at random."""
    chosen = np.random.default_rng(0).random(len(sequence.detections)) < share
    return dataclasses.replace(sequence, detections=sequence.detections[chosen])


def with_false_boxes(sequence: Sequence, share: float) -> Sequence:
    """Boxes of nobody, so many that they are this share of all: shapes and looks of real ones."""
    boxes, rig = sequence.detections, sequence.scene.rig
    rng = np.random.default_rng(1)
    count = round(len(boxes) * share / (1 - share))
    like = boxes[rng.integers(len(boxes), size=count)]
    size = np.asarray(rig.image_size, float)[like.camera]
    extent = like.box[:, 2:] - like.box[:, :2]
    corner = rng.random((count, 2)) * np.maximum(size - extent, 1)
    moved = dataclasses.replace(
        like,
        frame=rng.choice(np.unique(boxes.frame), count),
        box=np.hstack([corner, corner + extent]),
    )

    def both(name: str) -> np.ndarray | None:
        old, new = getattr(boxes, name), getattr(moved, name)
        return None if old is None else np.concatenate([old, new])

    names = [field.name for field in dataclasses.fields(boxes)]
    return dataclasses.replace(
        sequence, detections=cf.Detections(**{name: both(name) for name in names})
    )


def with_dropped_frames(sequence: Sequence, share: float) -> Sequence:
    """One camera delivers nothing in this share of the frames."""
    boxes, frames = sequence.detections, np.unique(sequence.detections.frame)
    count = max(1, round(share * len(frames)))
    lost = np.random.default_rng(2).choice(frames, count, replace=False)
    keep = ~((boxes.camera == 1) & np.isin(boxes.frame, lost))
    return dataclasses.replace(sequence, detections=boxes[keep])


def distorted(sequence: Sequence, k1: float, *, known: bool) -> Sequence:
    """Boxes as lenses with radial distortion k1 show them; the rig knows of it or not."""
    boxes, scene = sequence.detections, sequence.scene
    box = bent(boxes.box, np.asarray(scene.rig.K)[boxes.camera], k1)
    rig = scene.rig
    if known:
        lens = np.tile([k1, 0.0, 0.0, 0.0, 0.0], (rig.camera_count, 1))
        rig = cf.Rig(rig.K, rig.R, rig.t, rig.image_size, lens, rig.registered)
    return dataclasses.replace(
        sequence,
        detections=dataclasses.replace(boxes, box=box),
        scene=dataclasses.replace(scene, rig=rig),
    )


def bent(
    box: Float[np.ndarray, "n 4"], K: Float[np.ndarray, "n 3 3"], k1: float
) -> Float[np.ndarray, "n 4"]:
    """Boxes as a lens shows them: edges of the box through the distorted middles of its sides."""
    middle = (box[:, :2] + box[:, 2:]) / 2

    def moved(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = (u - K[:, 0, 2]) / K[:, 0, 0], (v - K[:, 1, 2]) / K[:, 1, 1]
        factor = 1 + k1 * (x**2 + y**2)
        return x * factor * K[:, 0, 0] + K[:, 0, 2], y * factor * K[:, 1, 1] + K[:, 1, 2]

    left, right = moved(box[:, 0], middle[:, 1])[0], moved(box[:, 2], middle[:, 1])[0]
    top, bottom = moved(middle[:, 0], box[:, 1])[1], moved(middle[:, 0], box[:, 3])[1]
    return np.stack([left, top, right, bottom], axis=-1)


CHANGES: dict[str, Callable[[Sequence], Sequence]] = {
    "as it is": lambda s: s,
    "75 % of the boxes": lambda s: thinned(s, 0.75),
    "50 % of the boxes": lambda s: thinned(s, 0.5),
    "15 % false boxes": lambda s: with_false_boxes(s, 0.15),
    "30 % false boxes": lambda s: with_false_boxes(s, 0.3),
    "5 % of a camera's frames lost": lambda s: with_dropped_frames(s, 0.05),
    "lenses k1 = -0.1, corrected": lambda s: distorted(s, K1, known=True),
    "lenses k1 = -0.1, not corrected": lambda s: distorted(s, K1, known=False),
}


def cases(data: Path | None) -> Iterator[tuple[str, Sequence]]:
    """Every case of every sequence by name."""
    for layout, seed in LAYOUTS:
        for name, change in CHANGES.items():
            yield name, change(simulated(layout, seed))
        yield "a camera rolled by 20°", simulated(layout, seed, roll=ROLL)
        yield f"{CROWD} people", simulated(layout, seed, people=CROWD)
        for degrees in (1.0, 2.0):
            turned = RigError(rotation_deg=degrees)
            yield f"cameras off by {degrees:.0f}°", simulated(layout, seed, rig_error=turned)
    for sequence in scenarios(data) if data else ():
        for name, change in CHANGES.items():
            yield name, change(sequence)


def modas(sequence: Sequence) -> tuple[float, float]:
    """MODA of the paper's method and of the evidence method."""
    paper, evidence = (
        score(cf.localize(sequence.detections, sequence.scene, settings), sequence).moda
        for settings in (cf.Settings.paper(), cf.Settings())
    )
    return paper, evidence


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default="", help="only sequences whose name contains this")
    options = parser.parse_args()
    print("| sequence | case | paper | evidence |\n|---|---|---|---|")
    for name, sequence in cases(options.data):
        if options.only in sequence.name:
            paper, evidence = modas(sequence)
            mark = " (below)" if evidence < paper else ""
            print(f"| {sequence.name} | {name} | {paper:.1f} | {evidence:.1f}{mark} |", flush=True)


if __name__ == "__main__":
    main()
