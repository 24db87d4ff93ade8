"""Turn each box of a sequence into a likelihood: the state before the first pass."""

import numpy as np
from jaxtyping import Bool, Int

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.group._groups import no_groups
from catfree.methods.evidence.observe._boxes import prepare_boxes
from catfree.methods.evidence.observe._measurement import Noise, measure_boxes
from catfree.methods.evidence.observe._views import ground_views
from catfree.methods.evidence.observe._visibility import rate_of_counts, usual_heights
from catfree.methods.evidence.track._existence import not_judged
from catfree.methods.evidence.track._tracking import no_trails, usual_motion
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
        silent: (K, 2) frame and camera of missing pictures.
        keep: (N,) detections to use; None for all.
        frames: (F,) sorted frame numbers, with or without boxes; None for those with boxes.

    Returns:
        A state without groups and tracks; what is learned from them has its usual value.
    """
    boxes = prepare_boxes(detections, scene.rig, settings, silent, frames, keep)
    views = ground_views(scene, unit, boxes)
    cameras = boxes.table.shape[1]
    heights = usual_heights(boxes.size, boxes.camera, cameras, settings)
    nobody, rows, numbers = np.zeros((cameras, 3, 5)), np.zeros(0, np.int64), np.zeros(0)
    return EvidenceState(
        boxes=boxes,
        views=views,
        noise=noise,
        measurements=measure_boxes(boxes, views, noise, settings),
        ratios=None,
        groups=no_groups(cameras),
        place=np.zeros((0, 3)),
        rate=rate_of_counts(heights, nobody, nobody, settings),
        existence=not_judged(0, cameras),
        motion=usual_motion(settings),
        trails=no_trails(),
        evidence=numbers,
        probability=numbers,
        position_covariance=np.zeros((0, 2, 2)),
        coverage=np.zeros((0, 2)),
        fate=rows,
        identity=rows,
    )
