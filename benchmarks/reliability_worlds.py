"""Simulated worlds of varying difficulty, for fitting the expected MODA.

A world is determined by its number. The worlds vary in layout, number of cameras, crowd,
bystanders, occluders, frames, recall, noise, truncation and false boxes of the detector, presence
of embeddings, scores and ankles, and errors of rig and ground. The ranges extend from the library's
defaults (every fourth world has the default detector) to barely usable detectors and rigs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

import catfree as cf
from catfree.evaluation import align_centres, detection_metrics_in_area
from catfree.synthetic import DetectorModel, RigError, World, make_layout, make_world
from catfree.types import Scene

LAYOUTS = (
    "wildtrack", "multiviewx", "gmvd6", "gmvd8", "ring4", "ring5", "ring6", "ring7", "ring8",
)  # fmt: skip
FEWEST_CAMERAS = 2
FRAMES = (16, 24, 40)
DEFAULT_DETECTOR_EVERY = 4


@dataclass(frozen=True)
class Case:
    """A world as a method sees it, possibly with fewer cameras and columns.

    Attributes:
        number: number that determines everything.
        world: world with all cameras, for the truth and the alignment.
        detections: boxes of the remaining cameras.
        scene: scene with the remaining cameras.
        frames: number of frames.
    """

    number: int
    world: World
    detections: cf.Detections
    scene: cf.Scene
    frames: int


def draw(number: int) -> Case:
    """Draw the world with this number."""
    rng = np.random.default_rng([number, 77])
    layout = make_layout(LAYOUTS[number % len(LAYOUTS)], number)
    people = max(3, int(layout.people * rng.uniform(0.3, 1.1)))
    bystanders = int(people * rng.uniform(0, 1))
    embedded, scored, posed = rng.uniform(size=3) < (0.5, 0.7, 0.6)
    detector = _detector(rng, embedded)
    if number % DEFAULT_DETECTOR_EVERY == 0:
        detector = DetectorModel(embedding_size=64 if embedded else 0)
    wrong = _between(rng, 0.1, 2.0)
    usual = RigError()
    rig_error = RigError(
        rotation_deg=wrong * usual.rotation_deg,
        centre=wrong * usual.centre,
        focal=wrong * usual.focal,
        ground_tilt_deg=wrong * usual.ground_tilt_deg,
        ground_offset=wrong * usual.ground_offset,
    )
    frames = int(rng.choice(FRAMES))
    cameras = layout.rig.camera_count
    left = np.sort(rng.permutation(cameras)[: rng.integers(FEWEST_CAMERAS, cameras + 1)])
    world = make_world(
        layout,
        number,
        frames=frames,
        people=people,
        background=bystanders,
        columns=_columns(rng, layout.area),
        rig_error=rig_error,
        detector=detector,
    )
    boxes = world.detections[np.isin(world.detections.camera, left)]
    detections = cf.Detections(
        boxes.frame,
        np.searchsorted(left, boxes.camera),
        boxes.box,
        boxes.score if scored else None,
        boxes.ankles_confirmed if posed else None,
        boxes.embedding,
    )
    scene = world.scene
    fewer = Scene(scene.rig.select(left), scene.ground, scene.extent, scene.metric)
    return Case(number, world, detections, fewer, frames)


def moda(case: Case, tracks: cf.Tracks) -> float:
    """Compute MODA in percent at 0.5 m inside the area, aligned by the centers of all cameras."""
    world = case.world
    align = align_centres(np.asarray(world.scene.rig.centers), world.true_centres)
    rows = np.zeros((0, 4))
    if len(tracks):
        rows = tracks.to_rows(np.asarray(align(tracks.position))[:, :2])
    found = detection_metrics_in_area(world.ground_truth, rows, world.area, np.arange(case.frames))
    return float(found.metrics.moda)


def _detector(rng: np.random.Generator, embedded: bool) -> DetectorModel:
    return DetectorModel(
        detection_rate=rng.uniform(0.6, 0.99),
        half_visible=rng.uniform(0.2, 0.5),
        half_height=rng.uniform(25.0, 80.0),
        persistence=_between(rng, 0.2, 3.0),
        box_noise=_between(rng, 0.008, 0.05),
        pixel_noise=rng.uniform(0.5, 4.0),
        truncation=rng.uniform(0.0, 1.0),
        guess_noise=_between(rng, 0.03, 0.15),
        false_positives=_between(rng, 0.1, 4.0),
        embedding_size=64 if embedded else 0,
    )


def _columns(
    rng: np.random.Generator, area: tuple[float, float, float, float]
) -> Float[np.ndarray, "k 4"]:
    count = int(rng.integers(0, 4))
    low, high = np.array([area[0], area[2], 0.2, 1.0]), np.array([area[1], area[3], 0.5, 3.0])
    return rng.uniform(low, high, (count, 4))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw log-uniformly."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
