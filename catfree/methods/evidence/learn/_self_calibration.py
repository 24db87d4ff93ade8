"""Self-calibrate noise, offsets and unit of a sequence by alternating grouping and learning."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from catfree.errors import InsufficientDataError
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.learn._noise import learn_noise, median_height
from catfree.methods.evidence.observe._boxes import Boxes, prepare_boxes
from catfree.methods.evidence.observe._measurement import (
    Measurements,
    Noise,
    measure_boxes,
    start_noise,
)
from catfree.methods.evidence.observe._views import GroundViews, ground_views
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._sampling import evenly_spread

ROUNDS = 3  # the third changes the noise by a few percent
START_ROUNDS = (2, 4)  # of the low and the high start: each round can at most halve the noise
START_BOXES = 1000  # boxes used to choose the start; scenes with few people also need frames
FEWEST_START_FRAMES = 5  # a minimum of frames for scenes with few people


def self_calibrate(
    detections: Detections, scene: Scene, settings: EvidenceSettings
) -> tuple[float, Noise]:
    """Learn the unit H0, the noise of the boxes and their offsets from part of the sequence."""
    detections = _subset(detections, settings.calibration_frames)
    boxes = prepare_boxes(detections, scene.rig, settings)
    unit = median_height(boxes, ground_views(scene, 1.0, boxes))
    if not np.isfinite(unit):
        raise InsufficientDataError(
            f"None of the {len(boxes.row)} boxes of registered cameras shows a whole person on the "
            "ground; check that rig and ground plane belong to these detections."
        )
    start = _Learned(unit, start_noise(scene.rig.camera_count, settings))
    if not settings.self_calibrate:
        return unit, start.noise
    per_frame = len(boxes.row) / max(len(boxes.frames), 1)
    few = _subset(detections, max(FEWEST_START_FRAMES, int(START_BOXES / max(per_frame, 1))))
    sample = boxes if few is detections else prepare_boxes(few, scene.rig, settings)
    search, done = _likeliest_start(sample, scene, start, settings)
    if few is not detections:
        search, done = _Search(boxes, scene, search.after(done), settings), 0
    learned = search.after(done + ROUNDS)
    return learned.unit, learned.noise


def learn_once_more(
    detections: Detections, scene: Scene, unit: float, noise: Noise, settings: EvidenceSettings
) -> tuple[float, Noise]:
    """One more round of `self_calibrate`, from what was learned before."""
    detections = _subset(detections, settings.calibration_frames)
    boxes = prepare_boxes(detections, scene.rig, settings)
    return _Search(boxes, scene, _Learned(unit, noise), settings).after(1)


class _Learned(NamedTuple):
    """Learned quantities: the unit H0 in scene units, and the noise of the boxes."""

    unit: float
    noise: Noise


class _Grouped(NamedTuple):
    """The groups made with one set of learned quantities."""

    views: GroundViews
    measured: Measurements
    groups: Groups


class _Search:
    """Rounds of grouping and learning, each computed once.

    Args:
        boxes: the boxes to learn from.
        scene: rig and ground.
        start: initial quantities.
        settings: constants.
    """

    def __init__(
        self, boxes: Boxes, scene: Scene, start: _Learned, settings: EvidenceSettings
    ) -> None:
        self._boxes, self._scene, self._settings = boxes, scene, settings
        self._learned = [start]
        self._last: tuple[int, _Grouped] | None = None

    def after(self, rounds: int) -> _Learned:
        """Learned quantities after a number of rounds."""
        while len(self._learned) <= rounds:
            learned, grouped = self._learned[-1], self._grouped(len(self._learned) - 1)
            noise, ratio = learn_noise(
                learned.noise, grouped.groups, grouped.measured, self._boxes, grouped.views,
                self._settings,
            )  # fmt: skip
            self._learned.append(_Learned(learned.unit * ratio, noise))
        return self._learned[rounds]

    def evidence(self, rounds: int) -> float:
        """Log evidence of the groups after a number of rounds."""
        return float(self._grouped(rounds).groups.gain.sum())

    def _grouped(self, rounds: int) -> _Grouped:
        learned = self.after(rounds)
        if self._last is None or self._last[0] != rounds:
            views = ground_views(self._scene, learned.unit, self._boxes)
            measured = measure_boxes(self._boxes, views, learned.noise, self._settings)
            groups = group(self._boxes, measured, learned.noise, self._settings.gate)
            self._last = rounds, _Grouped(views, measured, groups)
        return self._last[1]


def _likeliest_start(
    boxes: Boxes, scene: Scene, start: _Learned, settings: EvidenceSettings
) -> tuple[_Search, int]:
    """Choose between a low and a high initial noise; high only if it yields far more evidence.

    A low initial noise is right if the rig is nearly correct. With a less accurate rig, the cameras
    split into subsets that place every person at different positions, and learning reinforces the
    split. A high initial noise lets all cameras agree before it decreases, but in a crowd it
    confuses neighbors.

    Returns:
        The search, and the number of its rounds to start from.
    """
    searches, evidence = [], []
    starts = (settings.angular_noise, 2 * settings.angular_noise_range[1])
    for angular, rounds in zip(map(np.asarray, starts), START_ROUNDS, strict=True):
        begin = start._replace(noise=eqx.tree_at(lambda n: n.angular, start.noise, angular))
        searches.append(_Search(boxes, scene, begin, settings))
        evidence.append(searches[-1].evidence(rounds))
    # From too few people nothing is learned, and the high start is not an estimate.
    learned = searches[1].after(START_ROUNDS[1]).noise.angular <= settings.angular_noise_range[1]
    vague = learned and evidence[1] > settings.far_more_evidence * evidence[0]
    return (searches[1], START_ROUNDS[1]) if vague else (searches[0], 0)


def _subset(detections: Detections, limit: int) -> Detections:
    """Select the detections of at most `limit` evenly spread frames."""
    frames = np.unique(detections.frame)
    if len(frames) <= limit:
        return detections
    return detections[np.isin(detections.frame, evenly_spread(frames, limit))]
