"""Height of the tracked people in scene units, for the posts that represent them in images."""

import numpy as np

from catfree.geometry import CanonicalFrame
from catfree.geometry._person import heights_in_rig
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
    if len(detections) == 0:
        return 0.0
    localization.require_detections(detections)
    support, frame = localization.tracks.support, CanonicalFrame.of(scene)
    row, camera = np.nonzero(support >= 0)
    box = detections.box[support[row, camera]]
    top = np.stack([(box[:, 0] + box[:, 2]) / 2, box[:, 1]], -1)
    place = frame.to_canonical(localization.tracks.position[row])[:, :2]
    values = frame.extent * heights_in_rig(frame.rig(scene.rig), camera, top, place)
    values = values[values > 0]
    return float(np.median(values)) if len(values) else 0.0
