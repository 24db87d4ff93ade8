"""Scenes from videos: reconstruct instants, aggregate them and find the ground."""

import numpy as np

from catfree.adapters.protocols import Reconstructor
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import require_part
from catfree.calibration.reconstructions._aggregate import aggregate
from catfree.calibration.reconstructions._ground import find_ground
from catfree.errors import InsufficientDataError
from catfree.types import Detections, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._validation import as_count, require_instance
from catfree.types.results._reconstruction import Reconstruction

INSTANTS = 12  # reconstructed instants; four of them may be wrong


def scene_from_videos(
    videos: SynchronizedVideos,
    reconstructor: Reconstructor,
    detections: Detections | None = None,
    progress: Progress | None = None,
    *,
    instants: int = INSTANTS,
    seed: int = 0,
) -> Scene:
    """Reconstruct cameras and ground from evenly spread instants that all cameras show.

    Args:
        videos: the cameras' videos.
        reconstructor: reconstructs the cameras of one instant.
        detections: boxes of people, to distinguish the ground from walls; None to use only cameras.
        progress: called as `progress("reconstruction", done, instants)`.
        instants: number of instants to reconstruct.
        seed: seed of the search for the ground.

    Returns:
        The scene, in meters if the reconstructor's units are.

    Raises:
        InvalidInputError: if an argument has another type, or the reconstructor returns anything
            but a `Reconstruction`.
        InsufficientDataError: if no instant is in all videos or has two registered cameras.
        GroundRejectedError: if no plane of the scene can be the ground.
    """
    require_instance(videos, SynchronizedVideos, "videos")
    require_part(reconstructor, "reconstructor")
    instants = as_count(instants, "instants", least=1)
    report = as_progress(progress)
    complete = np.flatnonzero(~np.isin(videos.frames, videos.silent[:, 0]))
    if not len(complete):
        raise InsufficientDataError(f"No instant is in all {videos.camera_count} videos.")
    count = min(instants, len(complete))
    # The centers of equal parts, because the first and last instants are often unusable.
    chosen = complete[((np.arange(count) + 0.5) * len(complete) / count).astype(int)]
    reconstructions = []
    for done, position in enumerate(chosen):
        report("reconstruction", done, count)
        _, images = next(iter(videos.instants_from(int(position))))
        reconstruction = reconstructor(images)
        require_instance(
            reconstruction, Reconstruction, f"What {type(reconstructor).__name__} returns"
        )
        reconstructions.append(reconstruction)
    report("reconstruction", count, count)
    aggregated = aggregate(reconstructions, videos.image_size)
    ground = find_ground(
        aggregated.points, aggregated.rig, detections, confidence=aggregated.confidence, seed=seed
    )
    return Scene.from_rig(aggregated.rig, ground.plane, metric=aggregated.metric)
