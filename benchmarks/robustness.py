"""Run both methods on increasingly degraded input: `python -m benchmarks.robustness [DATA]`.

Prints MODA at 0.5 m for simulated worlds with the usual disturbed rig, and for the scenario folders
of DATA. A rolled camera, a crowd and a worse rig need another world, so scenarios lack these rows.
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
CUT = 0.004  # fraction of the width: boxes closer to the border are cut
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
    """Simulate a world with the default detector, its first camera rolled by degrees."""
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
    """Keep only this share of the boxes, drawn at random."""
    chosen = np.random.default_rng(0).random(len(sequence.detections)) < share
    return dataclasses.replace(sequence, detections=sequence.detections[chosen])


def with_false_boxes(sequence: Sequence, share: float) -> Sequence:
    """Add false boxes up to this share of all, with shapes and appearance of real ones."""
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
    """Drop all boxes of one camera in this share of the frames."""
    boxes, frames = sequence.detections, np.unique(sequence.detections.frame)
    count = max(1, round(share * len(frames)))
    lost = np.random.default_rng(2).choice(frames, count, replace=False)
    keep = ~((boxes.camera == 1) & np.isin(boxes.frame, lost))
    return dataclasses.replace(sequence, detections=boxes[keep])


def distorted(sequence: Sequence, k1: float, *, known: bool) -> Sequence:
    """Distort boxes by lenses with radial distortion k1, known to the rig or not."""
    boxes, rig = through_lenses(sequence.detections, sequence.scene.rig, k1)
    if not known:
        rig = cf.Rig(rig.K, rig.R, rig.t, rig.image_size, registered=rig.registered)
    scene = dataclasses.replace(sequence.scene, rig=rig)
    return dataclasses.replace(sequence, detections=boxes, scene=scene)


def through_lenses(boxes: cf.Detections, rig: cf.Rig, k1: float) -> tuple[cf.Detections, cf.Rig]:
    """Convert boxes and rig to cameras with the same view and radial distortion k1.

    Each picture is the smallest that contains all of the old one: in a larger one, people outside
    the old view would have no box, as if the detector missed them. Boxes cut at the old border end
    at the new one.

    Args:
        boxes: boxes in pictures without distortion.
        rig: cameras of the boxes.
        k1: radial distortion; must keep points at the border in order.
    """
    K, size = np.array(rig.K, np.float64), np.asarray(rig.image_size, np.float64)
    low, high = np.empty(size.shape), np.empty(size.shape)
    for camera, (width, height) in enumerate(size):
        x, y = (np.linspace(0, 1, 200) * side - 0.5 for side in (width, height))
        sides = [
            (x, 0 * x - 0.5),
            (x, 0 * x + height - 0.5),
            (0 * y - 0.5, y),
            (0 * y + width - 0.5, y),
        ]
        u, v = np.concatenate(sides, axis=1)
        border = np.stack(_moved(u, v, K[camera][None], k1))
        low[camera], high[camera] = border.min(1), border.max(1)
    corner = np.round(low + 0.5)
    bent_size = np.round(high + 0.5) - corner
    old, camera = np.asarray(boxes.box, np.float64), boxes.camera
    limit = bent_size[camera] - 0.5
    box = bent(old, K[camera], k1) - np.tile(corner[camera], 2)
    box = np.clip(box, -0.5, np.tile(limit, 2))
    near = CUT * size[camera, 0]
    for axis in (0, 1):
        box[old[:, axis] < near, axis] = -0.5
        ends = old[:, axis + 2] > size[camera, axis] - 1 - near
        box[ends, axis + 2] = limit[ends, axis]
    # A sliver at the border remains one pixel wide.
    box[:, :2] = np.minimum(box[:, :2], limit - 1)
    box[:, 2:] = np.maximum(box[:, 2:], box[:, :2] + 1)
    K[:, :2, 2] -= corner
    lens = np.tile([k1, 0.0, 0.0, 0.0, 0.0], (len(K), 1))
    cameras = cf.Rig(K, rig.R, rig.t, bent_size.astype(np.int64), lens, rig.registered)
    return dataclasses.replace(boxes, box=box), cameras


def bent(
    box: Float[np.ndarray, "n 4"], K: Float[np.ndarray, "n 3 3"], k1: float
) -> Float[np.ndarray, "n 4"]:
    """Distort boxes; edges pass through the distorted middles of the sides."""
    middle = (box[:, :2] + box[:, 2:]) / 2
    left, right = (_moved(box[:, side], middle[:, 1], K, k1)[0] for side in (0, 2))
    top, bottom = (_moved(middle[:, 0], box[:, side], K, k1)[1] for side in (1, 3))
    return np.stack([left, top, right, bottom], axis=-1)


def _moved(
    u: np.ndarray, v: np.ndarray, K: Float[np.ndarray, "n 3 3"], k1: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distort pixels."""
    x, y = (u - K[:, 0, 2]) / K[:, 0, 0], (v - K[:, 1, 2]) / K[:, 1, 1]
    factor = 1 + k1 * (x**2 + y**2)
    return x * factor * K[:, 0, 0] + K[:, 0, 2], y * factor * K[:, 1, 1] + K[:, 1, 2]


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
    """Yield every case of every sequence by name."""
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
    """Compute MODA of the paper's method and of the evidence method."""
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
