"""Height of the tracked people in scene units, for the posts that represent them in images."""

import numpy as np
from jaxtyping import Float

from catfree.geometry.camera import rays_of_pixels
from catfree.types import Detections, Localization, Scene


def person_height(detections: Detections, localization: Localization, scene: Scene) -> float:
    """Estimate the median height of the tracked people from the upper edges of their boxes.

    Args:
        detections: person boxes of the sequence.
        localization: the result of `cf.localize` for them.
        scene: the scene that it was made with.

    Returns:
        Scene units; 0 if no box shows a tracked person.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    tracks, heights = localization.tracks, [np.zeros(0)]
    if len(detections) == 0:
        return 0.0
    localization.require_detections(detections)
    for camera in np.flatnonzero(scene.rig.registered[: tracks.support.shape[1]]):
        row = np.flatnonzero(tracks.support[:, camera] >= 0)
        boxes = detections[tracks.support[row, camera]]
        heights.append(_heights(boxes, tracks.position[row], scene, int(camera)))
    values = np.concatenate(heights)
    values = values[np.isfinite(values) & (values > 0)]
    return float(np.median(values)) if len(values) else 0.0


def _heights(
    boxes: Detections, position: Float[np.ndarray, "n 3"], scene: Scene, camera: int
) -> Float[np.ndarray, " n"]:
    """Height at which each box's upper-edge ray is closest to the vertical at the position."""
    top = np.stack([(boxes.box[:, 0] + boxes.box[:, 2]) / 2, boxes.box[:, 1]], -1)
    ray = rays_of_pixels(scene.rig, camera, top)
    up = np.asarray(scene.ground.normal, np.float64)
    sight = position - np.asarray(scene.rig.centers, np.float64)[camera]
    # Least squares of depth * ray = sight + height * up.
    slope = ray @ up
    with np.errstate(divide="ignore", invalid="ignore"):
        return (slope * np.sum(ray * sight, -1) - sight @ up) / (1 - slope**2)
