"""The stages of the evidence method: self-calibrate, measure, associate, track, select."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence.group._appearance import (
    PairRatios,
    compare_frames,
    learn_ratio,
    looks_of,
)
from catfree.methods.evidence.group._group import appearance_log_odds, group, group_by_looks
from catfree.methods.evidence.group._groups import Groups, Priors
from catfree.methods.evidence.learn._self_calibration import foot_cover, self_calibrate
from catfree.methods.evidence.observe._boxes import Boxes, prepare_boxes
from catfree.methods.evidence.observe._measurement import Measurements, Noise, measure_boxes
from catfree.methods.evidence.observe._views import GroundViews, ground_views
from catfree.methods.evidence.observe._visibility import DetectionRate, learn_detection_rate
from catfree.methods.evidence.report._shared_error import shared_covariance
from catfree.methods.evidence.report._uneven_ground import ground_shift, with_uneven_ground
from catfree.methods.evidence.report._working_area import in_working_area
from catfree.methods.evidence.track._existence import (
    Existence,
    judge_groups,
    misses,
    predict_views,
    with_pictures,
)
from catfree.methods.evidence.track._identify import Population, identify
from catfree.methods.evidence.track._presence import presence
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.methods.evidence.track._tracking import Trails, estimate_motion, follow, unlinked
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._annotations import Progress, no_progress

SURE_LOG_ODDS = 3.0  # of the groups from which the speed of people is learned
VAGUEST_PRIOR = 0.05  # per H0²: a tracked person is within a few meters


class EvidenceSolution(eqx.Module):
    """All results of the method, in units of H0 on the plane (see `GroundViews`).

    Attributes:
        boxes, views, noise, measurements: the boxes, their cameras, noise and likelihoods.
        groups: boxes of one person in one frame; `existence`: the evidence for each group.
        state: (H, 3) position and height of each group; `covariance`: (H, 3, 3).
        trails: the tracks; `evidence`: (M,) log-odds of each of their rows.
        probability: (M,) that the person was present.
        suppressed: (M,) whether a better supported person is in the same place.
        outside: (M,) whether the position is outside the working area of the rig.
        kept: (M,) whether the row is reported.
        identity: (M,) who it is, of reported rows; -1 of others.
        position_covariance: (M, 2, 2) with sway, uneven ground and pose errors, as reported.
    """

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
    suppressed: Bool[np.ndarray, " node"]
    outside: Bool[np.ndarray, " node"]
    kept: Bool[np.ndarray, " node"]
    identity: Int[np.ndarray, " node"]
    position_covariance: Float[np.ndarray, "node 2 2"]


class _Pass(NamedTuple):
    """Results of one pass of association and tracking; see `EvidenceSolution`."""

    groups: Groups
    existence: Existence
    state: np.ndarray
    covariance: np.ndarray
    trails: Trails
    evidence: np.ndarray
    probability: np.ndarray


def solve(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    silent: Int[np.ndarray, "k 2"] | None = None,
    progress: Progress | None = None,
) -> EvidenceSolution:
    """Find the people of a sequence from the evidence of boxes and of missing boxes.

    Args:
        detections: boxes of all cameras and frames, in any order.
        scene: rig and ground in any units; cameras that are not registered are ignored.
        settings: constants and switches.
        silent: (K, 2) frame and camera of pictures that do not exist.
        progress: called as `progress(stage, done, total)`.

    Returns:
        Tracks and all intermediate results, in float64 regardless of JAX's configuration.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    settings = settings or EvidenceSettings()
    report = progress or no_progress
    with jax.enable_x64(True):
        report("self-calibration", 0, 1)
        unit, noise = self_calibrate(detections, scene, settings)
        boxes = prepare_boxes(detections, scene.rig, settings, silent)
        views = ground_views(scene, unit, boxes)
        measured = measure_boxes(boxes, foot_cover(boxes), views, noise, settings)
        return _solve(boxes, measured, views, noise, settings, report)


def _solve(
    boxes: Boxes,
    measured: Measurements,
    views: GroundViews,
    noise: Noise,
    settings: EvidenceSettings,
    report: Progress,
) -> EvidenceSolution:
    spread, density = float(noise.spread), float(noise.density)
    appearance = compare_frames(boxes) if settings.use_appearance else None
    likeness = None
    if appearance is not None:
        likeness = learn_ratio(appearance, group(boxes, measured, noise), settings)
    ratios = None
    if appearance is not None and likeness is not None:
        ratios = PairRatios(appearance, likeness, settings.appearance_weight)
    time = _steps(boxes.frames)
    # A single instant has no tracks: every group is judged on its own.
    passes = settings.passes if settings.track and len(time) > 1 else 0
    priors = None
    found: _Pass | None = None
    motion, looks = None, None
    for index in range(max(passes, 1)):
        report("association", index, max(passes, 1))
        if found is not None:
            present = found.probability > 0.5
            space = settings.personal_space
            alone = suppress_overlapping_tracks(found.trails, found.evidence, present, space)
            priors = _track_priors(found.trails[alone], found.groups)
        if ratios is None:
            groups = group(boxes, measured, noise, priors)
        else:
            groups = group_by_looks(boxes, measured, noise, priors, ratios)
        state, covariance = mean_and_covariance(groups.info, spread)
        appearance_term = appearance_log_odds(groups, likeness, appearance, settings)
        predicted_views = with_pictures(
            predict_views(state, groups.frame, groups.member, boxes, views), groups.frame, boxes
        )
        n = len(boxes.row)
        rate = learn_detection_rate(
            predicted_views, groups.member, boxes.size[:n], boxes.camera[:n], settings
        )
        existence = judge_groups(
            groups, appearance_term, measured, boxes, views, rate(predicted_views), settings
        )
        if passes == 0:
            trails = unlinked(groups.frame, state, covariance)
            evidence = existence.log_odds
            probability = expit(evidence)
            found = _Pass(groups, existence, state, covariance, trails, evidence, probability)
            break
        is_member = groups.member >= 0
        fewest = min(3, is_member.any(0).sum())  # of the cameras with any box
        sure = (is_member.sum(1) >= fewest) & (existence.log_odds > SURE_LOG_ODDS)
        motion = estimate_motion(state[sure, :2], groups.frame[sure], time)
        if ratios is not None and settings.link_by_looks:
            looks = looks_of(ratios, groups.member)
        trails = follow(groups, existence.log_odds, time, motion, density, spread, settings, looks)
        evidence = _row_evidence(trails, existence, boxes, views, rate, settings)
        probability = presence(trails, evidence, settings.appear_evidence, settings.leave_evidence)
        found = _Pass(groups, existence, state, covariance, trails, evidence, probability)
    report("association", max(passes, 1), max(passes, 1))
    assert found is not None
    trails = found.trails
    position_covariance = trails.covariance[:, :2, :2] + settings.sway**2 * np.eye(2)
    if settings.uneven_ground:
        shift = ground_shift(trails, found.groups, measured, boxes.view, views, noise, settings)
        position_covariance = with_uneven_ground(position_covariance, shift, settings.unevenness)
    within = probability_within(position_covariance, settings.report_radius)
    sharp = (found.probability > 0.5) & (within > 0.5)
    kept = suppress_overlapping_tracks(trails, found.evidence, sharp, settings.personal_space)
    suppressed, outside = sharp & ~kept, np.zeros_like(kept)
    if settings.working_area:
        rows = np.flatnonzero(kept)
        member = np.full((len(rows), boxes.table.shape[1]), -1)
        predicted_views = predict_views(
            trails.mean[rows, :3], trails.frame[rows], member, boxes, views
        )
        cameras = len(np.unique(boxes.camera[: len(boxes.row)]))
        kept[rows] = in_working_area(
            trails.mean[rows, :3], predicted_views, views, noise, cameras, settings
        )
        outside[rows] = ~kept[rows]
    identity = np.where(kept, trails.track, -1)
    if motion is not None:
        error = position_covariance - trails.covariance[:, :2, :2]
        population = Population(time, motion, density, spread, settings.foot_outlier, looks)
        identity = identify(trails, kept, error, found.groups, population)
    # An error of the whole map does not change relative positions: it widens the reported
    # covariance and does not affect which positions are reported.
    if settings.pose_errors:
        position_covariance = position_covariance + shared_covariance(
            trails, kept, found.groups, measured, boxes, views, noise, settings
        )
    return EvidenceSolution(
        boxes=boxes, views=views, noise=noise, measurements=measured, kept=kept,
        identity=identity, suppressed=suppressed, outside=outside,
        position_covariance=position_covariance, **found._asdict(),
    )  # fmt: skip


def probability_within(covariance: np.ndarray, radius: float) -> np.ndarray:
    """(M,) probability that a Gaussian error (M, 2, 2) stays within a radius of the same unit."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 1e-12))
    # Integrate over the disc in polar coordinates of the whitened plane: radially in closed form,
    # numerically over the angle.
    angle = (np.arange(64) + 0.5) * (2 * np.pi / 64)
    stretch = (values[:, :1] * np.cos(angle)) ** 2 + (values[:, 1:] * np.sin(angle)) ** 2
    return (1 - np.exp(-0.5 * radius**2 / stretch)).mean(1)


def _steps(frames: np.ndarray) -> np.ndarray:
    """Time of each frame in units of the sequence's usual step."""
    # Subtract as integers: frame numbers may be nanoseconds since 1970.
    return (frames - frames[:1]).astype(float) / usual_step(frames)


def usual_step(frames: np.ndarray) -> float:
    """Median step between sorted frame numbers (F,); 1 for fewer than two."""
    return float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0


def _row_evidence(
    trails: Trails,
    existence: Existence,
    boxes: Boxes,
    views: GroundViews,
    rate: DetectionRate,
    settings: EvidenceSettings,
) -> np.ndarray:
    """(M,) log-odds of each track row; in a gap, that all cameras missed the person."""
    evidence = np.zeros(len(trails))
    is_detected = trails.group >= 0
    evidence[is_detected] = existence.log_odds[trails.group[is_detected]]
    gaps = np.flatnonzero(~is_detected)
    if len(gaps):
        member = np.full((len(gaps), boxes.table.shape[1]), -1)
        expected = predict_views(trails.mean[gaps, :3], trails.frame[gaps], member, boxes, views)
        expected = with_pictures(expected, trails.frame[gaps], boxes)
        evidence[gaps] = misses(rate(expected), member)
    return np.clip(evidence, -settings.evidence_limit, settings.evidence_limit)


def _track_priors(trails: Trails, groups: Groups) -> Priors:
    """Smoothed positions, excluding the measurements of the frame itself."""
    precision = np.linalg.inv(trails.covariance[:, :3, :3])
    vector = np.einsum("nij,nj->ni", precision, trails.mean[:, :3])
    is_detected = trails.group >= 0
    group_info = groups.info[trails.group[is_detected]]
    precision[is_detected] -= group_info.matrix
    vector[is_detected] -= group_info.vector
    values, axes = np.linalg.eigh(precision)
    values = np.maximum(values, VAGUEST_PRIOR)
    covariance = np.einsum("nij,nj,nkj->nik", axes, 1 / values, axes)
    mean = np.einsum("nij,nj->ni", covariance, vector)
    order = np.lexsort((trails.track, trails.frame))
    return Priors(trails.frame[order], mean[order], covariance[order])
