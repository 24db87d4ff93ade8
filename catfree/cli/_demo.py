"""The demo: render a world, run the whole pipeline on its videos, and score the tracks."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from catfree._run._result_folder import write_results
from catfree._run._run import RunOutcome, run_stages
from catfree.errors import CalibrationError, InsufficientDataError, InvalidInputError
from catfree.evaluation import (
    DetectionMetrics,
    TrackingMetrics,
    align_centres,
    crop,
    detection_metrics,
    hota,
    tracking_metrics,
)
from catfree.geometry import Similarity
from catfree.methods.evidence import EvidenceSettings
from catfree.settings import Settings
from catfree.synthetic._world import World
from catfree.synthetic.render import make_demo_world, render_videos
from catfree.types import Scene
from catfree.types._annotations import Progress
from catfree.types._processes import processor_count
from catfree.types._validation import as_count
from catfree.viz.page._blocks import Block, Heading, Paragraph, Table

SMALLEST_PICTURE = 32  # pixels; people in smaller ones are mere dots
LARGEST_PICTURE = 4096  # pixels; larger ones exceed common decoders and memory

# By default, people are not reported where the rig is imprecise. The demo scores only the square,
# so it does not need this restriction.
DEMO_SETTINGS = Settings(evidence=EvidenceSettings(working_area=False))
UNPREDICTED = (
    "There is no expected MODA below, because the demo scores only the square and therefore "
    "reports people wherever it finds them, while the prediction was fitted to runs that report "
    "them only where the cameras locate them precisely."
)

EASY = (
    "What is easy about this world: cameras are exactly synchronized and do not shake, lenses have "
    "no distortion, the light is constant, the ground is flat, clothes have no patterns, and "
    "people do not stand still for long. What is hard: focal lengths and body heights differ from "
    "what the calibration assumes, people hide each other, stand, enter and leave, and furniture "
    "hides them."
)


@dataclass(frozen=True)
class AlignedScore:
    """Accuracy of positions and cameras after one kind of alignment of the camera centers.

    Attributes:
        alignment: "similarity" or "rigid" (without correcting the scale).
        detection: matches within 0.5 m.
        tracking: matches within 1 m.
        hota: in percent.
        centre_error: (C,) distance of each camera's center from the truth in meters, NaN for
            unregistered cameras.
        scale: fitted meters per scene unit; 1 for a rigid alignment.
    """

    alignment: str
    detection: DetectionMetrics
    tracking: TrackingMetrics
    hota: float
    centre_error: Float[np.ndarray, " cam"]
    scale: float


def run_demo(
    folder: str | os.PathLike[str],
    seed: int = 0,
    *,
    cameras: int = 6,
    people: int = 14,
    frames: int = 200,
    image_size: tuple[int, int] = (1280, 720),
    settings: Settings | None = None,
    workers: int | None = None,
    pictures: bool | None = None,
    blur: bool = False,
    progress: Progress | None = None,
) -> tuple[RunOutcome, tuple[AlignedScore, ...]]:
    """Render a seeded world, track its people from the video files alone, and score the tracks.

    Args:
        folder: folder for videos and results, created if it does not exist.
        seed: determines the world completely.
        cameras: cameras around the square.
        people: people on the square at a time.
        frames: number of frames, 5 per second.
        image_size: width and height of the videos in pixels.
        settings: settings of the localization; `DEMO_SETTINGS` if None.
        workers: processes that render and detect; None: one per processor.
        pictures: draw plots; None: if matplotlib is installed.
        blur: make people unrecognizable in the pictures of the results.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The result of the pipeline, and the scores after a similarity and after a rigid alignment.

    Raises:
        InvalidInputError: if there are fewer than three cameras, no people, or images too small or
            too large for a video.
        CatFreeError: any error of the pipeline, for instance if no rig can be found.
    """
    for name, value, least in (
        ("cameras", cameras, 3),  # two centers do not determine the alignment with the truth
        ("people", people, 1),
        ("workers", 1 if workers is None else workers, 1),
    ):
        as_count(value, name, least=least)
    if min(image_size) < SMALLEST_PICTURE or max(image_size) > LARGEST_PICTURE:
        raise InvalidInputError(
            f"The image size is {image_size[0]} x {image_size[1]} pixels; the demo renders "
            f"{SMALLEST_PICTURE} to {LARGEST_PICTURE} each way."
        )
    root = Path(folder)
    settings = settings or DEMO_SETTINGS
    world = make_demo_world(
        seed, cameras=cameras, people=people, frames=frames, image_size=image_size
    )
    videos = render_videos(world, root / "videos", progress, workers=workers)
    try:
        # From here on, only the video files are used.
        outcome = run_stages(
            videos, settings=settings, progress=progress, workers=workers or processor_count()
        )
        scores = score(world, outcome)
    except (CalibrationError, InsufficientDataError) as error:
        width, height = image_size
        raise type(error)(
            f"{error} This demo has --cameras {cameras}, --people {people}, --frames {frames} and "
            f"--size {width} {height}: give more of them, or leave them out."
        ) from error
    truth = truth_in_scene(world, outcome.scene)
    score_blocks: list[Block] = [
        Heading("Score against the truth"),
        score_table(scores),
        Paragraph(EASY),
    ]
    if settings == DEMO_SETTINGS:
        score_blocks.append(Paragraph(UNPREDICTED))
    write_results(
        root,
        outcome,
        settings,
        videos=outcome.videos,
        pictures=pictures,
        ground_truth=truth,
        blur=blur,
        extra=score_blocks,
    )
    return outcome, scores


def score(world: World, outcome: RunOutcome) -> tuple[AlignedScore, ...]:
    """Compare a run with the true world, after a similarity and after a rigid alignment.

    The alignment is fitted to the camera centers, never to people. True and reported people outside
    the area are ignored.

    Args:
        world: the truth.
        outcome: the result of the run.

    Raises:
        InsufficientDataError: if fewer than three cameras are registered.
    """
    rig, tracks = outcome.scene.rig, outcome.localization.tracks
    centers = np.asarray(rig.centers, np.float64)
    scores = []
    for alignment, fixed_scale in (("similarity", False), ("rigid", True)):
        similarity = align_centres(
            centers, world.true_centres, registered=rig.registered, fixed_scale=fixed_scale
        )
        moved = np.asarray(similarity(tracks.position))
        rows = crop(tracks.to_rows(moved[:, :2]), world.area)
        compared = world.ground_truth, rows, outcome.frames
        error = np.full(len(centers), np.nan)
        registered = rig.registered
        offset = np.asarray(similarity(centers[registered])) - world.true_centres[registered]
        error[registered] = np.linalg.norm(offset, axis=-1)
        scores.append(
            AlignedScore(
                alignment=alignment,
                detection=detection_metrics(*compared),
                tracking=tracking_metrics(*compared),
                hota=hota(*compared).hota,
                centre_error=error,
                scale=float(similarity.scale),
            )
        )
    return tuple(scores)


def score_table(scores: tuple[AlignedScore, ...]) -> Table:
    """Tabulate scores, one column per alignment."""
    lines: list[tuple[str, Callable[[AlignedScore], str]]] = [
        ("MODA (0.5 m)", lambda s: f"{s.detection.moda:.1f}"),
        ("precision", lambda s: f"{s.detection.precision:.1f}"),
        ("recall", lambda s: f"{s.detection.recall:.1f}"),
        ("position error (m)", lambda s: f"{s.tracking.motp:.2f}"),
        ("IDF1 (1 m)", lambda s: f"{s.tracking.idf1:.1f}"),
        ("HOTA", lambda s: f"{s.hota:.1f}"),
        ("camera-center error, mean (m)", lambda s: f"{np.nanmean(s.centre_error):.2f}"),
        ("camera-center error, worst (m)", lambda s: f"{np.nanmax(s.centre_error):.2f}"),
        ("scale", lambda s: f"{s.scale:.3f}"),
        (
            "cameras registered",
            lambda s: f"{int(np.isfinite(s.centre_error).sum())} of {len(s.centre_error)}",
        ),
    ]
    header = ("alignment of the camera centers", *(s.alignment for s in scores))
    rows = tuple((name, *(show(s) for s in scores)) for name, show in lines)
    return Table(header, rows)


def truth_in_scene(world: World, scene: Scene) -> Float[np.ndarray, "n 4"]:
    """Return true rows [frame, id, x, y] in ground coordinates of a scene, for pictures."""
    similarity: Similarity = align_centres(
        np.asarray(scene.rig.centers, np.float64),
        world.true_centres,
        registered=scene.rig.registered,
    )
    rows = world.ground_truth
    points = np.column_stack([rows[:, 2:], np.zeros(len(rows))])
    placed = np.asarray(similarity.inverse()(points), np.float64)
    return np.column_stack([rows[:, :2], placed @ np.asarray(scene.ground.basis, np.float64)])
