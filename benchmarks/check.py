"""Detect cameras that turn and clocks that drift: `python -m benchmarks.check [DATA] [--worlds N]`.

In every recording, one camera turns about a random axis in the middle. Measured: how often
`cf.check` finds it or blames another camera, and the errors of the angle and the time. Recordings
without a turn give the false alarms. Then one camera of simulated minutes is late by fractions of a
frame up to 20 frames, or its clock runs fast or slow. Measured: errors of `cf.estimate_clocks`, and
the share within two stated standard deviations.

`--still FIRST END` instead checks simulated recordings in which nothing happens, with these numbers
and 12 to 30 minutes long, and counts the false alarms; a hundred take an hour.

DATA is the folder with the real sequences; without it, only simulated worlds are used.
"""

import argparse
import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.adapters import read_uniform_json
from catfree.synthetic import RigError, World, detect, make_world
from catfree.types._sampling import frame_step

LAYOUTS = ("ring5", "ring4", "wildtrack", "ring6")
DEGREES = (0.0, 0.5, 1.0, 2.0, 5.0)
FRAMES, MINUTE, LONG = 150, 300, 3600
LAGS = (0.0, 0.3, 1.5, 6.4, 20.0)
RATES = (0.001, 0.003, 0.01)
REAL = ("cmc1", "cmc3", "wildtrack_0_715")


class Recording(NamedTuple):
    """A recording on a clock, with cameras that do not move.

    Attributes:
        name: name for the table.
        scene: given cameras and ground.
        detections: boxes with a clock.
        hours: length.
    """

    name: str
    scene: cf.Scene
    detections: cf.Detections
    hours: float


def simulated(numbers: Iterable[int], frames: int = FRAMES) -> Iterator[Recording]:
    """Simulate worlds with the usual errors of a reconstructed rig, or with none."""
    for number in numbers:
        error = RigError() if number % 2 else RigError(0.0, 0.0, 0.0, 0.0, 0.0)
        layout = LAYOUTS[number // 2 % len(LAYOUTS)]
        world = make_world(layout, number, frames=frames, people=8, rig_error=error)
        rate = world.layout.fps
        boxes = dataclasses.replace(world.detections, clock=cf.Clock(rate))
        kind = "worlds, disturbed rig" if number % 2 else "worlds, true rig"
        yield Recording(kind, world.scene, boxes, frames / rate / 3600)


def real(data: Path) -> Iterator[Recording]:
    """Read the real sequences with their given cameras."""
    for name in REAL:
        sequence = read_uniform_json(data / "real" / f"{name}.json")
        assert sequence.scene is not None
        assert sequence.fps is not None
        step = frame_step(sequence.frames)
        boxes = dataclasses.replace(sequence.detections, clock=cf.Clock(sequence.fps * step))
        hours = len(sequence.frames) / sequence.fps / 3600
        yield Recording(name, sequence.scene, boxes, hours)


def turned(
    recording: Recording, camera: int, turn: Float[np.ndarray, "3"], since: int
) -> cf.Detections:
    """Change the boxes as if a camera turned by a rotation vector, ignoring lens distortion."""
    boxes, rig = recording.detections, recording.scene.rig
    K = np.asarray(rig.K, float)[camera]
    change = K @ Rotation.from_rotvec(turn).as_matrix() @ np.linalg.inv(K)
    mine = (boxes.camera == camera) & (boxes.frame >= since)
    x1, y1, x2, y2 = np.asarray(boxes.box, float)[mine].T
    middle, half = (x1 + x2) / 2, (x2 - x1) / 2
    head, foot = (change @ np.stack([middle, row, np.ones_like(row)]) for row in (y1, y2))
    head, foot = head[:2] / head[2], foot[:2] / foot[2]
    middle = (head[0] + foot[0]) / 2
    box = np.array(boxes.box, float)
    size = np.asarray(rig.image_size)[camera] - 1
    box[mine] = np.stack([middle - half, head[1], middle + half, foot[1]], -1)
    box[mine] = np.clip(box[mine], 0, np.tile(size, 2))
    kept = (box[:, 2] - box[:, 0] > 2) & (box[:, 3] - box[:, 1] > 8)
    return dataclasses.replace(boxes, box=np.where(kept[:, None], box, boxes.box))[kept]


def turns(recordings: Iterable[Recording], rng: np.random.Generator) -> None:
    """Print detection rates, errors and false alarms by recording and size of the turn."""
    rows: dict[tuple[str, float], list[tuple[bool, int, float, float, float]]] = defaultdict(list)
    hours: dict[tuple[str, float], float] = defaultdict(float)
    wrong: dict[str, list[str]] = defaultdict(list)
    for recording in recordings:
        frames = np.unique(recording.detections.frame)
        since = int(frames[len(frames) // 2])
        count = recording.scene.rig.camera_count
        camera = int(rng.integers(count))
        axis = rng.normal(size=3) * [1, 1, 0.3]
        axis /= np.linalg.norm(axis)
        for degrees in DEGREES:
            boxes = recording.detections
            if degrees:
                boxes = turned(recording, camera, np.deg2rad(degrees) * axis, since)
            result = cf.check(recording.scene, boxes)
            moved = [one.camera for one in result.cameras if one.since is not None]
            found = result.cameras[camera]
            hit = degrees > 0 and found.verdict == cf.Verdict.MOVED and found.since is not None
            alarms = len([c for c in moved if c != camera or degrees == 0])
            late = (found.since or 0) - since
            seconds = late / boxes.clock.frame_rate if boxes.clock is not None else np.nan
            key = recording.name, degrees
            rows[key].append((hit, alarms, found.degrees - degrees, found.degrees_sd, seconds))
            hours[key] += count * recording.hours
            if degrees == 0:
                for one in result.cameras:
                    wrong[recording.name].append(one.verdict.value)
    print("recording, degrees: found, alarms of others (camera-hours), error of angle, sd, seconds")
    for (name, degrees), found in sorted(rows.items()):
        hit, alarms, error, deviation, seconds = map(np.array, zip(*found, strict=True))
        line = f"{name:24} {degrees:4.1f}: {hit.sum():3d} of {len(hit)}, {alarms.sum():3d} "
        line += f"({hours[name, degrees]:.2f})"
        if degrees and hit.any():
            line += f", {np.sqrt((error[hit] ** 2).mean()):.2f}, {np.median(deviation[hit]):.2f}"
            line += f", median {np.median(np.abs(seconds[hit])):.1f}"
            line += f", worst {np.abs(seconds[hit]).max():.1f}"
        print(line, flush=True)
    for name, verdicts in wrong.items():
        tally = {one: verdicts.count(one) for one in sorted(set(verdicts))}
        print(f"{name:24} nothing happened: {tally}", flush=True)


def still(recordings: Iterable[Recording]) -> None:
    """Print how often a camera that does not move is said to have moved, by kind of recording."""
    alarms: dict[str, int] = defaultdict(int)
    hours: dict[str, float] = defaultdict(float)
    for recording in recordings:
        cameras = cf.check(recording.scene, recording.detections).cameras
        alarms[recording.name] += sum(one.since is not None for one in cameras)
        hours[recording.name] += len(cameras) * recording.hours
        said = (f"{name}: {alarms[name]} in {hours[name]:.1f}" for name in sorted(hours))
        print(f"false alarms in camera-hours: {', '.join(said)}", flush=True)


def late_world(
    world: World, camera: int, lag: Callable[[Float[np.ndarray, " t"]], Float[np.ndarray, " t"]]
) -> cf.Detections:
    """Simulate detections of a world in which one camera shows earlier instants, between frames.

    Frames that would show instants before the first or after the last are missing.
    """
    walkers = world.walkers
    count = len(walkers.present)
    frame = np.arange(count, dtype=float)
    shown = frame - lag(frame)
    at = np.clip(shown, 0, count - 1)
    low = np.minimum(at.astype(int), count - 2)
    part = at - low

    def between(values: np.ndarray) -> np.ndarray:
        share = part.reshape(-1, *(1,) * (values.ndim - 1))
        return (1 - share) * values[low] + share * values[low + 1]

    near = np.rint(at).astype(int)
    other = dataclasses.replace(
        walkers,
        position=np.where(
            (walkers.present[low] & walkers.present[low + 1])[..., None],
            between(walkers.position),
            walkers.position[near],
        ),
        velocity=walkers.velocity[near],
        heading=walkers.heading[near],
        stride=walkers.stride[near],
        present=walkers.present[near],
    )
    seen, _ = detect(other, world.true_rig.select([camera]), seed=world.seed)
    seen = dataclasses.replace(seen, camera=np.full(len(seen), camera))[(shown == at)[seen.frame]]
    rest = world.detections[world.detections.camera != camera]
    clock = cf.Clock(world.layout.fps)
    return dataclasses.replace(cf.Detections.concatenate([rest, seen]), clock=clock)


def clocks(count: int, people: int, *, disturbed: bool) -> None:
    """Print errors of offsets and rates, and the share within two standard deviations."""
    cases = [(lag, 0.0) for lag in LAGS] + [(0.0, rate) for rate in RATES]
    print("offset, rate: worst and RMS error of the offset (frames), of the rate, share in 2 sd")
    for offset, rate in cases:
        errors, rates, inside = [], [], []
        for seed in range(count):
            error = RigError() if disturbed else RigError(0.0, 0.0, 0.0, 0.0, 0.0)
            world = make_world("ring5", seed, frames=MINUTE, people=people, rig_error=error)

            def lag(
                frame: Float[np.ndarray, " t"], o: float = offset, r: float = rate
            ) -> np.ndarray:
                return o + r * (frame - MINUTE / 2)

            boxes = late_world(world, 1, lag)
            found = cf.estimate_clocks(world.scene, boxes)
            truth = np.zeros(5)
            truth[1] = offset + rate * (found.frame - MINUTE / 2)
            of_rate = np.zeros(5)
            of_rate[1] = rate
            others = np.arange(5) != found.reference
            off = (found.offset - truth + truth[found.reference])[others]
            drift = (found.rate - of_rate + of_rate[found.reference])[others]
            errors += off.tolist()
            rates += drift.tolist()
            inside += (np.abs(off) < 2 * found.offset_sd[others]).tolist()
            inside += (np.abs(drift) < 2 * found.rate_sd[others]).tolist()
            if found.jumps:
                print(f"    false jumps of world {seed}: {found.jumps}", flush=True)
        off, drift = np.array(errors), np.array(rates)
        print(
            f"{offset:5.1f} {rate:6.3f}: {np.abs(off).max():.2f}, {np.sqrt((off**2).mean()):.2f}, "
            f"{np.sqrt((drift**2).mean()):.5f}, {100 * np.mean(inside):.0f} %",
            flush=True,
        )


def main() -> None:
    """Run all measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--worlds", type=int, default=20)
    parser.add_argument("--only", choices=("turns", "clocks", "real"))
    parser.add_argument("--still", type=int, nargs=2, metavar=("FIRST", "END"))
    options = parser.parse_args()
    begin = time.perf_counter()
    if options.still is not None:
        still(simulated(range(*options.still), LONG))
        return
    if options.only in (None, "turns"):
        turns(simulated(range(options.worlds)), np.random.default_rng(0))
    if options.only in (None, "real") and options.data is not None:
        turns(real(options.data), np.random.default_rng(1))
    if options.only in (None, "clocks"):
        for people in (3, 8):
            for disturbed in (False, True):
                kind = "disturbed" if disturbed else "true"
                print(f"{people} people, {kind} rig")
                clocks(max(1, options.worlds // 5), people, disturbed=disturbed)
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
