"""Height of the tracked people in scene units, for the posts that represent them in images."""

import numpy as np

from catfree.geometry._person import heights_by_boxes
from catfree.types import Detections, Localization, Scene


def person_height(detections: Detections, localization: Localization, scene: Scene) -> float:
    """Estimate the median height of the tracked people from the upper edges of their boxes.

    Args:
        detections: person boxes of the sequence.
        localization: the result of `cf.localize` for them.
        scene: the scene used for it.

    Returns:
        Scene units; 0 if no box shows a tracked person.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    if len(detections) == 0:
        return 0.0
    _, _, height = heights_by_boxes(detections, localization, scene)
    height = height[height > 0]
    return float(np.median(height)) if len(height) else 0.0
