"""First pass: learn the noise of a sequence and turn each of its boxes into a likelihood."""

import numpy as np
from jaxtyping import Bool, Int

from catfree.methods.evidence._state import EvidenceState, first_state
from catfree.methods.evidence.learn._self_calibration import self_calibrate
from catfree.methods.evidence.observe._boxes import prepare_boxes
from catfree.methods.evidence.observe._measurement import measure_boxes
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene


def observe_boxes(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings,
    silent: Int[np.ndarray, "k 2"] | None = None,
    keep: Bool[np.ndarray, " n"] | None = None,
) -> EvidenceState:
    """Learn unit and noise, and measure every box.

    Args:
        detections: boxes of all cameras and frames, in any order.
        scene: rig and ground.
        settings: constants and switches.
        silent: (K, 2) frame and camera of pictures that do not exist.
        keep: (N,) detections to use; None for all.

    Returns:
        A state without groups and tracks.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    used = detections if keep is None else detections[keep]
    unit, noise = self_calibrate(used, scene, settings)
    del used  # a copy of all embeddings
    boxes = prepare_boxes(detections, scene.rig, settings, silent, keep=keep)
    views = ground_views(scene, unit, boxes)
    measured = measure_boxes(boxes, views, noise, settings)
    return first_state(boxes, views, noise, measured, settings)
