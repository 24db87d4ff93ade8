"""Which track each box of a picture shows, and how tall people are in scene units."""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from catfree.settings import AssociationSettings, RaySettings
from catfree.types import Detections, Localization, Scene, Tracks
from catfree.viz._camera_view import rays_of_pixels

# A foot ray misses the position it belongs to by at most this many radians: the paper's tolerance.
TOLERANCE = AssociationSettings().residual_factor * RaySettings().sigma_theta
SAMPLED_FRAMES = 40  # frames that teach how tall people are


def box_identities(
    detections: Detections, tracks: Tracks, scene: Scene, camera: int
) -> Int[np.ndarray, " n"]:
    """The row of the track position that each box shows.

    Boxes and positions of one instant are matched one to one so that foot rays pass closest.

    Args:
        detections: the boxes of one picture.
        tracks: the track positions of the same instant.
        scene: the scene.
        camera: the picture's camera.

    Returns:
        (N,) row of `tracks`, or -1 for a box that shows no tracked person.
    """
    found = np.full(len(detections), -1)
    if len(detections) == 0 or len(tracks) == 0:
        return found
    ray = rays_of_pixels(scene.rig, camera, detections.foot)
    sight = tracks.position - np.asarray(scene.rig.centers, np.float64)[camera]
    sight = sight / np.maximum(np.linalg.norm(sight, axis=-1, keepdims=True), 1e-300)
    # The chord is twice the sine of half the angle: exact for small angles too.
    chord = np.linalg.norm(ray[:, None] - sight[None], axis=-1)
    angle = 2 * np.arcsin(np.clip(chord / 2, 0, 1))
    boxes, rows = linear_sum_assignment(np.minimum(angle, TOLERANCE))
    close = angle[boxes, rows] < TOLERANCE
    found[boxes[close]] = rows[close]
    return found


def person_height(detections: Detections, localization: Localization, scene: Scene) -> float:
    """Median height of the tracked people in scene units, from the upper edges of their boxes.

    Returns:
        Scene units; 0 if no box shows a tracked person.
    """
    tracks, heights = localization.tracks, []
    frames = np.unique(tracks.frame)
    chosen = frames[:: max(len(frames) // SAMPLED_FRAMES, 1)]
    for frame in chosen:
        now = tracks[tracks.frame == frame]
        seen = detections[detections.frame == frame]
        for camera in np.unique(seen.camera):
            if camera < scene.rig.camera_count and scene.rig.registered[camera]:
                boxes = seen[seen.camera == camera]
                rows = box_identities(boxes, now, scene, int(camera))
                matched = rows >= 0
                heights.append(
                    _heights(boxes[matched], now.position[rows[matched]], scene, int(camera))
                )
    values = np.concatenate(heights) if heights else np.zeros(0)
    values = values[np.isfinite(values) & (values > 0)]
    return float(np.median(values)) if len(values) else 0.0


def _heights(
    boxes: Detections, position: Float[np.ndarray, "n 3"], scene: Scene, camera: int
) -> Float[np.ndarray, " n"]:
    """Where the ray of each box's upper edge passes closest to the vertical above the position."""
    top = np.stack([(boxes.box[:, 0] + boxes.box[:, 2]) / 2, boxes.box[:, 1]], -1)
    ray = rays_of_pixels(scene.rig, camera, top)
    up = np.asarray(scene.ground.normal, np.float64)
    sight = position - np.asarray(scene.rig.centers, np.float64)[camera]
    # Least squares of depth * ray = sight + height * up.
    slope = ray @ up
    with np.errstate(divide="ignore", invalid="ignore"):
        return (slope * np.sum(ray * sight, -1) - sight @ up) / (1 - slope**2)
