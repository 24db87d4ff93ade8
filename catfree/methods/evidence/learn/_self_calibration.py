"""Self-calibration of noise, offsets and unit by alternating grouping and learning."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from catfree.errors import InsufficientDataError
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.learn._noise import learn_noise, median_height
from catfree.methods.evidence.observe._boxes import Boxes, prepare_boxes
from catfree.methods.evidence.observe._measurement import Noise, measure_boxes, start_noise
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._sampling import evenly_spread

ROUNDS = 3  # the third changes the noise by a few percent
START_ROUNDS = (2, 4)  # of the low and the high start; each round can at most halve the noise
START_BOXES = 1000  # boxes used to choose the start; scenes with few people also need frames
FEWEST_START_FRAMES = 5  # a minimum of frames for scenes with few people


class Learned(NamedTuple):
    """Learned quantities: the unit H0 in scene units, and the noise of the boxes."""

    unit: float
    noise: Noise


def self_calibrate(detections: Detections, scene: Scene, settings: EvidenceSettings) -> Learned:
    """Learn the unit H0, the noise of the boxes and their offsets from part of the sequence."""
    detections = _subset(detections, settings.calibration_frames)
    boxes = prepare_boxes(detections, scene.rig, settings)
    unit = median_height(boxes, ground_views(scene, 1.0, boxes))
    if not np.isfinite(unit):
        raise InsufficientDataError(
            f"None of the {len(boxes.row)} boxes of registered cameras shows a whole person on the "
            "ground; check that rig and ground plane belong to these detections."
        )
    start = Learned(unit, start_noise(scene.rig.camera_count, settings))
    if not settings.self_calibrate:
        return start
    per_frame = len(boxes.row) / max(len(boxes.frames), 1)
    few = _subset(detections, max(FEWEST_START_FRAMES, int(START_BOXES / max(per_frame, 1))))
    sample = boxes if few is detections else prepare_boxes(few, scene.rig, settings)
    learned = _likeliest_start(sample, scene, start, settings)
    for _ in range(ROUNDS):
        learned, _ = _learn_round(boxes, scene, learned, settings)
    return learned


def _learn_round(
    boxes: Boxes, scene: Scene, learned: Learned, settings: EvidenceSettings
) -> tuple[Learned, float]:
    """Group and learn once; return the result and the log evidence of the groups."""
    views = ground_views(scene, learned.unit, boxes)
    measured = measure_boxes(boxes, views, learned.noise, settings)
    groups = group(boxes, measured, learned.noise, settings.gate)
    noise, ratio = learn_noise(learned.noise, groups, measured, boxes, views, settings)
    return Learned(learned.unit * ratio, noise), float(groups.gain.sum())


def _likeliest_start(
    boxes: Boxes, scene: Scene, start: Learned, settings: EvidenceSettings
) -> Learned:
    """Choose a low initial noise, or a high one if that yields far more evidence.

    A low initial noise suits a nearly correct rig. With a less accurate rig, the cameras split into
    subsets that place every person at different positions, and learning reinforces the split. A
    high initial noise lets all cameras agree before it decreases, but in a crowd it confuses
    neighbors.

    Returns:
        The low initial noise, or the noise learned from the high one.
    """

    def settled(learned: Learned, rounds: int) -> tuple[Learned, float]:
        """Learn in rounds; return the result and the log evidence of the groups that it yields."""
        for _ in range(rounds):
            learned, _ = _learn_round(boxes, scene, learned, settings)
        return learned, _learn_round(boxes, scene, learned, settings)[1]

    highest = settings.angular_noise_range[1]
    vague = start._replace(noise=replace(start.noise, angular=np.array(2 * highest)))
    _, evidence = settled(start, START_ROUNDS[0])
    high, evidence_of_high = settled(vague, START_ROUNDS[1])
    # With too few people nothing is learned, and the high start is not an estimate.
    is_vague = evidence_of_high > settings.far_more_evidence * evidence
    return high if is_vague and high.noise.angular <= highest else start


def _subset(detections: Detections, limit: int) -> Detections:
    """Select the detections of at most `limit` evenly spread frames."""
    frames = np.unique(detections.frame)
    if len(frames) <= limit:
        return detections
    return detections[np.isin(detections.frame, evenly_spread(frames, limit))]
