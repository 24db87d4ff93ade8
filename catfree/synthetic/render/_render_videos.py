"""Rendering of a world's cameras to video files, several at a time.

The pictures are easier than real footage: exact synchronization, no lens distortion, no camera
shake, constant exposure and weather, little texture on clothes, a flat ground, and a sun that casts
shadows of bodies only on the ground.
"""

import os
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from catfree._worker import SPAWN, as_they_end, from_parent, spawned_pool
from catfree.errors import CatFreeError, InvalidInputError
from catfree.synthetic._layouts import ring
from catfree.synthetic._walkers import Walkers
from catfree.synthetic._world import World, make_world
from catfree.synthetic.render._backdrop import render_background
from catfree.synthetic.render._painter import Painter
from catfree.synthetic.render._stage import Stage, build_stage, street_furniture
from catfree.synthetic.render._textures import ground_picture
from catfree.types import Rig
from catfree.types._annotations import Progress, as_progress
from catfree.types._processes import processor_count
from catfree.types._writing import make_folder, remove_abandoned, replacement

STAGE_NAME = "render"
REPORT_EVERY = 5  # frames between two progress reports
# A person who stands through most of the footage cannot be distinguished from the scene. The
# footage is only forty seconds long, so pauses are short.
STANDING_TIME = 4.0  # seconds, mean


def make_demo_world(
    seed: int = 0,
    *,
    cameras: int = 6,
    people: int = 14,
    frames: int = 200,
    image_size: tuple[int, int] = (1280, 720),
) -> World:
    """Make the world of the demo: a furnished 16 x 16 m square at 5 frames per second.

    Args:
        seed: determines all random draws.
        cameras: cameras around the square.
        people: people on the square at a time; a third as many stay around it.
        frames: number of frames.
        image_size: width and height in pixels.

    Returns:
        A world for `render_videos`. Focal lengths and the mean body height differ from the values
        that a method may assume; people stand for only a few seconds.
    """
    layout = ring(cameras, seed=seed, image_size=image_size, people=people)
    columns = street_furniture(layout.area, seed, cameras=np.asarray(layout.rig.centers))
    return make_world(layout, seed, frames=frames, columns=columns, standing_time=STANDING_TIME)


def render_videos(
    world: World,
    folder: str | os.PathLike[str],
    progress: Progress | None = None,
    *,
    shadows: str | None = None,
    workers: int | None = None,
) -> list[Path]:
    """Render every camera of a world to an MP4 file.

    More than one worker spawns processes: call it from an importable module, and in a script under
    `if __name__ == "__main__":`.

    Args:
        world: the world, which sets image sizes and frame rate.
        folder: where `camera_0.mp4`, `camera_1.mp4`, ... are written; created if it does not exist.
        progress: called with ("render", frames done, total frames).
        shadows: "hard" as on a clear day, "soft" as under thin clouds, None: chosen by the seed.
        workers: number of processes; None: one per processor, at most one per camera. 1 renders in
            this process.

    Returns:
        The files, one per camera, in the rig's order. A file appears when it is complete.

    Raises:
        InvalidInputError: if a lens is not ideal, OpenCV cannot write such videos there, or
            `workers` is below 1.
        CatFreeError: if the processes cannot be started.
        WriteError: if the folder cannot be made, or is not writable.
    """
    if not world.true_rig.is_ideal:
        raise InvalidInputError(
            "Pictures are rendered without lens distortion, but cameras of this world have it, or "
            "are not pinholes. Make a world whose lenses are ideal."
        )
    target = make_folder(folder)
    remove_abandoned(target)
    stage = build_stage(world, shadows)
    cameras = world.true_rig.camera_count
    paths = [target / f"camera_{camera}.mp4" for camera in range(cameras)]
    tasks = [
        (world.walkers, world.true_rig, camera, stage, path) for camera, path in enumerate(paths)
    ]
    workers = min(processor_count(), cameras) if workers is None else workers
    if workers < 1:
        raise InvalidInputError(f"workers is {workers}; it must be at least 1.")
    total, report = cameras * len(world.walkers.present), as_progress(progress)
    if workers == 1:
        done, ground = 0, ground_picture(stage)
        for task in tasks:
            for count in _render_camera(*task, ground):
                done += count
                report(STAGE_NAME, done, total)
    else:
        _render_in_processes(tasks, workers, total, report)
    return paths


def _render_in_processes(
    tasks: list[tuple[Any, ...]], workers: int, total: int, progress: Progress
) -> None:
    reports = SPAWN.SimpleQueue()
    try:
        with spawned_pool(workers, reports) as pool:
            begun = [pool.submit(_work, *task) for task in tasks]
            for task in as_they_end(begun, reports, lambda done: progress(STAGE_NAME, done, total)):
                task.result()
    except BrokenProcessPool as error:
        raise CatFreeError(
            "The rendering processes ended early. Call render_videos from under "
            "`if __name__ == '__main__':`, or with workers=1."
        ) from error


_kept: dict[str, Any] = {}  # in worker processes: the common ground picture


def _work(walkers: Walkers, rig: Rig, camera: int, stage: Stage, path: Path) -> None:
    """Render a camera in a worker process."""
    if not _kept:
        _kept["ground"] = ground_picture(stage)
    for count in _render_camera(walkers, rig, camera, stage, path, _kept["ground"]):
        from_parent["reports"].put(count)


def _render_camera(
    walkers: Walkers,
    rig: Rig,
    camera: int,
    stage: Stage,
    path: Path,
    ground: tuple[np.ndarray, np.ndarray],
) -> Iterator[int]:
    """Write one camera's video, yielding the number of frames since the last yield."""
    background = render_background(stage, rig, camera, ground)
    painter = Painter(walkers, rig, camera, background, stage)
    size = (int(rig.image_size[camera, 0]), int(rig.image_size[camera, 1]))
    with replacement(path) as partial:
        writer = cv2.VideoWriter(str(partial), cv2.VideoWriter.fourcc(*"mp4v"), walkers.fps, size)
        try:
            if not writer.isOpened():
                raise InvalidInputError(
                    f"OpenCV cannot write an MP4 video of {size[0]} x {size[1]} pixels to {path}. "
                    "Use even sizes."
                )
            frames, waiting = len(walkers.present), 0
            for frame in range(frames):
                writer.write(painter.paint(frame))
                waiting += 1
                if waiting == REPORT_EVERY or frame == frames - 1:
                    yield waiting
                    waiting = 0
        finally:
            writer.release()
