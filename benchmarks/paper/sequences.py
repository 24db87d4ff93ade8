"""Sequences for the tables: simulated twins, scenario folders, and real data.

A twin is a simulated world that imitates one of the paper's data sets. Its parameters were chosen
once, from the paper and the library's defaults, before any table was computed, and never change to
support a claim:

- cameras, area, frame rate and crowd are the library's layouts (`catfree.synthetic._layouts`):
  seven uneven cameras (WildTrack), six around a dense crowd (MultiviewX), six and eight around a
  courtyard (GMVD configurations 1 and 2);
- the numbers of frames (40, 40, 105 and 105) and of people in the area (24, 37, 39 and 33 per
  frame) are the paper's;
- a third as many bystanders outside the area as people in it, groups of up to four, a third of
  the groups standing: the defaults of `make_world`;
- the rig is off by the default `RigError`, so the root mean square of the angle between a foot ray
and its person is about the paper's sigma_theta of 0.0206 rad;
- the detector is the default `DetectorModel`, but on GMVD it finds 68.2 % of the visible people and
  confirms 43.8 % of the ankles, as the paper reports for its detector there.

`python -m benchmarks.paper.twins` measures these properties on the worlds.

With `rough_ground=True`, the recovered ground is off by 1 degree and 0.2 m instead of half a degree
and 5 cm, with everything else unchanged: the second condition for testing claims.
"""

import dataclasses
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import catfree as cf
from catfree.adapters import MultiViewSequence, read_scenario, read_uniform_json
from catfree.errors import CatFreeError
from catfree.synthetic import DetectorModel, RigError, World, make_world

# Probabilities of a detection and of a confirmed ankle that give the two shares above.
GMVD_DETECTOR = DetectorModel(detection_rate=0.735, ankle_rate=0.51)
ROUGH_GROUND = RigError(ground_tilt_deg=1.0, ground_offset=0.2)


@dataclasses.dataclass(frozen=True)
class Twin:
    """Definition of a twin: the paper's column that it stands for, and its world."""

    paper: str
    layout: str
    frames: int
    people: int
    detector: DetectorModel


TWINS = (
    Twin("WildTrack", "wildtrack", 40, 24, DetectorModel()),
    Twin("MultiviewX", "multiviewx", 40, 37, DetectorModel()),
    Twin("GMVD", "gmvd6", 105, 39, GMVD_DETECTOR),
    Twin("GMVD c2", "gmvd8", 105, 33, GMVD_DETECTOR),
)
DEVELOPMENT = ("WildTrack", "MultiviewX", "GMVD")
UNSEEN = "GMVD c2"


@dataclasses.dataclass(frozen=True, eq=False)
class Sequence:
    """Boxes, a scene, and the truth that a result is scored against.

    Attributes:
        name: unique name.
        detections: boxes for the methods.
        scene: scene for the methods: recovered in an arbitrary gauge, or true and metric.
        ground_truth: (N, 4) rows [frame, id, x, y] in meters; id -1 if unknown.
        frames: (F,) evaluated frames.
        area: evaluation area (x_min, x_max, y_min, y_max) in meters, or None for everywhere.
        true_centres: (C, 3) true camera centers in meters, or None.
        true_scene: the true rig and ground in meters, or None if unknown.
        kind: "twin", "scenario" or "real".
        paper: the paper's column for a twin, or "".
        seed: seed of a twin.
        world: world of a twin, with everything known only in simulation; otherwise None.
    """

    name: str
    detections: cf.Detections
    scene: cf.Scene
    ground_truth: Float[np.ndarray, "n 4"]
    frames: Int[np.ndarray, " f"]
    area: tuple[float, float, float, float] | None = None
    true_centres: Float[np.ndarray, "cam 3"] | None = None
    true_scene: cf.Scene | None = None
    kind: str = "real"
    paper: str = ""
    seed: int = 0
    world: World | None = None

    @classmethod
    def of_world(cls, world: World, name: str, **labels: Any) -> "Sequence":
        """Make the methods' input from a simulated world; `labels` are the remaining attributes."""
        return cls(
            name=name,
            detections=world.detections,
            scene=world.scene,
            ground_truth=world.ground_truth,
            frames=np.arange(len(world.walkers.position)),
            area=world.area,
            true_centres=world.true_centres,
            true_scene=world.true_scene,
            world=world,
            **labels,
        )

    @property
    def identified(self) -> bool:
        """Whether the truth has identities, which tracking metrics need."""
        return bool((self.ground_truth[:, 1] >= 0).all())


@cache
def twin(
    paper: str, seed: int, frames: int | None = None, *, rough_ground: bool = False
) -> Sequence:
    """Make the twin of one of the paper's columns; `frames` replaces the paper's number."""
    made = next(twin for twin in TWINS if twin.paper == paper)
    count = made.frames if frames is None else frames
    error = ROUGH_GROUND if rough_ground else RigError()
    world = make_world(
        made.layout,
        seed,
        frames=count,
        people=made.people,
        rig_error=error,
        detector=made.detector,
    )
    name = f"{made.layout} twin {seed}{' rough ground' if rough_ground else ''}"
    return Sequence.of_world(world, name, kind="twin", paper=paper, seed=seed)


def twins(
    seed: int = 0, frames: int | None = None, *, rough_ground: bool = False
) -> list[Sequence]:
    """Make the four twins of one seed, in the order of `TWINS`; `frames` shortens all of them."""
    return [twin(made.paper, seed, frames, rough_ground=rough_ground) for made in TWINS]


def scenarios(folder: Path | None) -> Iterator[Sequence]:
    """Yield the simulated scenes `folder/scenarios/*`, with their disturbed rigs, if any."""
    paths = sorted(folder.glob("scenarios/*/rig.json")) if folder else []
    if not paths:
        _skip("scenarios", folder)
    for path in paths:
        yield _carried(read_scenario(path.parent), path.parent.name, "scenario")


def real(folder: Path | None) -> Iterator[Sequence]:
    """Yield the real sequences `folder/real/*.json`, with true rigs, once per set of boxes."""
    paths = sorted(folder.glob("real/*.json")) if folder else []
    if not paths:
        _skip("real sequences", folder)
    for path in paths:
        for label, options in (
            ("", {}),
            (" FairMOT", {"views": "views_fairmot"}),
            (" OSNet", {"embedding": "osnet"}),
        ):
            try:
                read = read_uniform_json(path, **options)
            except CatFreeError:
                continue  # the file has no such boxes or embeddings
            if len(read.ground_truth) and read.scene is not None:
                yield _carried(read, path.stem + label, "real")


@cache
def without_embeddings(sequence: Sequence) -> Sequence:
    """Remove appearance vectors from the boxes."""
    boxes = sequence.detections
    bare = cf.Detections(boxes.frame, boxes.camera, boxes.box, boxes.score, boxes.ankles_confirmed)
    return dataclasses.replace(
        sequence, name=f"{sequence.name} (no embeddings)", detections=bare, world=None
    )


def _carried(read: MultiViewSequence, name: str, kind: str) -> Sequence:
    assert read.scene is not None
    return Sequence(
        name=name,
        detections=read.detections,
        scene=read.scene,
        ground_truth=read.ground_truth,
        frames=read.frames,
        area=read.evaluation_area,
        true_centres=read.true_centres,
        true_scene=read.scene if read.scene.metric else None,
        kind=kind,
    )


@cache
def _skip(what: str, folder: Path | None) -> None:
    """Report once that something is missing."""
    place = f"in {folder}" if folder else "because no --data folder was given"
    print(f"Skipped: no {what} {place}.")
