"""Turn each box of a sequence into a likelihood: the state before the first pass."""

import numpy as np
from jaxtyping import Bool, Int

from catfree.methods.evidence._state import EvidenceState, first_state
from catfree.methods.evidence.observe._boxes import prepare_boxes
from catfree.methods.evidence.observe._measurement import Noise, measure_boxes
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene


def observe_boxes(
    detections: Detections,
    scene: Scene,
    unit: float,
    noise: Noise,
    settings: EvidenceSettings,
    silent: Int[np.ndarray, "k 2"] | None = None,
    keep: Bool[np.ndarray, " n"] | None = None,
    frames: Int[np.ndarray, " frame"] | None = None,
) -> EvidenceState:
    """Measure every box.

    Args:
        detections: boxes of all cameras and frames, in any order.
        scene: rig and ground.
        unit: H0 in scene units.
        noise: of the boxes.
        settings: constants and switches.
        silent: (K, 2) frame and camera of pictures that do not exist.
        keep: (N,) detections to use; None for all.
        frames: (F,) sorted frame numbers, with boxes or without; None for those with boxes.

    Returns:
        A state without groups and tracks.
    """
    boxes = prepare_boxes(detections, scene.rig, settings, silent, frames, keep)
    views = ground_views(scene, unit, boxes)
    measured = measure_boxes(boxes, views, noise, settings)
    return first_state(boxes, views, noise, measured, settings)
