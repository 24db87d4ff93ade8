"""The evidence method, stage by stage: measure, self-calibrate, associate, exist, track."""

from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InsufficientDataError
from catfree.evidence.appearance import compare_frames, group_agreement, learn_ratio
from catfree.evidence.association import Groups, Priors, associate
from catfree.evidence.boxes import Boxes, prepare_boxes
from catfree.evidence.constants import EvidenceSettings
from catfree.evidence.existence import (
    Existence,
    judge_groups,
    misses,
    predict_views,
)
from catfree.evidence.gaussian import mean_and_covariance
from catfree.evidence.measurement import Measurements, Noise, measure_boxes, start_noise
from catfree.evidence.noise import learn_noise, median_height
from catfree.evidence.tracking import (
    Trails,
    estimate_motion,
    follow,
    presence,
)
from catfree.evidence.views import GroundViews, ground_views
from catfree.evidence.visibility import covered_feet, learn_detection_rate
from catfree.types import Detections, Scene

Progress = Callable[[str, int, int], None]


class Solution(eqx.Module):
    """Everything the method found, in units of H0 on the plane (see `GroundViews`)."""

    boxes: Boxes
    views: GroundViews
    noise: Noise
    measurements: Measurements
    groups: Groups
    existence: Existence
    state: Float[np.ndarray, "group 3"]
    covariance: Float[np.ndarray, "group 3 3"]
    trails: Trails
    evidence: Float[np.ndarray, " node"]
    probability: Float[np.ndarray, " node"]
    kept: Bool[np.ndarray, " node"]


def calibration_subset(detections: Detections, limit: int) -> Detections:
    frames = np.unique(detections.frame)
    if len(frames) <= limit:
        return detections
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, limit).round().astype(int))]
    return detections[np.isin(detections.frame, chosen)]


def self_calibrate(detections: Detections, scene: Scene, settings: EvidenceSettings):
    """Learn noise, offsets and H0 from a part of the sequence."""
    boxes = prepare_boxes(
        calibration_subset(detections, settings.calibration_frames), scene.rig, settings
    )
    views = ground_views(scene, 1.0)
    unit = median_height(boxes, views)
    if not np.isfinite(unit):
        raise InsufficientDataError("no box stands on the ground")
    views = ground_views(scene, unit)
    noise = start_noise(scene.rig.camera_count, settings)
    covered = np.asarray(covered_feet(boxes.box, boxes.frame, boxes.camera, boxes.table))
    if not settings.self_calibrate:
        return views, noise
    for _ in range(settings.calibration_rounds):
        measured = measure_boxes(boxes, covered, views, noise, settings)
        groups = _group(boxes, measured, noise, None, None, None)
        noise, ratio = learn_noise(noise, groups, measured, boxes, views, settings)
        unit = unit * ratio
        views = ground_views(scene, unit)
    return views, noise


def _group(boxes, measured, noise, looks, slot, priors) -> Groups:
    return associate(
        measured.info, measured.state[:, :2], measured.covariance[:, :2, :2],
        np.minimum(boxes.frame, len(boxes.frames) - 1), boxes.camera, measured.valid,
        boxes.table.shape[1], float(noise.density), float(noise.spread), looks, slot, priors,
    )  # fmt: skip


def solve(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings,
    *,
    progress: Progress | None = None,
) -> Solution:
    """Find the people of a sequence."""
    with jax.enable_x64(True):
        return _solve(detections, scene, settings, progress)


def _solve(detections, scene, settings: EvidenceSettings, progress) -> Solution:
    views, noise = self_calibrate(detections, scene, settings)
    boxes = prepare_boxes(detections, scene.rig, settings)
    covered = np.asarray(covered_feet(boxes.box, boxes.frame, boxes.camera, boxes.table))
    measured = measure_boxes(boxes, covered, views, noise, settings)
    spread, density = float(noise.spread), float(noise.density)
    appearance = compare_frames(boxes) if settings.use_appearance else None
    ratio = looks = slot = None
    if appearance is not None:
        groups = _group(boxes, measured, noise, None, None, None)
        ratio = learn_ratio(appearance, groups, settings)
        if ratio is not None:
            looks, slot = settings.appearance_weight * ratio, appearance.slot
    time = boxes.frames.astype(float)
    step = np.median(np.diff(time)) if len(time) > 1 else 1.0
    time = (time - time[0]) / step
    priors = None
    for index in range(settings.passes if settings.track else 1):
        groups = _group(boxes, measured, noise, looks, slot, priors)
        state, covariance = mean_and_covariance(groups.info, spread)
        agreement = np.zeros(len(groups))
        if ratio is not None:
            views_count = (groups.member >= 0).sum(1)
            pairs = np.maximum(views_count * (views_count - 1) / 2, 1)
            agreement = (
                settings.appearance_weight * (views_count - 1)
                * group_agreement(ratio, appearance, groups.member) / pairs
            )  # fmt: skip
        seen = predict_views(state, groups.frame, groups.member, boxes, views)
        n = len(boxes.row)
        rate = learn_detection_rate(seen, groups.member, boxes.size[:n], boxes.camera[:n], settings)
        probability = rate(seen)
        existence = judge_groups(groups, agreement, measured, boxes, views, probability, settings)
        sure = ((groups.member >= 0).sum(1) >= min(3, boxes.table.shape[1])) & (
            existence.log_odds > 3
        )
        motion = estimate_motion(state[sure, :2], groups.frame[sure], time)
        if not settings.track or len(time) == 1:
            time_free = np.arange(len(groups))
            trails = Trails(time_free, groups.frame, time_free,
                            np.concatenate([state, np.zeros((len(groups), 2))], 1),
                            np.pad(covariance, ((0, 0), (0, 2), (0, 2))))  # fmt: skip
            evidence = existence.log_odds
            probability = 1 / (1 + np.exp(-evidence))
            kept = evidence > 0
            break
        trails = follow(groups, existence.log_odds, time, motion, density, spread, settings)
        evidence = _node_evidence(trails, existence, boxes, views, rate, settings)
        probability = presence(trails, evidence, settings.appear_evidence, settings.leave_evidence)
        kept = probability > 0.5
        if index < settings.passes - 1:
            priors = _track_priors(trails[kept], groups)
        if progress is not None:
            progress("evidence", index + 1, settings.passes)
    return Solution(
        boxes,
        views,
        noise,
        measured,
        groups,
        existence,
        state,
        covariance,
        trails,
        evidence,
        probability,
        kept,
    )


def _node_evidence(trails, existence, boxes, views, rate, settings) -> np.ndarray:
    limit = settings.evidence_limit
    evidence = np.zeros(len(trails))
    seen = trails.group >= 0
    evidence[seen] = existence.log_odds[trails.group[seen]]
    gaps = np.flatnonzero(~seen)
    if len(gaps):
        member = np.full((len(gaps), boxes.table.shape[1]), -1)
        expected = predict_views(trails.mean[gaps, :3], trails.frame[gaps], member, boxes, views)
        evidence[gaps] = misses(rate(expected), member)
    return np.clip(evidence, -limit, limit)


def _track_priors(trails: Trails, groups: Groups) -> Priors:
    """Smoothed positions without what the frame itself had to say."""
    precision = np.linalg.inv(trails.covariance[:, :3, :3])
    vector = np.einsum("nij,nj->ni", precision, trails.mean[:, :3])
    seen = trails.group >= 0
    own = groups.info[trails.group[seen]]
    precision[seen] -= own.matrix
    vector[seen] -= own.vector
    # Never vaguer than a person who may be anywhere within a few metres.
    values, axes = np.linalg.eigh(precision)
    values = np.maximum(values, 0.05)
    covariance = np.einsum("nij,nj,nkj->nik", axes, 1 / values, axes)
    mean = np.einsum("nij,nj->ni", covariance, vector)
    order = np.lexsort((trails.track, trails.frame))
    return Priors(trails.frame[order], mean[order], covariance[order])
