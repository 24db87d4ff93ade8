"""The solution as catfree's result types, in scene units."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from catfree.methods.evidence._solve import EvidenceSolution, probability_within, solve, usual_step
from catfree.settings import EvidenceSettings
from catfree.types import (
    Candidates,
    Detections,
    Fate,
    Localization,
    Origin,
    Reliability,
    Scene,
    Thresholds,
    Tracks,
)
from catfree.types._progress import Progress


class Clusters(eqx.Module):
    """Boxes that are one person in one frame: correspondences for bundle adjustment.

    Attributes:
        frame: (H,) frame number.
        member: (H, C) index of the detection in each camera, or -1.
        ground_xy: (H, 2) coordinates along the plane's basis, scene units.
        height: (H,) of the person in scene units.
        log_odds: (H,) of a person being there, from this frame alone.
        track: (H,) identity of the reported track that the cluster belongs to, or -1.
        kept: (H,) whether there is such a track.
        sigma: (H, C, 3) noise of centre, top and bottom of each box in pixels, NaN without a box
            and for edges that the image border cuts.
    """

    frame: Int[np.ndarray, " h"]
    member: Int[np.ndarray, "h cam"]
    ground_xy: Float[np.ndarray, "h 2"]
    height: Float[np.ndarray, " h"]
    log_odds: Float[np.ndarray, " h"]
    track: Int[np.ndarray, " h"]
    kept: Bool[np.ndarray, " h"]
    sigma: Float[np.ndarray, "h cam 3"]

    def strict(self, minimum_log_odds: float = 3.0) -> Bool[np.ndarray, " h"]:
        """(H,) those to trust as correspondences: in a track, and seen by half the cameras.

        Cameras that see nobody at all do not count.
        """
        seen = self.member >= 0
        views, cameras = seen.sum(1), int(seen.any(0).sum())
        enough = max(3, -(-cameras // 2))
        return self.kept & (views >= enough) & (self.log_odds > minimum_log_odds)


def localize_by_evidence(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Localization:
    """Track people on the ground by the evidence method.

    Args:
        detections: boxes of all cameras and frames, in any order.
        scene: rig and ground in any units and frame of reference.
        settings: constants and switches.
        progress: called as `progress(stage, done, total)`.

    Returns:
        Tracks with covariance, velocity and existence probability, every candidate and its fate, in
        the frame and units of the scene.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    solution = solve(detections, scene, settings, progress=progress)
    return describe(solution, scene, settings, detection_count=len(detections))


def describe(
    solution: EvidenceSolution,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    detection_count: int,
) -> Localization:
    """A solution in the frame and units of its scene.

    Args:
        solution: what `solve` found.
        scene: the scene it was found in.
        settings: for the radius of a reported position.
        detection_count: number of detections that it was found from.

    Returns:
        The result of a run.
    """
    settings = settings or EvidenceSettings()
    s = solution
    unit = float(s.views.unit)
    rows = np.flatnonzero(s.kept)
    trails = s.trails[rows]
    there = s.groups.member >= 0
    members = np.where(there, s.boxes.row[s.groups.member], -1)
    seen = trails.group >= 0
    support = np.where(seen[:, None], members[trails.group], -1)
    covariance = s.position_covariance[rows] * unit**2
    xy = trails.mean[:, :2] * unit + s.views.origin
    pace = unit / usual_step(s.boxes.frames)
    tracks = Tracks(
        frame=s.boxes.frames[trails.frame],
        track_id=trails.track,
        position=_on_plane(xy, scene),
        ground_xy=xy,
        sigma=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        covariance=covariance,
        supporting_cameras=(support >= 0).sum(1),
        origin=np.where(seen, Origin.DETECTED, Origin.INTERPOLATED).astype(np.int64),
        existence=s.probability[rows],
        support=support,
        velocity=trails.mean[:, 3:] * pace,
        velocity_covariance=trails.covariance[:, 3:, 3:] * pace**2,
    ).renumbered()
    fate = np.where(s.existence.log_odds > 0, Fate.TRACKING, Fate.EXISTENCE).astype(np.int64)
    likely = (s.probability > 0.5) & (s.trails.group >= 0)
    fate[s.trails.group[likely & ~s.kept]] = Fate.UNCERTAINTY_FILTER
    fate[s.trails.group[likely & s.suppressed]] = Fate.SUPPRESSED
    fate[s.trails.group[likely & s.outside]] = Fate.WORKING_AREA
    fate[trails.group[seen]] = Fate.ACCEPTED
    sigma = np.sqrt((s.covariance[:, 0, 0] + s.covariance[:, 1, 1]) / 2) * unit
    candidates = Candidates(
        frame=s.boxes.frames[s.groups.frame],
        position=_on_plane(s.state[:, :2] * unit + s.views.origin, scene),
        sigma=sigma,
        ground_distance=np.zeros(len(sigma)),  # the state lives on the ground
        rms_angle=np.full(len(sigma), np.nan),
        support=members,
        score=s.existence.log_odds,
        fate=fate,
    )
    radius = settings.report_radius * unit
    used = s.groups.member[trails.group[seen]]
    median = float(np.median(tracks.sigma)) if len(tracks) else float("nan")
    precision, recall = _expected_rates(s, rows, fate, settings.report_radius)
    reliability = Reliability(
        median_sigma=median,
        sigma_over_radius=median / radius,
        fraction_recovered=0.0,
        fraction_extended=float(np.mean(~seen)) if len(tracks) else 0.0,
        mean_supporting_cameras=float(tracks.supporting_cameras.mean()) if len(tracks) else 0.0,
        detections_used=float((used >= 0).sum() / max(len(s.boxes.row), 1)),
        expected_precision=precision,
        expected_recall=recall,
    )
    thresholds = Thresholds(
        median_box_height=float(np.median(s.boxes.size[: len(s.boxes.row)])),
    )
    return Localization(tracks, candidates, thresholds, reliability, detection_count)


def _expected_rates(
    solution: EvidenceSolution, rows: np.ndarray, fate: np.ndarray, radius: float
) -> tuple[float, float]:
    """Precision and recall by the probabilities of what is reported and of what is not.

    Who was suppressed is not missed: it was the same person a second time.
    """
    s = solution
    within = probability_within(s.position_covariance[rows], radius)
    right = float((s.probability[rows] * within).sum())
    left_out = s.existence.log_odds[(fate != Fate.ACCEPTED) & (fate != Fate.SUPPRESSED)]
    missed = float(expit(left_out).sum())
    people = right + missed
    return (
        right / len(rows) if len(rows) else float("nan"),
        right / people if people > 0 else float("nan"),
    )


def clusters_of(solution: EvidenceSolution) -> Clusters:
    """The groups of a solution as correspondences between cameras.

    Args:
        solution: what `solve` found.

    Returns:
        All groups, single boxes included, in scene units; `Clusters.strict` says which to trust.
    """
    s = solution
    unit = float(s.views.unit)
    there = s.groups.member >= 0
    track = np.full(len(s.groups), -1)
    kept = np.flatnonzero(s.kept & (s.trails.group >= 0))
    track[s.trails.group[kept]] = s.trails.track[kept]
    rows = np.maximum(s.groups.member, 0)
    noise, used = (np.asarray(a)[rows] for a in (s.measurements.noise, s.measurements.used))
    return Clusters(
        frame=s.boxes.frames[s.groups.frame],
        member=np.where(there, s.boxes.row[s.groups.member], -1),
        ground_xy=s.state[:, :2] * unit + s.views.origin,
        height=s.state[:, 2] * unit,
        log_odds=s.existence.log_odds,
        track=track,
        kept=track >= 0,
        sigma=np.where(there[..., None] & used, noise, np.nan),
    )


def _on_plane(xy: np.ndarray, scene: Scene) -> np.ndarray:
    """(M, 3) scene points of plane coordinates (M, 2)."""
    basis = np.asarray(scene.ground.basis, np.float64)
    normal = np.asarray(scene.ground.normal, np.float64)
    return xy @ basis.T - float(scene.ground.offset) * normal
