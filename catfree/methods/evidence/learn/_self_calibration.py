"""Self-calibration: noise, offsets and unit of a sequence, by grouping and learning in rounds."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from catfree.errors import InsufficientDataError
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.learn._noise import learn_noise, median_height
from catfree.methods.evidence.observe._boxes import Boxes, prepare_boxes
from catfree.methods.evidence.observe._measurement import Noise, measure_boxes, start_noise
from catfree.methods.evidence.observe._views import GroundViews, ground_views
from catfree.methods.evidence.observe._visibility import covered_feet
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._sampling import evenly_spread

# By how much the angular noise is widened at the start (8 times the usual is 1.4 degrees), and
# rounds: it can at most halve in each.
START_SEARCHES = ((1.0, 2), (8.0, 4))
# Where there are no camps the two searches differ by 1 or 2 % either way; where there are, by tens.
FAR_MORE_EVIDENCE = 1.05
START_BOXES = 1000  # teach which search is right; scenes with few people need frames as well
FEWEST_START_FRAMES = 5


def self_calibrate(
    detections: Detections, scene: Scene, settings: EvidenceSettings
) -> tuple[GroundViews, Noise]:
    """Learn the unit H0, the noise of the boxes and their offsets from part of the sequence."""
    detections = _subset(detections, settings.calibration_frames)
    boxes = prepare_boxes(detections, scene.rig, settings)
    unit = median_height(boxes, ground_views(scene, 1.0))
    if not np.isfinite(unit):
        raise InsufficientDataError(
            f"None of the {len(boxes.row)} boxes of registered cameras shows a whole person on the "
            "ground. Check that rig and ground plane belong to these detections."
        )
    start = _Learned(unit, start_noise(scene.rig.camera_count, settings))
    if not settings.self_calibrate:
        return ground_views(scene, unit), start.noise
    per_frame = len(boxes.row) / max(len(boxes.frames), 1)
    few = _subset(detections, max(FEWEST_START_FRAMES, int(START_BOXES / max(per_frame, 1))))
    start = _likeliest_start(prepare_boxes(few, scene.rig, settings), scene, start, settings)
    rounds = settings.calibration_rounds
    learned = _learn(boxes, foot_cover(boxes), scene, start, settings, rounds)
    return ground_views(scene, learned.unit), learned.noise


class _Learned(NamedTuple):
    """What self-calibration knows: the unit H0 in scene units, and the noise of the boxes."""

    unit: float
    noise: Noise


def _learn(
    boxes: Boxes,
    covered: Float[np.ndarray, " box"],
    scene: Scene,
    known: _Learned,
    settings: EvidenceSettings,
    rounds: int,
) -> _Learned:
    """So many rounds of grouping and learning from the groups."""
    for _ in range(rounds):
        views = ground_views(scene, known.unit)
        measured = measure_boxes(boxes, covered, views, known.noise, settings)
        groups = group(boxes, measured, known.noise)
        noise, ratio = learn_noise(known.noise, groups, measured, boxes, views, settings)
        known = _Learned(known.unit * ratio, noise)
    return known


def _likeliest_start(
    boxes: Boxes, scene: Scene, start: _Learned, settings: EvidenceSettings
) -> _Learned:
    """Where self-calibration begins: sharp, unless it finds far more evidence if it begins vague.

    A sharp start is right where the rig is nearly right. In a rig that is wrong by more than that,
    cameras agree in camps, each of which sees every person in a place of its own and learns to
    trust itself. A vague start lets all cameras agree first, and then grows sharp; in a crowd it
    confuses neighbours.
    """
    evidence, learned = [], []
    covered = foot_cover(boxes)
    for widening, rounds in START_SEARCHES:
        angular = np.asarray(start.noise.angular * widening)
        begin = start._replace(noise=eqx.tree_at(lambda n: n.angular, start.noise, angular))
        end = _learn(boxes, covered, scene, begin, settings, rounds)
        views = ground_views(scene, end.unit)
        measured = measure_boxes(boxes, covered, views, end.noise, settings)
        evidence.append(float(group(boxes, measured, end.noise).gain.sum()))
        learned.append(end)
    return learned[1] if evidence[1] > FAR_MORE_EVIDENCE * evidence[0] else start


def foot_cover(boxes: Boxes) -> Float[np.ndarray, " box"]:
    """Share of the lower part of each box that boxes in front of it hide."""
    return np.asarray(covered_feet(boxes.box, boxes.frame, boxes.camera, boxes.table))


def _subset(detections: Detections, limit: int) -> Detections:
    """Detections of at most `limit` frames, evenly spread."""
    frames = np.unique(detections.frame)
    if len(frames) <= limit:
        return detections
    return detections[np.isin(detections.frame, evenly_spread(frames, limit))]
