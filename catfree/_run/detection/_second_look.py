"""A second detection pass, guided by where the tracks predict people.

Tracks and cameras predict each person's place in every image. This helps where silhouettes merge,
because other cameras and moments tell the people apart. The detector still reports only what its
own image shows.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree._run.detection._camera_detectors import CameraDetectors
from catfree.adapters.protocols import Embedder, Image
from catfree.adapters.video._detect_videos import Seen, collect_detections
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._validate_plugin_output import Describer, ask_for_people
from catfree.geometry import CanonicalFrame
from catfree.geometry._person import edges_of, heights_by_boxes, people_in_rig
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types import Detections, Localization, Scene
from catfree.types._sampling import rows_of_picture

FEWEST_HEIGHTS = 5  # fewest boxes to estimate one person's height
EDGE = 2.0  # pixels: boxes closer to the image border are cut
SAME = 0.01  # pixels: boxes that moved less are unchanged


@dataclass(frozen=True)
class ExpectedPeople:
    """Predicted image positions of tracked people, one row per person and image.

    Attributes:
        frame: (K,) frame, in order.
        camera: (K,) camera.
        place: (K, 3) foot column, foot row and height in pixels; the foot is the visible sole,
            which is nearer to the camera than the body's axis.
    """

    frame: Int[np.ndarray, " k"]
    camera: Int[np.ndarray, " k"]
    place: Float[np.ndarray, "k 3"]

    def in_picture(self, frame: int, camera: int) -> Float[np.ndarray, "n 3"]:
        """Return the places in one image."""
        return self.place[rows_of_picture(self.frame, self.camera, frame, camera)]


def expected_people(
    localization: Localization, detections: Detections, scene: Scene
) -> ExpectedPeople:
    """Project every track position into every camera, with the height estimated from its boxes.

    Args:
        localization: the result of a method.
        detections: the localized detections.
        scene: the scene of the localization.

    Returns:
        People partly or fully inside the image, sorted by frame.
    """
    tracks, rig = localization.tracks, scene.rig
    cameras = np.flatnonzero(rig.registered)
    row = np.repeat(np.arange(len(tracks)), len(cameras))
    camera = np.tile(cameras, len(tracks))
    frame = CanonicalFrame.of(scene)
    upright = frame.rig(rig)
    person = frame.to_canonical(tracks.position)[row]
    person[:, 2] = track_heights(localization, detections, scene)[row] / frame.extent
    head, foot, imaged = people_in_rig(upright, camera, person, FOOT_AHEAD * person[:, 2])
    u, top, bottom = edges_of(head, foot).T
    width, rows = np.asarray(rig.image_size, np.float64)[camera].T
    distance = np.linalg.norm(upright.centers[camera, :2] - person[:, :2], axis=-1)
    is_visible = imaged & (distance > 0.5 * person[:, 2]) & (bottom - top > 1)
    is_visible &= (u > 0) & (u < width) & (top < rows) & (bottom > 0)
    place = np.stack([u, bottom, bottom - top], -1)
    return ExpectedPeople(tracks.frame[row][is_visible], camera[is_visible], place[is_visible])


def look_again(
    videos: SynchronizedVideos,
    cameras: CameraDetectors,
    embedder: Embedder | None,
    expected: ExpectedPeople,
    first: Detections,
) -> Detections:
    """Detect people again, given where they are expected.

    Args:
        videos: the footage of the first pass.
        cameras: their detectors, all of which are `GuidedDetector`.
        embedder: computes appearance embeddings, or None.
        expected: predicted places of people.
        first: detections of the first pass; unchanged boxes keep their embedding.

    Returns:
        One row per box, sorted by frame and camera.

    Raises:
        FileFormatError: as `detect_videos`.
        InsufficientDataError: as `detect_videos`.
    """
    describe = None
    if embedder is not None:
        looks = first.embedding
        describe = Describer(embedder, looks.shape[1] if looks is not None and len(looks) else None)
    in_order = first[np.argsort(first.frame, kind="stable")]
    look = partial(_look, describe, expected, in_order)
    return collect_detections(cameras.instants(videos, look, stage="second look"), videos)


def _look(
    describe: Describer | None,
    expected: ExpectedPeople,
    first: Detections,
    detectors: Mapping[int, Any],
    frame: int,
    pictures: Mapping[int, Image],
) -> dict[int, Seen]:
    """Detect people and embed them at one instant, given who is expected and the first boxes."""

    def look(camera: int, image: Image) -> Seen:
        places = expected.in_picture(frame, camera)
        people = ask_for_people(detectors[camera], image, camera, frame, places)
        if describe is None:
            return people, None
        first_rows = rows_of_picture(first.frame, first.camera, frame, camera)
        if first.embedding is None or not len(first_rows):
            return people, describe(image, people.box, camera, frame)
        offset = np.abs(people.box[:, None] - first.box[first_rows]).max(-1)
        changed = offset.min(1) > SAME
        vectors = first.embedding[first_rows[offset.argmin(1)]]
        vectors[changed] = describe(image, people.box[changed], camera, frame)
        return people, vectors

    return {camera: look(camera, picture) for camera, picture in pictures.items()}


def track_heights(
    localization: Localization, detections: Detections, scene: Scene
) -> Float[np.ndarray, " m"]:
    """Estimate the body height for each track position.

    This is the median over the person's uncut boxes of the height at which the vertical above the
    position is closest to the ray through the middle of the upper edge. People with too few such
    boxes get the median over all people.

    Args:
        localization: the result of a method.
        detections: the localized detections.
        scene: the scene of the localization.

    Returns:
        (M,) scene units, one value per person; 0 if no box is uncut.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    tracks = localization.tracks
    row, box, height = heights_by_boxes(detections, localization, scene)
    uncut = detections.box[box, 1] > EDGE
    if not uncut.any():
        return np.zeros(len(tracks))
    identity, height = tracks.track_id[row[uncut]], np.maximum(height[uncut], 0)
    usual = float(np.median(height))
    by_person = {
        one: np.median(height[identity == one])
        for one, count in zip(*np.unique(identity, return_counts=True), strict=True)
        if count >= FEWEST_HEIGHTS
    }
    return np.array([by_person.get(one, usual) for one in tracks.track_id])
