"""A scene from videos and a reconstructor: instants reconstructed, aggregated, put on a ground.

Beside the stages and not in `rig/`, because it opens videos: what is in `rig/` works on arrays.
"""

import numpy as np

from catfree.adapters.protocols import Reconstructor
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.calibration.reconstructions._aggregate import aggregate
from catfree.calibration.reconstructions._ground import find_ground
from catfree.types import Detections, Scene
from catfree.types._progress import Progress, no_progress

INSTANTS = 12  # reconstructed from a video: four of them may be garbage


def scene_from_videos(
    videos: SynchronizedVideos,
    reconstructor: Reconstructor,
    detections: Detections | None = None,
    progress: Progress | None = None,
    *,
    instants: int = INSTANTS,
    seed: int = 0,
) -> Scene:
    """Cameras and ground from some instants of videos, spread evenly over their length.

    Args:
        videos: the cameras' videos.
        reconstructor: finds the cameras of one instant.
        detections: people, who tell the ground from a wall; None to go by the cameras alone.
        progress: called as `progress("reconstruction", done, instants)`.
        instants: how many instants are reconstructed.
        seed: of the search for the ground.

    Returns:
        The scene, in metres if the reconstructor's units are.

    Raises:
        InsufficientDataError: if no instant shows two cameras that can be placed.
        GroundRejectedError: if no plane of the scene can be the ground.
    """
    report = progress or no_progress
    count = min(instants, videos.frame_count)
    # The middles of equal parts: the first and the last instants are often not usable.
    chosen = ((np.arange(count) + 0.5) * videos.frame_count / count).astype(int)
    reconstructions = []
    for done, position in enumerate(chosen):
        report("reconstruction", done, count)
        _, images = next(iter(videos.instants_from(int(position))))
        reconstructions.append(reconstructor(images))
    report("reconstruction", count, count)
    found = aggregate(reconstructions, videos.image_size)
    ground = find_ground(
        found.points, found.rig, detections, confidence=found.confidence, seed=seed
    )
    return Scene.from_rig(found.rig, ground.plane, metric=found.metric)
