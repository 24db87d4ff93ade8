"""Make people unrecognizable in the cameras' images."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from catfree.adapters.protocols import Image
from catfree.geometry import CanonicalFrame
from catfree.geometry._person import people_in_rig
from catfree.types import Detections, Localization, Scene
from catfree.viz.footage._drawing import in_reach

BLOCKS = 5  # a blurred person is about this many colors across
MARGIN = 0.15  # beyond each side of a box, as a share of its width, because boxes cut off limbs
WIDTH_SHARE = 0.5  # width of a standing person with some room, in person heights


def blur_regions(image: Image, box: Float[np.ndarray, "n 4"]) -> Image:
    """Replace boxes of an image by few smooth blocks of color, which cannot be undone.

    Args:
        image: (H, W, 3) uint8 RGB.
        box: (N, 4) x1, y1, x2, y2 in pixels; parts outside the image are ignored.

    Returns:
        A copy.
    """
    import cv2

    blurred = image.copy()
    size = np.array([image.shape[1], image.shape[0]])
    border = MARGIN * np.abs(box[:, 2:3] - box[:, 0:1])
    low = np.clip(np.floor(box[:, :2] - border), 0, size).astype(int)
    high = np.clip(np.ceil(box[:, 2:] + border) + 1, 0, size).astype(int)
    for (x1, y1), (x2, y2) in zip(low, high, strict=True):
        if x2 <= x1 or y2 <= y1:
            continue
        part = blurred[y1:y2, x1:x2]
        side = max((x2 - x1) / BLOCKS, 1.0)
        few = (min(BLOCKS, x2 - x1), max(round((y2 - y1) / side), 1))
        mean = cv2.resize(part, few, interpolation=cv2.INTER_AREA)
        part[:] = cv2.resize(mean, (x2 - x1, y2 - y1), interpolation=cv2.INTER_LINEAR)
    return blurred


def blur_people(
    images: Sequence[Image],
    frame: int | np.integer,
    detections: Detections,
    localization: Localization,
    scene: Scene,
    person_height: float,
) -> list[Image]:
    """Blur everybody known (`people_regions`) in copies of all cameras' images of one frame."""
    results = (detections, localization, scene, person_height)
    return [
        blur_regions(image, people_regions(camera, frame, *results))
        for camera, image in enumerate(images)
    ]


def people_regions(
    camera: int,
    frame: int | np.integer,
    detections: Detections,
    localization: Localization,
    scene: Scene,
    person_height: float,
) -> Float[np.ndarray, "n 4"]:
    """List the boxes of everybody known in an image: detections and tracked people in view.

    Args:
        camera: index of the camera.
        frame: the frame of the image.
        detections: person boxes of the sequence.
        localization: the result of `cf.localize` for them.
        scene: the scene used for it.
        person_height: height of the people in scene units.

    Returns:
        (N, 4) x1, y1, x2, y2 in pixels, possibly beyond the image.
    """
    boxes = detections.box[(detections.frame == frame) & (detections.camera == camera)]
    if not scene.rig.registered[camera]:
        return boxes
    position = localization.tracks.position[localization.tracks.frame == frame]
    head, foot, in_front = posts(position, person_height, scene, camera)
    pixel = np.stack([foot, (foot + head) / 2, head], 1)
    size = scene.rig.image_size[camera]
    inside = ((pixel >= 0) & (pixel < size)).all(-1).any(-1)
    # The box of a person beside the camera, out of view, would cover the whole picture.
    shown = in_front & inside & in_reach(pixel, size).all(-1)
    foot, head = foot[shown], head[shown]
    half = WIDTH_SHARE / 2 * np.linalg.norm(head - foot, axis=-1, keepdims=True)
    corners = [np.minimum(foot, head) - half, np.maximum(foot, head) + half]
    return np.concatenate([boxes, np.concatenate(corners, axis=1)])


def posts(
    position: Float[np.ndarray, "n 3"], height: float, scene: Scene, camera: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Project the heads and feet of people of one height into an image.

    Args:
        position: (N, 3) positions of the people in scene units.
        height: height of the people in scene units.
        scene: the cameras and the ground.
        camera: index of the camera.

    Returns:
        (N, 2) heads and (N, 2) feet in pixels, and (N,) whether the camera images both.
    """
    frame = CanonicalFrame.of(scene)
    person = frame.to_canonical(position)
    person[:, 2] = height / frame.extent
    return people_in_rig(frame.rig(scene.rig), camera, person)
