"""Find rigs that are confident but wrong, from boxes that break an assumption.

Each draw is a simulated world whose boxes are spoiled in one way. A rig is calibrated from them and
people are tracked with it; the largest error of a camera center after a similarity is compared with
the label-free expectation of MODA. `python -m benchmarks.adversarial [--draws N]` prints one row
per draw, a table by kind, and every draw whose rig is off by more than 1 m although the expectation
is above 70: there must be none.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

import catfree as cf
from benchmarks.robustness import bent
from catfree.evaluation import detection_metrics_in_area
from catfree.geometry import fit_similarity
from catfree.synthetic import DetectorModel, World, make_world

LAYOUTS = ("ring5", "ring6", "ring4", "wildtrack", "ring7", "gmvd6")
FRAMES = 100
OFF = 1.0  # meters
SURE = 70.0  # percent


@dataclass(frozen=True)
class Input:
    """Input of a calibration, and the truth.

    Attributes:
        boxes: boxes of all cameras.
        size: (C, 2) stated image widths and heights.
        centers: (C, 3) true camera centers in meters.
        truth: (N, 4) frame, identity and ground position of everyone to be found.
        world: source of the boxes.
    """

    boxes: cf.Detections
    size: Int[np.ndarray, "cam 2"]
    centers: Float[np.ndarray, "cam 3"]
    truth: Float[np.ndarray, "n 4"]
    world: World

    def with_boxes(self, boxes: cf.Detections) -> "Input":
        """Replace the boxes."""
        return dataclasses.replace(self, boxes=boxes)


Spoiler = Callable[[Input, np.random.Generator], Input]


def _some(given: Input, rng: np.random.Generator, count: int) -> Int[np.ndarray, " chosen"]:
    return rng.permutation(len(given.size))[:count]


def _at_times(given: Input, camera: int, times: Int[np.ndarray, " frame"]) -> Input:
    """Move the frames of one camera to other times, dropping those at negative times."""
    boxes = given.boxes
    mine = boxes.camera == camera
    frame = np.where(mine, times[boxes.frame], boxes.frame)
    return given.with_boxes(dataclasses.replace(boxes, frame=frame)[frame >= 0])


def _late(given: Input, rng: np.random.Generator, cameras: int) -> Input:
    delay = round(rng.uniform(0.75, 1.25) * given.world.layout.fps)
    for camera in _some(given, rng, cameras):
        frames = np.arange(len(given.world.walkers.position))
        given = _at_times(given, int(camera), np.where(frames >= delay, frames - delay, -1))
    return given


def _bent(given: Input, rng: np.random.Generator, k1: float, *, one: bool = False) -> Input:
    boxes, rig = given.boxes, given.world.true_rig
    chosen = boxes.camera == _some(given, rng, 1)[0] if one else np.ones(len(boxes), bool)
    box = bent(boxes.box, np.asarray(rig.K)[boxes.camera], k1)
    return given.with_boxes(
        dataclasses.replace(boxes, box=np.where(chosen[:, None], box, boxes.box))
    )


def _lowered(given: Input, rng: np.random.Generator) -> Input:
    """Replace the crowd by children: every box has 0.7 of its height and width."""
    box = np.array(given.boxes.box)
    middle, half = (box[:, 0] + box[:, 2]) / 2, 0.35 * (box[:, 2] - box[:, 0])
    box[:, 0], box[:, 2] = middle - half, middle + half
    box[:, 1] = box[:, 3] - 0.7 * (box[:, 3] - box[:, 1])
    return given.with_boxes(dataclasses.replace(given.boxes, box=box))


def _bumped(given: Input, rng: np.random.Generator) -> Input:
    """Turn one camera by 60 pixels halfway."""
    boxes, angle = given.boxes, rng.uniform(0, 2 * np.pi)
    later = boxes.frame >= len(given.world.walkers.position) // 2
    moved = later & (boxes.camera == _some(given, rng, 1)[0])
    step = 60 * np.array([np.cos(angle), np.sin(angle)] * 2)
    return given.with_boxes(dataclasses.replace(boxes, box=boxes.box + moved[:, None] * step))


def _twice(given: Input, rng: np.random.Generator) -> Input:
    """Pass one camera as two."""
    camera = int(_some(given, rng, 1)[0])
    again = given.boxes[given.boxes.camera == camera]
    parts = (given.boxes, dataclasses.replace(again, camera=again.camera * 0 + len(given.size)))
    frame, cameras, box = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("frame", "camera", "box")
    )
    return dataclasses.replace(
        given,
        boxes=cf.Detections(frame, cameras, box),
        size=np.append(given.size, given.size[[camera]], 0),
        centers=np.append(given.centers, given.centers[[camera]], 0),
    )


def _on_a_line(given: Input, rng: np.random.Generator) -> Input:
    """Keep only people in a strip 0.8 m wide, while they are in it."""
    walkers, who = given.world.walkers, given.world.identities
    across = rng.normal(size=2)
    across /= np.linalg.norm(across)
    place = walkers.position[given.boxes.frame, np.maximum(who, 0)] @ across
    given = given.with_boxes(given.boxes[(who >= 0) & (np.abs(place) < 0.4)])
    inside = np.abs(given.truth[:, 2:] @ across) < 0.4
    return dataclasses.replace(given, truth=given.truth[inside])


def _few_frames(given: Input, rng: np.random.Generator) -> Input:
    return given.with_boxes(given.boxes[given.boxes.frame < 30])


def _swapped_sizes(given: Input, rng: np.random.Generator) -> Input:
    """Swap the image sizes of two cameras, one of which is half as large."""
    one, other = _some(given, rng, 2)
    boxes, size = given.boxes, given.size.copy()
    scale = np.where(boxes.camera == one, 0.5, 1.0)
    size[other] //= 2
    return dataclasses.replace(
        given, boxes=dataclasses.replace(boxes, box=boxes.box * scale[:, None]), size=size
    )


def _shuffled(given: Input, rng: np.random.Generator) -> Input:
    frames = rng.permutation(len(given.world.walkers.position))
    return _at_times(given, int(_some(given, rng, 1)[0]), frames)


def _mirrored(given: Input, rng: np.random.Generator) -> Input:
    camera = _some(given, rng, 1)[0]
    box = np.array(given.boxes.box)
    mine = given.boxes.camera == camera
    box[mine, 0], box[mine, 2] = (given.size[camera, 0] - 1 - box[mine, i] for i in (2, 0))
    return given.with_boxes(dataclasses.replace(given.boxes, box=box))


def _drifting(given: Input, rng: np.random.Generator) -> Input:
    """Drop every n-th frame of one camera's recorder, so that it falls behind."""
    frames = np.arange(len(given.world.walkers.position))
    every = int(rng.integers(15, 50))
    times = np.where(frames % every == every - 1, -1, frames - frames // every)
    return _at_times(given, int(_some(given, rng, 1)[0]), times)


def _portrait(given: Input, rng: np.random.Generator) -> Input:
    """Crop every camera's picture to its upright middle."""
    boxes, size = given.boxes, given.size.copy()
    size[:, 0] = np.minimum(size[:, 0], size[:, 1] * 9 // 16)
    left = ((given.size - size)[:, 0] // 2)[boxes.camera]
    box = np.array(boxes.box)
    box[:, ::2] = np.clip(box[:, ::2] - left[:, None], 0, size[boxes.camera, :1] - 1)
    whole = (box[:, 2] - box[:, 0]) > 0.5 * (boxes.box[:, 2] - boxes.box[:, 0])
    given = given.with_boxes(dataclasses.replace(boxes[whole], box=box[whole]))
    return dataclasses.replace(given, size=size)


def _standing(given: Input, rng: np.random.Generator) -> Input:
    """Let everyone stand, and walk to another place at most once."""
    frames = len(given.world.walkers.position)
    half, parts, truth = frames // 2, [], []
    for frame in range(frames):
        begun = frame // half * half
        now = given.boxes[given.boxes.frame == begun]
        shake = rng.normal(scale=1.0, size=now.box.shape)
        parts.append(dataclasses.replace(now, frame=now.frame * 0 + frame, box=now.box + shake))
        rows = given.truth[given.truth[:, 0] == begun].copy()
        rows[:, 0] = frame
        truth.append(rows)
    frame, camera, box = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("frame", "camera", "box")
    )
    return dataclasses.replace(
        given, boxes=cf.Detections(frame, camera, box), truth=np.concatenate(truth)
    )


def _unspoiled(given: Input, rng: np.random.Generator) -> Input:
    return given


SPOILERS: dict[str, tuple[Spoiler, int | None]] = {
    "bent -0.3": (lambda g, r: _bent(g, r, -0.3), None),
    "one late": (lambda g, r: _late(g, r, 1), None),
    "two late": (lambda g, r: _late(g, r, 2), None),
    "bumped": (_bumped, None),
    "bent -0.15": (lambda g, r: _bent(g, r, -0.15), None),
    "one bent": (lambda g, r: _bent(g, r, -0.3, one=True), None),
    "children": (_lowered, None),
    "given twice": (_twice, None),
    "on a line": (_on_a_line, None),
    "30 frames": (_few_frames, None),
    "sizes swapped": (_swapped_sizes, None),
    "drifting": (_drifting, None),
    "shuffled": (_shuffled, None),
    "mirrored": (_mirrored, None),
    "portrait": (_portrait, None),
    "standing crowd": (_standing, None),
    "one person": (_unspoiled, 1),
    "two people": (_unspoiled, 2),
    "unspoiled": (_unspoiled, None),
}


@dataclass(frozen=True)
class Outcome:
    """Result of a draw.

    Attributes:
        kind: how it was spoiled.
        registered, cameras: numbers of registered and of all cameras.
        off: largest error of a camera center after a similarity, in meters; NaN with fewer than
            three cameras.
        scale: estimated over true length.
        scale_sd: stated standard deviation of the scale.
        moda: percent, aligned by the same similarity.
        expected: label-free expectation of MODA; NaN without one.
        said: warnings of the result, or why there is no rig.
    """

    kind: str
    registered: int
    cameras: int
    off: float = np.nan
    scale: float = np.nan
    scale_sd: float = np.nan
    moda: float = np.nan
    expected: float = np.nan
    said: str = ""

    @property
    def is_confident_and_wrong(self) -> bool:
        """Whether the rig is off despite a high expectation."""
        return self.off > OFF and self.expected > SURE


def draw(number: int, kinds: list[str]) -> tuple[str, Input]:
    """Make the spoiled input of this number."""
    kind = kinds[number % len(kinds)]
    spoil, people = SPOILERS[kind]
    rng = np.random.default_rng([number, 5])
    layout = LAYOUTS[(number // len(kinds) + number) % len(LAYOUTS)]
    detector = DetectorModel(
        pixel_noise=rng.uniform(1.0, 4.0), embedding_size=0, false_positives=0.5
    )
    world = make_world(layout, 1000 + number, frames=FRAMES, people=people, detector=detector)
    given = Input(
        world.detections,
        np.array(world.true_rig.image_size),
        world.true_centres,
        world.ground_truth,
        world,
    )
    return kind, spoil(given, rng)


def outcome(kind: str, given: Input) -> Outcome:
    """Calibrate and track."""
    count = len(given.size)
    try:
        calibration = cf.calibrate(given.boxes, given.size)
        result = cf.localize(given.boxes, calibration.scene)
    except cf.CatFreeError as error:
        return Outcome(kind, 0, count, said=str(error))
    rig = calibration.scene.rig
    known = np.asarray(rig.registered)
    if known.sum() < 3:  # two cameras fit any other two
        return Outcome(kind, int(known.sum()), count, said="Two cameras cannot be compared.")
    found, true = np.asarray(rig.centers)[known], given.centers[known]
    similarity = fit_similarity(found, true)
    off = np.linalg.norm(np.asarray(similarity(found)) - true, axis=-1).max()
    world = given.world
    rows = result.tracks.to_rows(np.asarray(similarity(result.tracks.position))[:, :2])
    score = detection_metrics_in_area(given.truth, rows, world.area, np.unique(given.boxes.frame))
    reliability = result.reliability
    return Outcome(
        kind,
        int(known.sum()),
        count,
        float(off),
        1 / float(similarity.scale),
        calibration.scale_sd,
        score.metrics.moda,
        np.nan if reliability.expected_moda is None else float(reliability.expected_moda),
        " ".join([*result.warnings, reliability.expectation_note or ""]).strip(),
    )


def main() -> None:
    """Print one row per draw, and the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", action="append", choices=list(SPOILERS))
    options = parser.parse_args()
    kinds = options.kind or list(SPOILERS)
    outcomes = []
    for number in range(options.first, options.first + options.draws):
        begun = time.perf_counter()
        o = outcome(*draw(number, kinds))
        outcomes.append(o)
        print(
            f"{number:4d} {o.kind:14} {o.registered}/{o.cameras} off {o.off:6.2f} m  scale "
            f"{o.scale:.3f} +- {o.scale_sd:.3f}  MODA {o.moda:6.1f} expected {o.expected:5.1f} "
            f"{time.perf_counter() - begun:4.0f} s  {o.said[:150]}",
            flush=True,
        )
    print("| kind | draws | no rig | off by more than 1 m | of them expected above 70 |")
    print("|---|---|---|---|---|")
    for kind in kinds:
        mine = [o for o in outcomes if o.kind == kind]
        counts = (
            len(mine),
            sum(not o.registered for o in mine),
            sum(o.off > OFF for o in mine),
            sum(o.is_confident_and_wrong for o in mine),
        )
        print(f"| {kind} | {' | '.join(map(str, counts))} |")
    wrong = sum(o.is_confident_and_wrong for o in outcomes)
    print(f"Confident and wrong: {wrong} of {len(outcomes)}.")


if __name__ == "__main__":
    main()
